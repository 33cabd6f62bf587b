"""Single values of a configuration file: how they are written, parsed and shown in a message."""

from __future__ import annotations

import ipaddress
import math
import re
from decimal import Decimal
from typing import TYPE_CHECKING, Any, Final

from msgspec import json

from roclog.quantities import parse_duration, parse_size

if TYPE_CHECKING:
    from collections.abc import Callable

NAME: Final = "[a-z0-9][a-z0-9_-]{0,31}"
"""Of connections and devices: they become topics and names of files."""
_LONGEST_TEXT: Final = 40
_LONGEST_DURATION: Final = 36_500 * 86_400 * 10**9
_LONGEST_RTS_DELAY: Final = 100 * 10**6
_LARGEST_SIZE: Final = 2**53


class Duration(int):
    """Nanoseconds, more than 0."""

    @classmethod
    def parse(cls, value: object) -> Duration:
        text = _short_text(value, 'a duration in quotes, like "500ms" or "15s"')
        amount = parse_duration(text)
        if not 0 < amount <= _LONGEST_DURATION:
            raise ValueError(f"{text!r} is not more than 0 and at most 36500d")
        return cls(amount)


class RtsDelay(int):
    """Nanoseconds: whole milliseconds from 0 to 100, which is what Linux takes."""

    @classmethod
    def parse(cls, value: object) -> RtsDelay:
        text = _short_text(value, 'a duration in quotes, like "1ms"')
        amount = parse_duration(text)
        if amount % 10**6 or amount > _LONGEST_RTS_DELAY:
            raise ValueError(f"{text!r} is not a whole number of milliseconds from 0ms to 100ms")
        return cls(amount)


class Size(int):
    """Octets, more than 0."""

    @classmethod
    def parse(cls, value: object) -> Size:
        text = _short_text(value, 'a size in quotes, like "64 MiB"')
        amount = parse_size(text)
        if not 0 < amount <= _LARGEST_SIZE:
            raise ValueError(f"{text!r} is not more than 0 and at most 8192 TiB")
        return cls(amount)


class Silence:
    """A time in nanoseconds or in characters of the line."""

    __slots__ = ("characters", "duration")

    def __init__(self, *, characters: Decimal | None = None, duration: int = 0) -> None:
        self.characters = characters
        self.duration = duration

    @classmethod
    def parse(cls, value: object) -> Silence:
        text = _short_text(value, 'a duration or a number of characters, like "5 chars"')
        match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*chars?\s*", text)
        if match is None:
            return cls(duration=Duration.parse(text))
        if not 0 < Decimal(match[1]) <= 1000:
            raise ValueError(f"{text!r} is not more than 0 and at most 1000 chars")
        return cls(characters=Decimal(match[1]))

    def nanoseconds(self, character: int) -> int:
        if self.characters is None:
            return self.duration
        return math.ceil(self.characters * character)


class PathText(str):
    """One line that can be the name of a file."""

    __slots__ = ()

    @classmethod
    def parse(cls, value: object) -> PathText:
        if not isinstance(value, str) or not value or not value.isprintable() or len(value) > 1024:
            raise ValueError(f"{shown(value)} is not a path: text without control characters")
        if value.startswith("~"):
            raise ValueError(f"{shown(value)}: ~ is not expanded, write the whole path")
        return cls(value)


class Host(str):
    """Host name, IPv4 or IPv6 address."""

    __slots__ = ()

    @classmethod
    def parse(cls, value: object) -> Host:
        allowed = "a host name or an IP address"
        if not isinstance(value, str):
            raise TypeError(f"{shown(value)} is not {allowed}")
        try:
            if ":" in value:
                ipaddress.IPv6Address(value)
        except ValueError:
            hint = '; the port goes into "port"' if value.count(":") == 1 else ""
            raise ValueError(f"{shown(value)} is not {allowed}{hint}") from None
        labels = value.split(".")
        if ":" not in value and not all(re.fullmatch(r"[A-Za-z0-9_-]{1,63}", x) for x in labels):
            raise ValueError(f"{shown(value)} is not {allowed}")
        return cls(value)


def _short_text(value: object, allowed: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{shown(value)} is not {allowed}")
    if len(value) > _LONGEST_TEXT:
        raise ValueError(f"{shown(value)} is too long for {allowed}")
    return value


def shown(value: object) -> str:
    """A TOML value for a message: one short printable line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return "an array"
    text = json.encode(value).decode() if isinstance(value, str) else str(value)
    text = printable(text)
    return text if len(text) <= 2 * _LONGEST_TEXT else f"{text[: 2 * _LONGEST_TEXT]}..."


def printable(text: str) -> str:
    """In one line that a terminal shows and does not obey."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


_PARSED: Final[dict[type, tuple[Callable[[object], object], str]]] = {
    Duration: (Duration.parse, r"^\s*\d+(\.\d+)?\s*(us|ms|s|min|h|d)\s*$"),
    RtsDelay: (RtsDelay.parse, r"^\s*\d+(\.\d+)?\s*(us|ms|s|min|h|d)\s*$"),
    Size: (Size.parse, r"^\s*\d+(\.\d+)?\s*(B|KiB|MiB|GiB|TiB)\s*$"),
    Silence: (Silence.parse, r"^\s*\d+(\.\d+)?\s*(chars?|us|ms|s|min|h|d)\s*$"),
    PathText: (PathText.parse, "^[^~]"),
    Host: (Host.parse, "^[A-Za-z0-9_.:-]+$"),
}


def parse_leaf(kind: type, value: object) -> object:
    """The dec_hook of msgspec. Raises ValueError or TypeError with a text for people."""
    return _PARSED[kind][0](value)


def leaf_schema(kind: type) -> dict[str, Any]:
    return {"type": "string", "pattern": _PARSED[kind][1]}

"""Durations, sizes and instants as people write them, to integers and back."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction

_NUMBER = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([A-Za-z]+)\s*", re.ASCII)
_DURATIONS = {
    "us": 10**3,
    "ms": 10**6,
    "s": 10**9,
    "min": 60 * 10**9,
    "h": 3600 * 10**9,
    "d": 86400 * 10**9,
}
_SIZES = {"B": 1, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30, "TiB": 2**40}
_INSTANT = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)?", re.ASCII
)


def parse_duration(text: str) -> int:
    """Nanoseconds of a text like ``"500ms"``, ``"1.5 h"``; units us, ms, s, min, h, d.

    Raises:
        ValueError: no number, no unit, another unit, or not a whole number of nanoseconds.
    """
    return _parse(text, _DURATIONS, "a duration", "500ms or 15s")


def parse_size(text: str) -> int:
    """Octets of a text like ``"64 MiB"``; units B, KiB, MiB, GiB, TiB.

    Raises:
        ValueError: as parse_duration.
    """
    return _parse(text, _SIZES, "a size", "64 MiB")


def _parse(text: str, units: dict[str, int], what: str, example: str) -> int:
    match = _NUMBER.fullmatch(text)
    if match is None or match[2] not in units:
        allowed = ", ".join(units)
        raise ValueError(f"{text!r} is not {what}: a number and one of {allowed}, like {example}")
    amount = Fraction(match[1]) * units[match[2]]
    if amount.denominator != 1:
        raise ValueError(f"{text!r} is finer than {what} can be")
    return amount.numerator


def format_duration(nanoseconds: int) -> str:
    """The shortest exact text in the largest unit that gives at most three decimals."""
    for unit, factor in reversed(_DURATIONS.items()):
        amount = Decimal(nanoseconds) / factor
        if amount >= 1 and amount == round(amount, 3):
            return f"{amount.normalize():f}{unit}"
    return f"{Decimal(nanoseconds) / 1000:f}us"


def format_instant(nanoseconds: int) -> str:
    """ISO 8601 UTC with ``Z`` and as many decimals as the instant has (none to nine)."""
    seconds, fraction = divmod(nanoseconds, 10**9)
    text = datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    digits = f"{fraction:09d}".rstrip("0")
    return f"{text}.{digits}Z" if digits else f"{text}Z"


def parse_instant(text: str) -> int:
    """Nanoseconds UTC of an ISO 8601 instant or date; without an offset it is UTC.

    Raises:
        ValueError: not an instant.
    """
    if re.fullmatch(r"\d{4}-\d\d-\d\d", text, re.ASCII):
        text += "T00:00:00Z"
    match = _INSTANT.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not an instant, like 2026-11-23T06:00:00Z")
    offset = match[4] or "Z"
    moment = datetime.fromisoformat(f"{match[1]}T{match[2]}{'+00:00' if offset == 'Z' else offset}")
    return int(moment.timestamp()) * 10**9 + int((match[3] or "0").ljust(9, "0"))

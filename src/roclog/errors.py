"""Every error roclog raises on purpose, by who has to act.

    RoclogError
    ├── ConfigError              the user edits the file; every problem found, with its key path
    ├── RegisterMapError         the author of a register map; every problem found
    ├── DeviceError              the line or the device
    │   ├── LinkDown             the port or the connection is not there (also ConnectionError)
    │   ├── NoAnswer             time-out; a write may have taken effect (also TimeoutError)
    │   ├── WrongAnswer          an intact answer that does not fit the request
    │   └── ExceptionAnswer      the device refused, with its Modbus exception code
    ├── WriteRefused             roclog itself refused to send a write that no profile declares
    ├── StorageError             the disk: full, read-only, failing (also OSError)
    └── DamagedFile              a recording that fails a checksum or its format, and where

Wrong arguments from a calling program are plain ValueError.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path


class RoclogError(Exception):
    """Base of everything below."""


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a file the user wrote, and where."""

    key: str
    text: str

    def __str__(self) -> str:
        return f"{self.key}: {self.text}" if self.key else self.text


class ConfigError(RoclogError):
    """The configuration cannot be used. All problems are collected before this is raised."""

    def __init__(self, path: Path, problems: list[Problem]) -> None:
        self.path = path
        self.problems = problems
        super().__init__(path, problems)

    def __str__(self) -> str:
        return "\n".join(f"{self.path}: {problem}" for problem in self.problems)


class RegisterMapError(RoclogError):
    """A register map contradicts itself or the protocol's limits."""

    def __init__(self, name: str, problems: list[str]) -> None:
        self.name = name
        self.problems = problems
        super().__init__(name, problems)

    def __str__(self) -> str:
        return "\n".join(f"register map {self.name}: {problem}" for problem in self.problems)


class DeviceError(RoclogError):
    """The line or the device did not do what was asked."""


class LinkDown(DeviceError, ConnectionError):
    """The port could not be opened, or the connection ended while a request was pending."""


class NoAnswer(DeviceError, TimeoutError):
    """Nothing that fits the request arrived in time. A write may have taken effect all the same."""


class WrongAnswer(DeviceError):
    """The checksum holds, but unit, function, byte count or echo do not fit the request.

    is_strange: it is not even a whole answer of the unit that was asked.
    """

    def __init__(self, text: str, raw: bytes, *, is_strange: bool = False) -> None:
        self.raw = raw
        self.is_strange = is_strange
        super().__init__(f"{text} (octets {raw[:64].hex(' ')})")


# Application Protocol V1.1b3, section 7
_CODES = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    5: "acknowledge",
    6: "server device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}


GATEWAY_CODES: Final = frozenset({10, 11})
"""Exceptions of a gateway that had no answer from the device; V1.1b3 section 7."""


class ExceptionAnswer(DeviceError):
    """The device answered with a Modbus exception."""

    def __init__(self, function: int, code: int) -> None:
        self.function = function
        self.code = code
        meaning = _CODES.get(code, "not a standard code")
        super().__init__(f"exception {code} ({meaning}) to function {function}")


class WriteRefused(RoclogError):
    """A write that is neither an acknowledgement nor asked for by a person is not sent."""


class StorageError(RoclogError, OSError):
    """The recording directory cannot take data."""

    def __init__(self, path: Path, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")

    def __str__(self) -> str:
        return f"{self.path}: {self.problem}"


class DamagedFile(RoclogError):
    """A recording, or a part of it, that must not be returned as data."""

    def __init__(self, path: Path, offset: int, reason: str) -> None:
        self.path = path
        self.offset = offset
        self.reason = reason
        super().__init__(f"{path}: {reason} at offset {offset}")

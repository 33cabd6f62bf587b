"""Requests that ask a unit who it is, and touch none of its data.

Source: Application Protocol V1.1b3, sections 6.13 (function 17, Report Server ID) and 6.21
(function 43 with MEI type 14, Read Device Identification).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from roclog.modbus.request import (
    DEVICE_IDENTIFICATION,
    ENCAPSULATED,
    REPORT_SERVER_ID,
    SelfSized,
)

_BASIC: Final = 1
_LAST_BASIC: Final = 2
_OBJECTS_AT: Final = 7
_TEXT: Final = re.compile(rb"[\x01-\x1f\x7f]*[\x20-\x7e]{4,}[\x01-\x7f]*")


class ReportServerId(SelfSized):
    """Function 17. The answer: function, byte count, then what the device's maker has chosen."""

    pdu = head = bytes([REPORT_SERVER_ID])
    answer_size = 2

    def size_of(self, start: bytes) -> int:
        return 2 + start[1] if len(start) > 1 else 2


@dataclass(frozen=True)
class ReadDeviceIdentification(SelfSized):
    """Function 43/14, basic stream: the objects from ``first`` on, of 0 vendor, 1 product code,
    2 revision.

    The answer: function, MEI type, read code, conformity, more follows, next object, number of
    objects, then of each its id, its length and its octets.

    Raises:
        ValueError: another object.
    """

    first: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.first <= _LAST_BASIC:
            raise ValueError(f"object {self.first} is not basic: 0 to 2")

    @property
    def pdu(self) -> bytes:
        return bytes([ENCAPSULATED, DEVICE_IDENTIFICATION, _BASIC, self.first])

    @property
    def head(self) -> bytes:
        return self.pdu[:3]

    @property
    def answer_size(self) -> int:
        return _OBJECTS_AT

    def size_of(self, start: bytes) -> int:
        end = _OBJECTS_AT
        for _ in range(start[_OBJECTS_AT - 1] if len(start) >= _OBJECTS_AT else 0):
            if len(start) < end + 2:
                return end + 2
            end += 2 + start[end + 1]
        return end


def server_id(pdu: bytes) -> bytes:
    """What the maker has chosen, of a checked answer to ReportServerId."""
    return pdu[2:]


def server_text(octets: bytes) -> str:
    """Where a server id has text, that; else its octets. Only the maker knows what they mean.

    Control characters of a text are shown as such.
    """
    runs = [run.decode("ascii").strip() for run in _TEXT.findall(octets)]
    shown = ["".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in run) for run in runs]
    return " ".join(filter(None, shown)) or octets.hex(" ")


def objects(pdu: bytes) -> tuple[dict[int, str], int | None]:
    """Of a checked answer to ReadDeviceIdentification: texts by object, and which is still to be
    asked for.
    """
    found: dict[int, str] = {}
    at = _OBJECTS_AT
    for _ in range(pdu[_OBJECTS_AT - 1]):
        end = at + 2 + pdu[at + 1]
        found[pdu[at]] = pdu[at + 2 : end].decode("latin-1").strip(" \0")
        at = end
    more, following = pdu[4], pdu[5]
    return found, following if more and 0 <= following <= _LAST_BASIC else None

"""The rules that one connection keeps: how frames are found, and the times between them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from roclog.modbus.dialect import STANDARD, Dialect


class Framing(Enum):
    """How an answer is found in what a link hands over."""

    RTU = auto()
    """By its shape and checksum; it carries no number."""
    MBAP_STREAM = auto()
    MBAP_DATAGRAM = auto()
    """One whole frame in each piece."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Rules of one connection, nanoseconds.

    timeout: for an answer to begin and end, from the end of the request.
    late_answer: from the start of the request until its answer can no longer come; 0 where
    answers are numbered.
    silence: before every frame. character: duration of one on the wire; both 0 with MBAP.
    dialect: of MBAP frames.
    """

    framing: Framing
    timeout: int
    late_answer: int = 0
    silence: int = 0
    character: int = 0
    dialect: Dialect = STANDARD

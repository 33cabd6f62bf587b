"""The words a device is described in. A register map is data: everything else follows from it.

Addresses are PDU addresses, counted from 0 (Application Protocol V1.1b3, section 4.4). Offsets
count registers (words of 16 bits) from the address of their block.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from decimal import Decimal

MAX_READ_REGISTERS: Final = 125
"""V1.1b3, section 6.3."""
MAX_RANGED_POINTS: Final = 64
"""The doubtful mask of a sample has one bit for each of the first 64 points of its block."""


class Table(StrEnum):
    """The tables of V1.1b3 section 4.3 that hold words."""

    INPUT_REGISTERS = "input_registers"
    HOLDING_REGISTERS = "holding_registers"

    @property
    def read_function(self) -> int:
        return {"input_registers": 4, "holding_registers": 3}[self.value]


class WordType(StrEnum):
    """How words become a value."""

    U16 = "uint16"
    S16 = "int16"
    U32 = "uint32"
    MINUTES_SECONDS = "minutes_seconds"
    """One word, minutes in the upper octet, seconds in the lower; the value is in seconds."""
    MONTH_DAY = "month_day"
    """One word, month in the upper octet, day in the lower; the value is month * 100 + day."""
    TEXT = "text"
    """Two characters in a word, upper octet first; the first 0x00 ends it."""


class WordOrder(StrEnum):
    """Order of the two words of a 32-bit value, named by example octets: 0x41424344 = ABCD."""

    ABCD = "ABCD"
    CDAB = "CDAB"


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One value of a block.

    scale: the value is the integer times this; kept as Decimal so that 57 * 0.01 is 0.57 exactly.
    low, high: the range that the device's document gives, in the unit of the value, inclusive.
    meanings: what single values mean, for people (tables, documentation); the value stays a number.
    bits: name of each meaningful bit by number, 0 = least significant; one boolean field each.
    """

    name: str
    offset: int
    type: WordType
    words: int = 0
    scale: Decimal | None = None
    unit: str = ""
    low: Decimal | None = None
    high: Decimal | None = None
    meanings: tuple[tuple[int, str], ...] = ()
    bits: tuple[tuple[int, str], ...] = ()
    title: str = ""

    @property
    def size(self) -> int:
        """Words of this point."""
        if self.type is WordType.TEXT:
            return self.words
        return 2 if self.type is WordType.U32 else 1


@dataclass(frozen=True, slots=True, kw_only=True)
class FlagAndClear:
    """New-data handshake: the device raises a flag, the client writes ``clear`` to it.

    payload: (first offset, words) ranges whose change means another sample. Words that move
    without a new sample (live alarms, temperature) are left out.
    """

    flag: int
    new: int = 1
    clear: int = 0
    payload: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitCalendar:
    """Device time in four words: year, month/day, hour, minute/second; all zero means no time."""

    year: int
    month_day: int
    hour: int
    minute_second: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Words that belong together.

    atomic: fetched in one request of their own. Otherwise a request may take in neighbours of the
    same table and period, and a block that is larger than an answer is fetched by several.
    period: nanoseconds from read to read; None = as the device is configured.
    must_not_increase: points whose values cannot grow from one to the next. With the ranges of the
    32-bit points this tells a wrong word order (one warning event, never a rewrite).
    """

    name: str
    table: Table
    address: int
    count: int
    points: tuple[Point, ...]
    trigger: FlagAndClear | None = None
    time: SplitCalendar | None = None
    must_not_increase: tuple[str, ...] = ()
    title: str = ""
    period: int | None = None
    atomic: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialDefaults:
    """Line settings that the device's document fixes, and the silence it asks before a frame."""

    baudrate: int
    bytesize: int = 8
    parity: str = "N"
    stopbits: int = 1
    silence_characters: float = 3.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterMap:
    """A device. ``facts`` are blocks read at the start and kept as metadata, not as samples.

    cycle: (facts block, names of the points in seconds) whose sum is the time between samples.
    answer_limit: longest time the document allows the device to answer, nanoseconds.
    """

    name: str
    title: str
    source: str
    unit: int
    serial: SerialDefaults
    answer_limit: int
    samples: tuple[Block, ...]
    facts: tuple[Block, ...] = ()
    cycle: tuple[str, tuple[str, ...]] | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def blocks(self) -> tuple[Block, ...]:
        return self.facts + self.samples

    def block(self, name: str) -> Block:
        """Raises KeyError where the map has no such block."""
        for block in self.blocks:
            if block.name == name:
                return block
        raise KeyError(name)


def camel_case(name: str) -> str:
    """``iso_code_1`` to ``IsoCode1``, as message types and protobuf's JSON names are formed."""
    return "".join(part.capitalize() for part in name.split("_"))

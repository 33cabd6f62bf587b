"""The words a device is described in. A register map is data: everything else follows from it.

Addresses are PDU addresses, counted from 0 (Application Protocol V1.1b3, section 4.4). Offsets
count registers (words of 16 bits) from the address of their block.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum
from typing import Final

from roclog.errors import RegisterMapError

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
    """Words fetched in one request, never split and never merged.

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


_NAME = re.compile(r"[a-z][a-z0-9_]{0,47}")
RESERVED_NAMES: Final = frozenset(
    "seq epoch origin redelivered asked_at read_at read_at_monotonic previous_read_at device_time "
    "time_flags doubtful raw log_time publish_time".split()
)
"""Fields that every sample has; a point cannot be called so."""


def check_register_map(register_map: RegisterMap) -> None:
    """What every map must satisfy, built in or not.

    Raises:
        RegisterMapError: with all problems, not the first.
    """
    problems = (
        [] if re.fullmatch(r"[a-z][a-z0-9-]*", register_map.name) else ["name: not lower case"]
    )
    names = [block.name for block in register_map.blocks]
    problems += [f"block {n}: named twice" for n in sorted(set(names)) if names.count(n) > 1]
    for block in register_map.blocks:
        problems += [f"block {block.name}: {text}" for text in _block_problems(block)]
    if register_map.cycle is not None:
        facts, points = register_map.cycle
        known = {p.name for b in register_map.facts if b.name == facts for p in b.points}
        problems += [f"cycle: no point {facts}.{name}" for name in points if name not in known]
    if problems:
        raise RegisterMapError(register_map.name, problems)


def _block_problems(block: Block) -> list[str]:
    problems: list[str] = []
    if not _NAME.fullmatch(block.name) or block.name in {"gap", "link", "clear"}:
        problems.append("name must be lower case letters, digits and _, and not gap, link or clear")
    if not 1 <= block.count <= MAX_READ_REGISTERS:
        problems.append(f"count {block.count} is not 1 to {MAX_READ_REGISTERS} registers")
    if not 0 <= block.address <= 65536 - block.count:
        problems.append(
            f"registers {block.address} to {block.address + block.count - 1} do not exist"
        )
    taken: dict[int, str] = {}
    names: list[str] = []
    for index, point in enumerate(block.points):
        problems += [f"point {point.name}: {text}" for text in _point_problems(point, block, index)]
        names += [point.name, *(name for _, name in point.bits)]
        for word in range(point.offset, point.offset + point.size):
            if word in taken:
                problems.append(f"point {point.name}: shares register {word} with {taken[word]}")
            taken[word] = point.name
    problems += [f"field {n}: named twice" for n in sorted(set(names)) if names.count(n) > 1]
    problems += [f"{name}: no such point" for name in block.must_not_increase if name not in names]
    return problems + _trigger_problems(block, taken)


def _point_problems(point: Point, block: Block, index: int) -> list[str]:
    problems: list[str] = []
    for name in (point.name, *(name for _, name in point.bits)):
        if not _NAME.fullmatch(name) or name in RESERVED_NAMES:
            problems.append(f"{name!r} cannot be a name")
    if point.offset < 0 or point.size < 1 or point.offset + point.size > block.count:
        problems.append(f"offset {point.offset} with {point.size} words is outside the block")
    if point.scale is not None and not (point.scale.is_finite() and point.scale > 0):
        problems.append(f"scale {point.scale} is not a positive number")
    if (point.low is None) != (point.high is None):
        problems.append("low and high go together")
    if point.low is not None and point.high is not None:
        if point.low > point.high:
            problems.append(f"low {point.low} is above high {point.high}")
        if index >= MAX_RANGED_POINTS:
            problems.append(
                f"only the first {MAX_RANGED_POINTS} points of a block can have a range"
            )
    width = 16 * point.size
    problems += [
        f"bit {bit} is outside {width} bits" for bit, _ in point.bits if not 0 <= bit < width
    ]
    if point.bits and (point.scale is not None or point.type is WordType.TEXT):
        problems.append("bits need an unscaled integer")
    return problems


def _trigger_problems(block: Block, taken: dict[int, str]) -> list[str]:
    problems: list[str] = []
    used: list[tuple[str, int]] = []
    if block.time is not None:
        time = block.time
        used += [("time", o) for o in (time.year, time.month_day, time.hour, time.minute_second)]
    if block.trigger is not None:
        trigger = block.trigger
        used.append(("flag", trigger.flag))
        if trigger.flag in taken:
            problems.append(f"flag: register {trigger.flag} is point {taken[trigger.flag]} as well")
        if trigger.new == trigger.clear:
            problems.append("flag: new and clear are the same value")
        if block.table is not Table.HOLDING_REGISTERS:
            problems.append("flag: only a holding register can be cleared")
        if not trigger.payload:
            problems.append("payload: empty, so a changed sample could not be told from a repeat")
        for first, words in trigger.payload:
            used += [("payload", first), ("payload", first + words - 1)]
            if first <= trigger.flag < first + words:
                problems.append("payload: contains the flag")
    problems += [
        f"{what}: offset {o} is outside the block" for what, o in used if not 0 <= o < block.count
    ]
    return problems

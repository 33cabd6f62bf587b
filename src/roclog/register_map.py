"""The words a device is described in. A register map is data: everything else follows from it.

Addresses are PDU addresses, counted from 0 (Application Protocol V1.1b3, section 4.4). Offsets
count registers (words of 16 bits) from the address of their block.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from roclog.errors import RegisterMapError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

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


_UNSIGNED: Final = frozenset({WordType.U16, WordType.U32})
_NUMBERS: Final = _UNSIGNED | {WordType.S16}
_JUDGED: Final = frozenset({WordType.MINUTES_SECONDS, WordType.MONTH_DAY, WordType.TEXT})
"""Types of which some words are illegal."""
_MIN_SCALE: Final = Decimal("1e-30")
_MAX_SCALE: Final = Decimal("1e30")


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
    (
        "seq",
        "epoch",
        "origin",
        "redelivered",
        "asked_at",
        "read_at",
        "read_at_monotonic",
        "previous_read_at",
        "device_time",
        "time_flags",
        "doubtful",
        "raw",
        "log_time",
        "publish_time",
    )
)
"""Fields that every sample has; a point cannot be called so."""
RESERVED_BLOCKS: Final = frozenset({"gap", "link", "clear"})
"""Channels that a device has beside its blocks."""


def camel_case(name: str) -> str:
    """``iso_code_1`` to ``IsoCode1``, as message types and protobuf's JSON names are formed."""
    return "".join(part.capitalize() for part in name.split("_"))


def check_register_map(register_map: RegisterMap) -> None:
    """What every map must satisfy, built in or not.

    Raises:
        RegisterMapError: with all problems, not the first.
    """
    problems = [*_map_problems(register_map), *_cycle_problems(register_map)]
    for block in register_map.blocks:
        problems += [f"block {block.name}: {text}" for text in _block_problems(block)]
    if problems:
        raise RegisterMapError(register_map.name, problems)


def _map_problems(register_map: RegisterMap) -> Iterator[str]:
    if not re.fullmatch(r"[a-z][a-z0-9-]*", register_map.name):
        yield "name: must be lower case letters, digits and -"
    if not 0 <= register_map.unit <= 255:
        yield f"unit: {register_map.unit} is not 0 to 255"
    if register_map.answer_limit <= 0:
        yield "answer_limit: must be longer than nothing"
    line = register_map.serial
    if line.baudrate <= 0 or line.bytesize != 8 or line.stopbits not in (1, 2):
        yield "serial: must have a baudrate, 8 data bits, and 1 or 2 stop bits"
    if line.parity not in ("N", "E", "O"):
        yield f"serial: parity {line.parity!r} is not N, E or O"
    if not 3.5 <= line.silence_characters < math.inf:
        yield f"serial: a silence of {line.silence_characters} is not at least 3.5 characters"
    if not register_map.samples:
        yield "samples: no block"
    flagged = [block.name for block in register_map.blocks if block.trigger is not None]
    if len(flagged) > 1:
        yield f"blocks {' and '.join(flagged)}: only one can have a flag"
    for block in register_map.facts:
        if block.trigger is not None:
            yield f"block {block.name}: facts are read once, they cannot have a flag"
    for block in register_map.samples:
        texts = [point.name for point in block.points if point.type is WordType.TEXT]
        if texts:
            yield f"block {block.name}: text ({', '.join(texts)}) is for facts only"
    yield from _twins("block", [block.name for block in register_map.blocks])


def _cycle_problems(register_map: RegisterMap) -> Iterator[str]:
    if register_map.cycle is None:
        return
    facts, names = register_map.cycle
    points = {p.name: p for b in register_map.facts if b.name == facts for p in b.points}
    if not names:
        yield "cycle: no points"
    for name in names:
        if name not in points:
            yield f"cycle: no point {facts}.{name}"
        elif points[name].unit != "s" or points[name].type is WordType.TEXT:
            yield f"cycle: {facts}.{name} is not in seconds"


def _block_problems(block: Block) -> Iterator[str]:
    if not _NAME.fullmatch(block.name) or block.name in RESERVED_BLOCKS:
        yield "name must be lower case letters, digits and _, and not gap, link or clear"
    if not 1 <= block.count <= MAX_READ_REGISTERS:
        yield f"count {block.count} is not 1 to {MAX_READ_REGISTERS} registers"
    if not 0 <= block.address <= 65536 - block.count:
        yield f"registers {block.address} to {block.address + block.count - 1} do not exist"
    if not block.points:
        yield "no points"
    taken: dict[int, str] = {}
    for index, point in enumerate(block.points):
        for text in _point_problems(point, block, index):
            yield f"point {point.name}: {text}"
        for word in range(point.offset, point.offset + point.size):
            if word in taken:
                yield f"point {point.name}: shares register {word} with {taken[word]}"
            taken[word] = point.name
    names = [name for point in block.points for name in _field_names(point)]
    yield from _twins("field", names)
    numbers = [point.name for point in block.points if point.type is WordType.U32]
    for name in block.must_not_increase:
        if name not in numbers:
            yield f"must_not_increase: {name} is not a 32-bit point"
    yield from _time_problems(block)
    if block.trigger is not None:
        yield from _trigger_problems(block, block.trigger, taken)


def _point_problems(point: Point, block: Block, index: int) -> Iterator[str]:
    for name in _field_names(point):
        if not _NAME.fullmatch(name) or name in RESERVED_NAMES:
            yield f"{name!r} cannot be a name"
    if point.offset < 0 or point.size < 1 or point.offset + point.size > block.count:
        yield f"offset {point.offset} with {point.size} words is outside the block"
    if point.words and point.type is not WordType.TEXT:
        yield "only text has a number of words"
    if point.scale is not None:
        if not (point.scale.is_finite() and _MIN_SCALE <= point.scale <= _MAX_SCALE):
            yield f"scale {point.scale} is not a number from {_MIN_SCALE} to {_MAX_SCALE}"
        if point.type not in _NUMBERS:
            yield f"{point.type} cannot have a scale"
    yield from _range_problems(point)
    judged = point.low is not None or point.type in _JUDGED
    if judged and index >= MAX_RANGED_POINTS:
        yield f"only the first {MAX_RANGED_POINTS} points of a block can have a range"
    width = 16 * point.size
    bits = [bit for bit, _ in point.bits]
    yield from (f"bit {bit} is outside {width} bits" for bit in bits if not 0 <= bit < width)
    yield from (f"bit {bit}: named twice" for bit in sorted(set(bits)) if bits.count(bit) > 1)
    if bits and (point.scale is not None or point.type not in _UNSIGNED):
        yield "bits need an unscaled unsigned integer"
    values = [value for value, _ in point.meanings]
    yield from (f"{v}: two meanings" for v in sorted(set(values)) if values.count(v) > 1)


def _range_problems(point: Point) -> Iterator[str]:
    if (point.low is None) != (point.high is None):
        yield "low and high go together"
    if point.low is None or point.high is None:
        return
    if not (point.low.is_finite() and point.high.is_finite()):
        yield f"{point.low} to {point.high} is not a range"
    elif point.low > point.high:
        yield f"low {point.low} is above high {point.high}"
    if point.type is WordType.TEXT:
        yield "text has no range"


def _time_problems(block: Block) -> Iterator[str]:
    if block.time is None:
        return
    time = block.time
    offsets = (time.year, time.month_day, time.hour, time.minute_second)
    yield from _outside("time", offsets, block)
    if len(set(offsets)) < len(offsets):
        yield "time: one register is used twice"


def _trigger_problems(block: Block, trigger: FlagAndClear, taken: dict[int, str]) -> Iterator[str]:
    yield from _outside("flag", (trigger.flag,), block)
    if trigger.flag in taken:
        yield f"flag: register {trigger.flag} is point {taken[trigger.flag]} as well"
    if trigger.new == trigger.clear:
        yield "flag: new and clear are the same value"
    if not (0 <= trigger.new <= 0xFFFF and 0 <= trigger.clear <= 0xFFFF):
        yield "flag: new and clear must fit 16 bits"
    if block.table is not Table.HOLDING_REGISTERS:
        yield "flag: only a holding register can be cleared"
    if not trigger.payload:
        yield "payload: empty, so a changed sample could not be told from a repeat"
    for first, words in trigger.payload:
        if words < 1:
            yield f"payload: {words} words from offset {first}"
            continue
        yield from _outside("payload", (first, first + words - 1), block)
        if first <= trigger.flag < first + words:
            yield "payload: contains the flag"


def _outside(what: str, offsets: Iterable[int], block: Block) -> Iterator[str]:
    for offset in offsets:
        if not 0 <= offset < block.count:
            yield f"{what}: offset {offset} is outside the block"


def _twins(what: str, names: list[str]) -> Iterator[str]:
    """Names that are the same, or become the same in JSON or as a message type."""
    for name in sorted({n for n in names if names.count(n) > 1}):
        yield f"{what} {name}: named twice"
    first: dict[str, str] = {}
    for name in dict.fromkeys(names):
        other = first.setdefault(camel_case(name), name)
        if other != name:
            yield f"{what} {name}: differs from {other} only in _"


def _field_names(point: Point) -> tuple[str, ...]:
    return (point.name, *(name for _, name in point.bits))

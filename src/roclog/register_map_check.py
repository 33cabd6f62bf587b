"""What every register map must satisfy, built in or not."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from typing import TYPE_CHECKING, Final

from roclog.errors import RegisterMapError
from roclog.register_map import (
    MAX_RANGED_POINTS,
    MAX_READ_REGISTERS,
    Block,
    FlagAndClear,
    Point,
    RegisterMap,
    SerialDefaults,
    Table,
    WordType,
    camel_case,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

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
_UNSIGNED: Final = frozenset({WordType.U16, WordType.U32})
_NUMBERS: Final = _UNSIGNED | {WordType.S16}
_JUDGED: Final = frozenset({WordType.MINUTES_SECONDS, WordType.MONTH_DAY, WordType.TEXT})
"""Types of which some words are illegal."""
_MIN_SCALE: Final = Decimal("1e-30")
_MAX_SCALE: Final = Decimal("1e30")


def check_register_map(register_map: RegisterMap) -> None:
    """Raises:
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
    if not register_map.samples:
        yield "samples: no block"
    yield from _serial_problems(register_map.serial)
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


def _serial_problems(line: SerialDefaults) -> Iterator[str]:
    if line.baudrate <= 0 or line.bytesize != 8 or line.stopbits not in (1, 2):
        yield "serial: must have a baudrate, 8 data bits, and 1 or 2 stop bits"
    if line.parity not in ("N", "E", "O"):
        yield f"serial: parity {line.parity!r} is not N, E or O"
    if not 3.5 <= line.silence_characters < math.inf:
        yield f"serial: a silence of {line.silence_characters} is not at least 3.5 characters"


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
    for index, point in enumerate(block.points):
        for text in _point_problems(point, block, index):
            yield f"point {point.name}: {text}"
    yield from _twins("field", [name for point in block.points for name in _field_names(point)])
    numbers = [point.name for point in block.points if point.type is WordType.U32]
    for name in block.must_not_increase:
        if name not in numbers:
            yield f"must_not_increase: {name} is not a 32-bit point"
    yield from _sharing_problems(block)
    yield from _time_problems(block)
    if block.trigger is not None:
        yield from _trigger_problems(block, block.trigger)


def _sharing_problems(block: Block) -> Iterator[str]:
    taken: dict[int, str] = {}
    if block.trigger is not None:
        taken[block.trigger.flag] = "the flag"
    for point in block.points:
        for word in range(point.offset, point.offset + point.size):
            if word in taken:
                yield f"point {point.name}: shares register {word} with {taken[word]}"
            taken[word] = point.name


def _point_problems(point: Point, block: Block, index: int) -> Iterator[str]:
    for name in _field_names(point):
        if not _NAME.fullmatch(name) or name in RESERVED_NAMES:
            yield f"{name!r} cannot be a name"
    if point.offset < 0 or point.size < 1 or point.offset + point.size > block.count:
        yield f"offset {point.offset} with {point.size} words is outside the block"
    if point.words and point.type is not WordType.TEXT:
        yield "only text has a number of words"
    judged = point.low is not None or point.type in _JUDGED
    if judged and index >= MAX_RANGED_POINTS:
        yield f"only the first {MAX_RANGED_POINTS} points of a block can have a range"
    yield from _scale_problems(point)
    yield from _range_problems(point)
    yield from _bit_problems(point)
    values = [value for value, _ in point.meanings]
    yield from (f"{v}: two meanings" for v in sorted(set(values)) if values.count(v) > 1)


def _scale_problems(point: Point) -> Iterator[str]:
    if point.scale is None:
        return
    if not (point.scale.is_finite() and _MIN_SCALE <= point.scale <= _MAX_SCALE):
        yield f"scale {point.scale} is not a number from {_MIN_SCALE} to {_MAX_SCALE}"
    if point.type not in _NUMBERS:
        yield f"{point.type} cannot have a scale"


def _bit_problems(point: Point) -> Iterator[str]:
    bits = [bit for bit, _ in point.bits]
    width = 16 * point.size
    yield from (f"bit {bit} is outside {width} bits" for bit in bits if not 0 <= bit < width)
    yield from (f"bit {bit}: named twice" for bit in sorted(set(bits)) if bits.count(bit) > 1)
    if bits and (point.scale is not None or point.type not in _UNSIGNED):
        yield "bits need an unscaled unsigned integer"


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


def _trigger_problems(block: Block, trigger: FlagAndClear) -> Iterator[str]:
    yield from _outside("flag", (trigger.flag,), block)
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

"""What every trigger and every time source of a register map must satisfy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.register_map import (
    MAX_READ_BITS,
    MAX_READ_REGISTERS,
    Change,
    ClearOnRead,
    Counter,
    Cp32,
    Cp56,
    FlagAndClear,
    SecondsMicroseconds,
    SplitCalendar,
    Table,
    UnixSeconds,
    WordType,
)
from roclog.register_map.times import places
from roclog.stamps import parse_zone

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from roclog.register_map import Block

_PARTS: Final = ("year", "month", "day", "hour", "minute", "second", "millisecond")
_NEEDED: Final = frozenset(_PARTS[:4])
_COUNTERS: Final = frozenset({WordType.U16, WordType.U32, WordType.U64})


def trigger_flaws(block: Block) -> Iterator[tuple[str, str]]:
    """(attribute, what is wrong with it)."""
    trigger = block.trigger
    most = MAX_READ_BITS if block.table.has_bits else MAX_READ_REGISTERS
    if isinstance(trigger, Counter | Change) and block.count > most and not block.packed:
        what = "bits" if block.table.has_bits else "registers"
        text = f"must be read in one request, at most {most} {what}, not {block.count}"
        why = "a sample could be half of one and half of the next"
        yield "trigger", f"trigger: a block with a trigger {text}, else {why}"
    found: Iterable[str] = ()
    match trigger:
        case FlagAndClear():
            found = _flag(block, trigger)
        case ClearOnRead():
            found = _clear_on_read(trigger)
        case Counter():
            found = _counter(block, trigger)
        case Change():
            found = _ranges("change", trigger.payload, block)
    yield from (("trigger", text) for text in found)
    if block.repeatable and isinstance(trigger, ClearOnRead):
        yield "repeatable", "repeatable: the second call would tell another sample"


def time_flaws(block: Block) -> Iterator[tuple[str, str]]:
    """(attribute, what is wrong with it)."""
    if block.time is not None and block.table.has_bits:
        yield "time", "time: bits hold no time"
    elif block.time is not None:
        yield from (("time", text) for text in _time(block))


def _flag(block: Block, trigger: FlagAndClear) -> Iterator[str]:
    yield from _outside("flag", (trigger.flag,), block)
    if trigger.new == trigger.clear:
        yield "flag: new and clear are the same value"
    if not (0 <= trigger.new <= 0xFFFF and 0 <= trigger.clear <= 0xFFFF):
        yield "flag: new and clear must fit 16 bits"
    if block.table is not Table.HOLDING_REGISTERS:
        yield "flag: only a holding register can be cleared"
    if not trigger.payload:
        yield "payload: empty, so a changed sample could not be told from a repeat"
    yield from _ranges("payload", trigger.payload, block)
    if any(first <= trigger.flag < first + words for first, words in trigger.payload):
        yield "payload: contains the flag"


def _clear_on_read(trigger: ClearOnRead) -> Iterator[str]:
    if not 0 <= trigger.address <= 0xFFFF:
        yield f"clear on read: address {trigger.address} does not exist"
    if not 1 <= trigger.mask <= 0xFFFF:
        yield f"clear on read: mask {trigger.mask} is not 1 to 65535"
    elif trigger.table.has_bits and not (trigger.mask & 1 and trigger.new <= 1):
        yield f"clear on read: a bit AND {trigger.mask} is never {trigger.new}, needed is mask 1"
    elif trigger.new & ~trigger.mask:
        yield f"clear on read: the flag can never be {trigger.new} with mask {trigger.mask}"


def _counter(block: Block, trigger: Counter) -> Iterator[str]:
    point = next((point for point in block.points if point.name == trigger.point), None)
    if point is None:
        yield f"counter: no point {trigger.point} in this block"
        return
    if point.type not in _COUNTERS or point.is_scaled or point.can_be_missing:
        yield f"counter: {trigger.point} is not an unscaled unsigned integer that is always there"
        return
    largest = (1 << 16 * point.type.words) - 1
    last = largest if trigger.last is None else trigger.last
    if not 0 <= trigger.first < last <= largest:
        yield f"counter: {trigger.first} to {last} is not a range of {point.type}"


def _ranges(what: str, ranges: Iterable[tuple[int, int]], block: Block) -> Iterator[str]:
    for first, words in ranges:
        if words < 1:
            yield f"{what}: {words} words from offset {first}"
            continue
        yield from _outside(what, (first, first + words - 1), block)


def _time(block: Block) -> Iterator[str]:
    if block.time is None:
        return
    if block.packed and not isinstance(block.time, UnixSeconds | SecondsMicroseconds):
        yield "time: octets hold seconds, or seconds and microseconds, no other time"
        return
    if isinstance(block.time, SplitCalendar):
        yield from _calendar(block.time)
    if isinstance(block.time, SplitCalendar | Cp56 | Cp32):
        yield from _zone(block.time.zone)
    if isinstance(block.time, Cp32) and block.trigger is None:
        yield "time: a stamp without a date needs a trigger that tells when it changed"
    offsets = places(block.time, packed=block.packed)
    yield from _outside("time", offsets, block)
    yield from _spread(offsets, block)
    if len(set(offsets)) < len(offsets):
        yield "time: one register is used twice"


def _spread(offsets: list[int], block: Block) -> Iterator[str]:
    """A time that several requests would read, and whatever lies across its ends."""
    first, end = min(offsets, default=0), max(offsets, default=0) + 1
    for point in block.points:
        start, stop = point.offset, point.offset + block.size_of(point)
        first = start if start < first < stop else first
        end = stop if start < end < stop else end
    if end - first > MAX_READ_REGISTERS and not (block.atomic or block.packed):
        text = f"offsets {first} to {end - 1} do not fit one answer, {MAX_READ_REGISTERS} registers"
        yield f"time: {text}, so that its parts would be of different moments"


def _calendar(calendar: SplitCalendar) -> Iterator[str]:
    given: list[str] = []
    for name, _ in calendar.words:
        whole = {"millisecond_of_minute": ["second", "millisecond"]}
        given += whole.get(name, name.split("_"))
    for part in _PARTS:
        if given.count(part) > 1:
            yield f"time: the {part} is given twice"
        elif part in _NEEDED and part not in given:
            yield f"time: there is no {part}"


def _zone(name: str) -> Iterator[str]:
    try:
        parse_zone(name)
    except ValueError as error:
        yield f"time: {error}"


def _outside(what: str, offsets: Iterable[int], block: Block) -> Iterator[str]:
    for offset in offsets:
        if not 0 <= offset < block.count:
            yield f"{what}: offset {offset} is outside the block"

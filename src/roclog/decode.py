"""Words in, values out. Pure, and never a refusal: what looks wrong is marked, not dropped."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntFlag
from itertools import pairwise
from typing import TYPE_CHECKING

from roclog.register_map import Block, Point, SplitCalendar, WordOrder, WordType

if TYPE_CHECKING:
    from collections.abc import Sequence
    from decimal import Decimal

_END_OF_TIME = 2**63
"""Nanoseconds since 1970 that no longer fit the 64-bit times of a recording: the year 2262."""

Value = int | float | bool | str


class TimeFlag(IntFlag):
    """Why a device stamp gives no device time."""

    NO_TIME = 1
    """Every stamp word is zero."""
    DATE_INVALID = 2
    """The fields do not form a date and time that exists, or one outside 1970 to 2262."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """The values of one block.

    values: one for each field of the block, in the order of ``block_fields``.
    doubtful: bit n is set where point n lies outside the range its document gives.
    device_time: nanoseconds UTC, 0 = unknown (then time_flags say why, where the block has stamps).
    """

    values: tuple[Value, ...]
    doubtful: int
    device_time: int
    time_flags: TimeFlag


def field_names(block: Block) -> tuple[str, ...]:
    """Points in map order, each followed by its named bits."""
    return tuple(n for p in block.points for n in (p.name, *(name for _, name in p.bits)))


def decode(block: Block, words: Sequence[int], order: WordOrder = WordOrder.ABCD) -> Decoded:
    """Decode the words of one block, most significant octet of each register first.

    Raises:
        ValueError: not as many words as the block has; the bus has checked that before.
    """
    if len(words) != block.count:
        raise ValueError(f"block {block.name} has {block.count} words, not {len(words)}")
    values: list[Value] = []
    doubtful = 0
    for index, point in enumerate(block.points):
        raw, valid = _raw(point, words[point.offset : point.offset + point.size], order)
        value = raw if point.scale is None or isinstance(raw, str) else scaled(raw, point.scale)
        if not valid or not _in_range(point, value):
            doubtful |= 1 << index
        values.append(value)
        values += [bool(int(raw) >> bit & 1) for bit, _ in point.bits]
    device_time, flags = _calendar(block.time, words)
    return Decoded(tuple(values), doubtful, device_time, flags)


def scaled(raw: int, scale: Decimal) -> float:
    """The float nearest to the exact product, so that its shortest text is the decimal value."""
    numerator, denominator = scale.as_integer_ratio()
    return raw * numerator / denominator


def _raw(point: Point, words: Sequence[int], order: WordOrder) -> tuple[int | str, bool]:
    """The integer or text, and whether its octets are legal for its type."""
    first = words[0]
    match point.type:
        case WordType.U16:
            return first, True
        case WordType.S16:
            return first - 0x10000 if first & 0x8000 else first, True
        case WordType.U32:
            high, low = words if order is WordOrder.ABCD else reversed(words)
            return high << 16 | low, True
        case WordType.MINUTES_SECONDS:
            minutes, seconds = divmod(first, 256)
            return minutes * 60 + seconds, minutes < 60 and seconds < 60
        case WordType.MONTH_DAY:
            month, day = divmod(first, 256)
            return month * 100 + day, first == 0 or (1 <= month <= 12 and 1 <= day <= 31)
        case WordType.TEXT:
            octets = b"".join(word.to_bytes(2) for word in words).partition(b"\0")[0]
            return octets.decode("latin-1"), all(0x20 <= octet <= 0x7E for octet in octets)


def _in_range(point: Point, value: Value) -> bool:
    if point.low is None or point.high is None or isinstance(value, str):
        return True
    return float(point.low) <= value <= float(point.high)


def _calendar(time: SplitCalendar | None, words: Sequence[int]) -> tuple[int, TimeFlag]:
    if time is None:
        return 0, TimeFlag(0)
    year, hour = words[time.year], words[time.hour]
    month, day = divmod(words[time.month_day], 256)
    minute, second = divmod(words[time.minute_second], 256)
    if not any((year, month, day, hour, minute, second)):
        return 0, TimeFlag.NO_TIME
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return 0, TimeFlag.DATE_INVALID
    instant = int(moment.timestamp()) * 10**9
    return (instant, TimeFlag(0)) if 0 < instant < _END_OF_TIME else (0, TimeFlag.DATE_INVALID)


def word_order_doubts(block: Block, words: Sequence[int], order: WordOrder) -> list[str]:
    """What speaks against this word order; a warning for people, never a reason to swap words."""
    doubts: list[str] = []
    values: dict[str, float] = {}
    for point in block.points:
        if point.type is WordType.U32:
            raw = int(_raw(point, words[point.offset : point.offset + 2], order)[0])
            values[point.name] = raw if point.scale is None else scaled(raw, point.scale)
            if not _in_range(point, values[point.name]):
                span = f"{point.low} to {point.high}"
                doubts.append(f"{point.name} is {values[point.name]}, documented is {span}")
    for left, right in pairwise(block.must_not_increase):
        if values[right] > values[left]:
            doubts.append(f"{right} is larger than {left}")
    return doubts

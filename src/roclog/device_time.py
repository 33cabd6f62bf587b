"""The device's own time of a block, from any of the time sources a map can name."""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from roclog.register_map import (
    Cp32,
    Cp56,
    SecondsMicroseconds,
    SplitCalendar,
    UnixSeconds,
    WordOrder,
    WordType,
)
from roclog.stamps import StampDecoder, parse_zone
from roclog.time_flags import TimeFlag
from roclog.word_types import number_reader

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from roclog.register_map import TimeSource
    from roclog.stamps import Zone

    TimeReader = Callable[[Sequence[int], int, int | None], "Clock"]

Clock = tuple[int, TimeFlag]
"""Nanoseconds UTC, 0 = unknown, and why it is unknown or what speaks against it."""

_END_OF_TIME: Final = 2**63
"""Nanoseconds since 1970 that no longer fit the 64-bit times of a recording: the year 2262."""
_SECOND: Final = 10**9
_MICROSECONDS: Final = 10**6
_LATEST: Final = _END_OF_TIME - 1
_NO_TIME: Final = (0, TimeFlag.NO_TIME)
_INVALID: Final = (0, TimeFlag.DATE_INVALID)
_GOOD: Final = TimeFlag(0)


def time_reader(
    source: TimeSource | None, order: WordOrder, *, packed: bool = False
) -> TimeReader | None:
    """A function from the words of a block, the time of their read, and ``changed_after``.

    Both in ns UTC, 0 and None = not known; a read still showed another stamp at ``changed_after``.
    None where the block has no time. ``order``: the device's, for numbers of two registers.
    ``packed``: as of the block, which then holds no calendar and no stamp.
    """
    match source:
        case None:
            return None
        case SplitCalendar():
            return _calendar(source)
        case UnixSeconds():
            return _unix(source, source.word_order or order, packed=packed)
        case SecondsMicroseconds():
            return _seconds_microseconds(source, source.word_order or order, packed=packed)
        case Cp56() | Cp32():
            return _stamp(source)


def _checked(nanoseconds: int) -> Clock:
    return (nanoseconds, _GOOD) if 0 < nanoseconds < _END_OF_TIME else _INVALID


def _unix(source: UnixSeconds, order: WordOrder, *, packed: bool) -> TimeReader:
    number = number_reader(WordType.U32, source.offset, order, packed=packed)

    def read(words: Sequence[int], read_at: int, changed_after: int | None) -> Clock:
        del read_at, changed_after
        seconds = int(number(words))
        return _checked((seconds + source.epoch) * _SECOND) if seconds else _NO_TIME

    return read


def _seconds_microseconds(
    source: SecondsMicroseconds, order: WordOrder, *, packed: bool
) -> TimeReader:
    high = number_reader(WordType.U32, source.seconds, order, packed=packed)
    low = number_reader(WordType.U32, source.microseconds, order, packed=packed)

    def read(words: Sequence[int], read_at: int, changed_after: int | None) -> Clock:
        del read_at, changed_after
        seconds, microseconds = int(high(words)), int(low(words))
        if not seconds and not microseconds:
            return _NO_TIME
        if microseconds >= _MICROSECONDS:
            return _INVALID
        return _checked(seconds * _SECOND + microseconds * 1000)

    return read


def _calendar(source: SplitCalendar) -> TimeReader:
    places, zone = source.words, parse_zone(source.zone)

    def read(words: Sequence[int], read_at: int, changed_after: int | None) -> Clock:
        del read_at, changed_after
        found = {name: words[offset] for name, offset in places}
        if not any(found.values()):
            return _NO_TIME
        parts: dict[str, int] = {}
        for name, word in found.items():
            upper, _, lower = name.partition("_")
            if name.startswith("millisecond") or not lower:
                parts[name] = word
            else:
                parts[upper], parts[lower] = divmod(word, 256)
        return _moment(parts, source.year_base, zone)

    return read


def _moment(parts: dict[str, int], year_base: int, zone: Zone) -> Clock:
    seconds, milliseconds = divmod(parts.get("millisecond_of_minute", 0), 1000)
    milliseconds += parts.get("millisecond", 0)
    if seconds > 59 or milliseconds > 999:
        return _INVALID
    try:
        moment = datetime(
            parts["year"] + year_base,
            parts["month"],
            parts["day"],
            parts["hour"],
            parts.get("minute", 0),
            parts.get("second", seconds),
            tzinfo=UTC,
        )
    except ValueError:
        return _INVALID
    local = int(moment.timestamp()) * 1000 + milliseconds
    if not 0 <= local < _END_OF_TIME // 10**6:
        return _INVALID
    utc, flags = zone.resolve(local, 0)
    if flags & TimeFlag.TIME_AMBIGUOUS:  # without a summer time bit nothing decides
        return 0, TimeFlag.TIME_UNDECIDED
    flags &= ~TimeFlag.SU_CONTRADICTION
    return (0, TimeFlag(flags)) if flags else _checked(utc * 10**6)


def _stamp(source: Cp56 | Cp32) -> TimeReader:
    size, registers = (7, 4) if isinstance(source, Cp56) else (4, 2)
    places = list(range(source.offset, source.offset + registers))
    if source.word_order.words_reversed:
        places.reverse()
    packing = struct.Struct(f"{'<' if source.word_order.octets_swapped else '>'}{registers}H")
    decoder = StampDecoder(parse_zone(source.zone))

    def read(words: Sequence[int], read_at: int, changed_after: int | None) -> Clock:
        octets = packing.pack(*(words[place] for place in places))[:size]
        # Without the host's time nothing is in the future, and nothing can be dated.
        known = changed_after if read_at else None
        stamp = decoder.decode(octets, read_at=read_at or _LATEST, changed_after=known)
        return stamp.device_time, stamp.flags

    return read

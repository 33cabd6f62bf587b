"""Where the device's time of a sample lies in its block."""

from __future__ import annotations

from dataclasses import dataclass

from roclog.register_map.kinds import WordOrder


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitCalendar:
    """Device time in calendar words; all of them zero means no time.

    Each is an offset. A name of two parts is one word with the first in its upper octet and the
    second in its lower. millisecond: of the second. millisecond_of_minute: 0 to 59999, seconds
    included. Year, month, day and hour must be given, each once; what else is not there is 0.
    year_base: added to the year, like 2000 where it has two digits.
    zone: in which the device's clock runs: "UTC", an offset like "+01:00", or an IANA name.
    """

    year: int | None = None
    month_day: int | None = None
    hour: int | None = None
    minute_second: int | None = None
    month: int | None = None
    day: int | None = None
    minute: int | None = None
    second: int | None = None
    millisecond: int | None = None
    millisecond_of_minute: int | None = None
    year_month: int | None = None
    day_hour: int | None = None
    hour_minute: int | None = None
    year_base: int = 0
    zone: str = "UTC"

    @property
    def words(self) -> tuple[tuple[str, int], ...]:
        """(name, offset) of the words that are given, in the order of the calendar."""
        names = (
            "year year_month month month_day day day_hour hour hour_minute "
            "minute minute_second second millisecond_of_minute millisecond"
        )
        given = ((name, getattr(self, name)) for name in names.split())
        return tuple((name, offset) for name, offset in given if offset is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnixSeconds:
    """Unsigned seconds since an epoch in two registers; zero means no time.

    epoch: seconds since 1970 at which the device counts 0, like 946684800 for the year 2000, or
    -3600 where it counts the seconds of a clock at +01:00.
    """

    offset: int
    word_order: WordOrder | None = None
    epoch: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondsMicroseconds:
    """Two unsigned 32-bit numbers: seconds since 1970, and microseconds; both zero = no time.

    seconds, microseconds: offsets of the two; which comes first in the block differs by device.
    """

    seconds: int
    microseconds: int
    word_order: WordOrder | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Cp56:
    """IEC 60870-5-4 CP56Time2a: seven octets in four registers, the last octet unused.

    word_order: octets follow each other upper octet first (ABCD); with BADC lower octet first. DCBA
    is the form of four registers in which the year comes first and the milliseconds last.
    zone: as of SplitCalendar; the summer time bit is honoured.
    """

    offset: int
    word_order: WordOrder = WordOrder.ABCD
    zone: str = "UTC"


@dataclass(frozen=True, slots=True, kw_only=True)
class Cp32:
    """CP32Time2a: four octets in two registers, otherwise as Cp56.

    The date comes from the host's clock and the last read that showed another stamp, so that its
    block must have a trigger.
    """

    offset: int
    word_order: WordOrder = WordOrder.ABCD
    zone: str = "UTC"


def places(time: TimeSource, *, packed: bool = False) -> list[int]:
    """Offsets of the words of a time; packed: of its octets."""
    wide = 4 if packed else 2
    match time:
        case SplitCalendar():
            return [offset for _, offset in time.words]
        case UnixSeconds() | Cp32():
            return list(range(time.offset, time.offset + wide))
        case SecondsMicroseconds(seconds=high, microseconds=low):
            return [*range(high, high + wide), *range(low, low + wide)]
        case Cp56():
            return list(range(time.offset, time.offset + 4))


TimeSource = SplitCalendar | UnixSeconds | SecondsMicroseconds | Cp56 | Cp32
"""Where the device's time of a sample lies in its block; None = the host's time is all there is."""

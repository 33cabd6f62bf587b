"""The fields of a stamp's octets, by the masks of IEC 60870-5-4 (CP56Time2a, CP32Time2a)."""

from __future__ import annotations

from datetime import date
from enum import Enum
from typing import Final, NamedTuple

from roclog.time_flags import TimeFlag

SIZES: Final = (7, 4)
"""Octets of a stamp with its date and of one without."""
YEAR_PIVOT: Final = 70
"""Two-digit years from here on belong to the 1900s."""
MINUTE_MS: Final = 60_000
HOUR_MS: Final = 60 * MINUTE_MS
DAY_MS: Final = 24 * HOUR_MS
EPOCH_DAY: Final = date(1970, 1, 1).toordinal()


class Weekday(Enum):
    """How a device counts the days of the week."""

    UNUSED = "unused"
    """Always 0."""
    ISO = "iso"
    """Monday = 1, as IEC 60870-5."""
    SUNDAY_FIRST = "sunday-first"
    """Sunday = 1, as the example of the time-stamping technique."""

    def number(self, ordinal: int) -> int:
        """The day's number; ordinal: as ``date.toordinal``."""
        match self:
            case Weekday.UNUSED:
                return 0
            case Weekday.ISO:
                return (ordinal - 1) % 7 + 1
            case Weekday.SUNDAY_FIRST:
                return ordinal % 7 + 1


class Fields(NamedTuple):
    """What the octets say, masked and not judged.

    milliseconds: 0-65535, seconds included; 60000 and more are out of range.
    minute: 0-63. hour: 0-31. iv, res1, su: the marks. reserved: a reserved bit is set.
    day: 0-31. weekday: 0-7. month: 0-15. year: 0-127, two digits. None in a stamp of 4 octets.
    """

    milliseconds: int
    minute: int
    hour: int
    iv: bool
    res1: bool
    su: bool
    reserved: bool
    day: int | None = None
    weekday: int | None = None
    month: int | None = None
    year: int | None = None


def split_stamp(octets: bytes) -> Fields:
    """The fields of one stamp.

    Raises:
        ValueError: neither 7 nor 4 octets.
    """
    check_size(octets)
    minute, hour = octets[2], octets[3]
    milliseconds = octets[0] | octets[1] << 8
    marks = bool(minute & 0x80), bool(minute & 0x40), bool(hour & 0x80)
    reserved = bool(hour & 0x60)
    if len(octets) == 4:
        return Fields(milliseconds, minute & 0x3F, hour & 0x1F, *marks, reserved)
    day, month, year = octets[4:]
    reserved |= bool(month & 0xF0 or year & 0x80)
    return Fields(
        milliseconds,
        minute & 0x3F,
        hour & 0x1F,
        *marks,
        reserved,
        day & 0x1F,
        day >> 5,
        month & 0x0F,
        year & 0x7F,
    )


def check_size(octets: bytes) -> None:
    """Raises: ValueError: neither 7 nor 4 octets."""
    if len(octets) not in SIZES:
        raise ValueError(f"a stamp has 7 or 4 octets, not {len(octets)}")


def check_pivot(year_pivot: int) -> None:
    """Raises: ValueError: outside 70 to 100."""
    if not 70 <= year_pivot <= 100:
        raise ValueError(f"year_pivot is {year_pivot}, must be 70 to 100 (100: every year is 20yy)")


def full_year(year: int, year_pivot: int = YEAR_PIVOT) -> int:
    """The year of two digits: 19yy from the pivot on, else 20yy."""
    return year + (1900 if year >= year_pivot else 2000)


def weekday_of(octets: bytes, year_pivot: int = YEAR_PIVOT) -> tuple[Weekday, ...]:
    """The conventions under which the day of the week fits the date; empty = none of them.

    Raises:
        ValueError: the octets hold no date that exists.
    """
    fields = split_stamp(octets)
    if fields.day is None or fields.month is None or fields.year is None:
        raise ValueError("a stamp of 4 octets has no date")
    if fields.year > 99:
        raise ValueError(f"year {fields.year} is above 99")
    ordinal = date(full_year(fields.year, year_pivot), fields.month, fields.day).toordinal()
    return tuple(way for way in Weekday if way.number(ordinal) == fields.weekday)


def minute_octet(octet: int) -> tuple[int, int]:
    """Milliseconds of the hour's part before this minute, and flags."""
    minute = octet & 0x3F
    flags = TimeFlag.MINUTE_RANGE if minute > 59 else TimeFlag(0)
    flags |= TimeFlag.RES1 if octet & 0x40 else 0
    flags |= TimeFlag.IV if octet & 0x80 else 0
    return minute * MINUTE_MS, int(flags)


def hour_octet(octet: int) -> tuple[int, int, int]:
    """Milliseconds of the day before this hour, the summer time bit, and flags."""
    hour = octet & 0x1F
    flags = TimeFlag.HOUR_RANGE if hour > 23 else TimeFlag(0)
    flags |= TimeFlag.RESERVED_BITS if octet & 0x60 else 0
    flags |= TimeFlag.SU if octet & 0x80 else 0
    return hour * HOUR_MS, octet >> 7, int(flags)


def date_octets(octets: bytes, year_pivot: int) -> tuple[int | None, int]:
    """Day number from 1970-01-01 = 0, None where there is none, and flags."""
    day, month, year = octets
    flags = int(TimeFlag.RESERVED_BITS) if month & 0xF0 or year & 0x80 else 0
    number, month, year = day & 0x1F, month & 0x0F, year & 0x7F
    if not number or not month:
        return None, flags | TimeFlag.NO_TIME
    if year > 99:
        return None, flags | TimeFlag.DATE_INVALID
    try:
        ordinal = date(full_year(year, year_pivot), month, number).toordinal()
    except ValueError:
        return None, flags | TimeFlag.DATE_INVALID
    if all(way.number(ordinal) != day >> 5 for way in Weekday):
        flags |= TimeFlag.DOW_MISMATCH
    return ordinal - EPOCH_DAY, flags

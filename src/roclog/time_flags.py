"""What a stamp says besides its time. Recorded as a number, so the values are stable for ever."""

from __future__ import annotations

from enum import IntFlag
from typing import Final


class TimeFlag(IntFlag):
    """Facts about a stamp, and the reasons why it gives no device time."""

    NO_TIME = 1
    """No time was ever set: every stamp word is zero, or a day or month of 0."""
    DATE_INVALID = 2
    """The fields do not form a date and time that exists, or one outside 1970 to 2262."""
    IV = 4
    """The device says itself that the time is invalid (bit 7 of the minute octet)."""
    RES1 = 8
    """Bit 6 of the minute octet is set: reserved, by some devices used for "substituted"."""
    SU = 16
    """The device says that this is summer time (bit 7 of the hour octet)."""
    RESERVED_BITS = 32
    """A bit is set that has no meaning: hour 5-6, month 4-7, year 7."""
    MS_RANGE = 64
    """Milliseconds above 59999."""
    MINUTE_RANGE = 128
    """A minute above 59."""
    HOUR_RANGE = 256
    """An hour above 23."""
    DOW_MISMATCH = 512
    """The day of the week is neither 0 nor the date's, counted from Monday or from Sunday = 1."""
    DATE_INFERRED = 1024
    """A stamp without a date, dated by the host's clock."""
    LAYOUT_AMBIGUOUS = 2048
    """Which octets are the stamp could not be told."""
    FUTURE = 4096
    """Later than the host's clock by more than the tolerance."""
    SU_CONTRADICTION = 8192
    """Marked summer time when the zone has none, or not marked when it has."""
    TIME_AMBIGUOUS = 16384
    """The zone shows this time twice; the summer time bit chose."""
    TIME_NONEXISTENT = 32768
    """The zone's clocks skip this time."""
    LENIENT = 65536
    """A time is given in spite of MS_RANGE or SU_CONTRADICTION, since the user asked for that."""
    DATE_UNKNOWN = 131072
    """A stamp without a date to which no date, or more than one, fits."""
    TIME_UNDECIDED = 262144
    """The zone shows this time twice, and the summer time bit is the same both times."""


def flag_words(flags: TimeFlag) -> str:
    """The names of the flags that are set, in lower case."""
    return " ".join(str(flag.name).lower() for flag in TimeFlag if flag in flags)


_SPOILT: Final = int(
    TimeFlag.NO_TIME
    | TimeFlag.DATE_INVALID
    | TimeFlag.IV
    | TimeFlag.MINUTE_RANGE
    | TimeFlag.HOUR_RANGE
    | TimeFlag.LAYOUT_AMBIGUOUS
    | TimeFlag.TIME_NONEXISTENT
    | TimeFlag.DATE_UNKNOWN
    | TimeFlag.TIME_UNDECIDED
)
_DOUBTFUL: Final = int(TimeFlag.MS_RANGE | TimeFlag.SU_CONTRADICTION)


def is_trusted(flags: int) -> bool:
    """Whether a stamp with these flags gives a device time."""
    if flags & _SPOILT:
        return False
    return not flags & _DOUBTFUL or bool(flags & TimeFlag.LENIENT)

"""UTC to the octets of a stamp, as a device in a zone would send it."""

from __future__ import annotations

from datetime import date
from typing import TYPE_CHECKING

from roclog.stamps.decoder import UTC_ZONE
from roclog.stamps.fields import (
    DAY_MS,
    EPOCH_DAY,
    HOUR_MS,
    MINUTE_MS,
    SIZES,
    YEAR_PIVOT,
    Weekday,
    check_pivot,
)

if TYPE_CHECKING:
    from roclog.stamps.zone import Zone


def encode_stamp(
    instant: int,
    zone: Zone = UTC_ZONE,
    *,
    size: int = 7,
    year_pivot: int = YEAR_PIVOT,
    weekday: Weekday = Weekday.UNUSED,
    iv: bool = False,
    res1: bool = False,
    su: bool | None = None,
) -> bytes:
    """The stamp of an instant, nanoseconds UTC; what is finer than a millisecond is cut off.

    size: 7, or 4 without the date. su: None = as the zone has it.

    Raises:
        ValueError: another size, or a year that two digits cannot tell with this pivot.
    """
    if size not in SIZES:
        raise ValueError(f"a stamp has 7 or 4 octets, not {size}")
    check_pivot(year_pivot)
    local, summer = zone.local(instant // 10**6)
    days, past = divmod(local, DAY_MS)
    day = date.fromordinal(days + EPOCH_DAY)
    if size == 7 and not 1900 + year_pivot <= day.year < 2000 + year_pivot:
        years = f"{1900 + year_pivot} to {1999 + year_pivot}"
        raise ValueError(f"year {day.year} is not one of {years}, which two digits can tell")
    hour, past = divmod(past, HOUR_MS)
    minute, milliseconds = divmod(past, MINUTE_MS)
    octets = milliseconds.to_bytes(2, "little") + bytes(
        (
            minute | iv << 7 | res1 << 6,
            hour | (summer if su is None else su) << 7,
            day.day | weekday.number(days + EPOCH_DAY) << 5,
            day.month,
            day.year % 100,
        )
    )
    return octets[:size]

"""Time stamps of 7 and 4 octets as a device writes them (CP56Time2a and CP32Time2a)."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import cache
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo

if TYPE_CHECKING:
    from datetime import tzinfo

NEVER_SET = bytes(7)
MS = 1_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_INVALID = 0x80
_SUMMER = 0x80


@cache
def zone(name: str) -> tzinfo:
    return UTC if name == "UTC" else ZoneInfo(name)


def octets(utc_ns: int, zone_name: str = "UTC", *, dow: str = "iso", iv: bool = False) -> bytes:
    """All 7; the first 4 are the short stamp. Below a millisecond everything is cut off.

    dow: unused, iso (1 = Monday) or sunday (1 = Sunday).
    """
    local = (_EPOCH + timedelta(milliseconds=utc_ns // MS)).astimezone(zone(zone_name))
    milliseconds = 1000 * local.second + local.microsecond // 1000
    days = {"unused": 0, "iso": local.isoweekday(), "sunday": local.isoweekday() % 7 + 1}
    return milliseconds.to_bytes(2, "little") + bytes(
        [
            local.minute | (_INVALID if iv else 0),
            local.hour | (_SUMMER if local.dst() else 0),
            local.day | days[dow] << 5,
            local.month,
            local.year % 100,
        ]
    )

"""Time stamps of 7 and 4 octets (CP56Time2a and CP32Time2a of IEC 60870-5) to UTC and back.

``docs/time-stamped-inputs.md`` specifies every decision made here. Pure: no clock is read; the one
file ever read is the zone's table, when ``parse_zone`` meets its name.
"""

from __future__ import annotations

from roclog.stamps.decoder import TOLERANCE, Stamp, StampDecoder
from roclog.stamps.encoder import encode_stamp
from roclog.stamps.fields import Fields, Weekday, split_stamp, weekday_of
from roclog.stamps.zone import Zone, parse_zone

__all__ = [
    "TOLERANCE",
    "Fields",
    "Stamp",
    "StampDecoder",
    "Weekday",
    "Zone",
    "encode_stamp",
    "parse_zone",
    "split_stamp",
    "weekday_of",
]

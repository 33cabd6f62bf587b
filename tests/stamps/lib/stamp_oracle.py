"""A second decoder of stamps, slow and plain, from the paper's tables and the zone's own clock.

It asks the zone only one thing: what does a clock on the wall show at this instant of UTC? A local
time is then read backwards, by trying every offset that was in force around it. It shares no code
with the package, neither imports nor tables.
"""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from functools import cache
from zoneinfo import ZoneInfo

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
HOUR = timedelta(hours=1)
MS = timedelta(milliseconds=1)
DAY = timedelta(days=1)
NAMES = {
    "no_time": 1,
    "date_invalid": 2,
    "iv": 4,
    "res1": 8,
    "su": 16,
    "reserved_bits": 32,
    "ms_range": 64,
    "minute_range": 128,
    "hour_range": 256,
    "dow_mismatch": 512,
    "date_inferred": 1024,
    "layout_ambiguous": 2048,
    "future": 4096,
    "su_contradiction": 8192,
    "time_ambiguous": 16384,
    "time_nonexistent": 32768,
    "lenient": 65536,
    "date_unknown": 131072,
    "time_undecided": 262144,
}
"""As docs/time-stamped-inputs.md numbers them."""
FATAL = {
    "no_time", "date_invalid", "iv", "minute_range", "hour_range", "layout_ambiguous",
    "time_nonexistent", "date_unknown", "time_undecided",
}  # fmt: skip


@cache
def zone(name: str) -> tzinfo:
    if name == "UTC":
        return UTC
    if name[0] in "+-":
        minutes = int(name[1:3]) * 60 + int(name[4:])
        return timezone(timedelta(minutes=-minutes if name[0] == "-" else minutes))
    return ZoneInfo(name)


def instant(nanoseconds: int) -> datetime:
    return EPOCH + timedelta(microseconds=nanoseconds // 1000)


def nanoseconds(moment: datetime) -> int:
    return (moment - EPOCH) // timedelta(microseconds=1) * 1000


def wall(moment: datetime, name: str) -> datetime:
    return moment.astimezone(zone(name)).replace(tzinfo=None)


@cache
def winter_is_negative(name: str, year: int) -> bool:
    """The table writes the time in winter as an hour less than standard (Dublin, Casablanca)."""
    noon = datetime(year, 1, 1, 12, tzinfo=UTC)
    return any(
        ((noon + n * DAY).astimezone(zone(name)).dst() or timedelta()) < timedelta()
        for n in range(365)
    )


def summer(moment: datetime, name: str) -> bool:
    there = moment.astimezone(zone(name))
    saving = there.dst() or timedelta()
    return saving > timedelta() if saving else winter_is_negative(name, there.year)


def readings(local: datetime, name: str) -> list[datetime]:
    """Every instant at which the zone's clocks show this local time, in order."""
    middle = local.replace(tzinfo=UTC)
    around = [(middle + n * HOUR).astimezone(zone(name)) for n in (-40, -24, -8, 8, 24, 40)]
    offsets = {there.utcoffset() or timedelta() for there in around}
    return sorted({m for m in (middle - o for o in offsets) if wall(m, name) == local})


def place(local: datetime, name: str, *, su: bool) -> tuple[datetime, set[str]]:
    found = readings(local, name)
    if not found:
        middle = local.replace(tzinfo=UTC)
        before = (middle - 40 * HOUR).astimezone(zone(name)).utcoffset() or timedelta()
        return middle - before, {"time_nonexistent"}
    fitting = [moment for moment in found if summer(moment, name) == su]
    if len(found) == 1:
        return found[0], set() if fitting else {"su_contradiction"}
    if len(fitting) == 1:
        return fitting[0], {"time_ambiguous"}
    return found[0], {"time_undecided"} if fitting else {"time_undecided", "su_contradiction"}


def decode(
    octets: bytes,
    name: str,
    *,
    read_at: int,
    changed_after: int | None,
    pivot: int = 70,
    lenient: bool = False,
    tolerance: int = 600 * 10**9,
) -> tuple[int, set[str]]:
    """Nanoseconds UTC, 0 = unknown, and the names of the flags."""
    time, flags = _decode(octets, name, read_at, changed_after, pivot, tolerance)
    doubts = flags & {"ms_range", "su_contradiction"}
    if doubts and lenient:
        flags.add("lenient")
    if flags & FATAL or (doubts and not lenient):
        time = 0
    elif not 0 < time < 2**63:
        time = 0
        flags.add("date_invalid")
    elif time > read_at + tolerance:
        flags.add("future")
    return time, flags


def _decode(  # noqa: PLR0917
    octets: bytes, name: str, read_at: int, changed_after: int | None, pivot: int, tolerance: int
) -> tuple[int, set[str]]:
    ms, minute, hour = int.from_bytes(octets[:2], "little"), octets[2] % 64, octets[3] % 32
    su = octets[3] >= 128
    flags = {
        name
        for name, is_set in (
            ("iv", octets[2] >= 128),
            ("res1", octets[2] % 128 >= 64),
            ("su", su),
            ("reserved_bits", octets[3] % 128 >= 32),
            ("ms_range", ms > 59999),
            ("minute_range", minute > 59),
            ("hour_range", hour > 23),
        )
        if is_set
    }
    if len(octets) == 4 and octets == bytes(4):
        return 0, {"no_time"}
    dates, more = _dates(octets[4:], name, read_at, pivot)
    flags |= more
    if not dates or flags & {"minute_range", "hour_range"}:
        return 0, flags
    if len(octets) == 4 and changed_after is None:
        return 0, flags | {"date_unknown"}
    placed = []
    for day in dates:
        local = datetime(day.year, day.month, day.day, hour, minute)  # noqa: DTZ001
        local += (0 if ms > 59999 else ms) * MS
        moment, more = place(local, name, su=su)
        moment += (ms if ms > 59999 else 0) * MS
        placed.append((nanoseconds(moment), more))
    if len(octets) == 7:
        return placed[0][0], flags | placed[0][1]
    assert changed_after is not None
    return _choose(
        sorted(placed, key=lambda p: p[0]), flags, read_at + tolerance, changed_after, tolerance
    )


def _choose(
    placed: list[tuple[int, set[str]]],
    flags: set[str],
    limit: int,
    changed_after: int,
    tolerance: int,
) -> tuple[int, set[str]]:
    past = [p for p in placed if p[0] <= limit]
    if len(past) > 1 and past[-1][0] == past[-2][0] and "time_nonexistent" in past[-1][1]:
        past[-2:] = past[:-3:-1]
    if not past:
        return placed[0][0], flags | placed[0][1] | {"date_unknown"}
    time, more = past[-1]
    half_a_day = 12 * 3600 * 10**9
    known = time >= changed_after - half_a_day and all(
        earlier < changed_after - tolerance or "time_nonexistent" in marks
        for earlier, marks in past[:-1]
    )
    return time, flags | more | {"date_inferred" if known else "date_unknown"}


def _dates(octets: bytes, name: str, read_at: int, pivot: int) -> tuple[list[date], set[str]]:
    if not octets:
        host = wall(instant(read_at), name).date()
        return [host - DAY, host, host + DAY], set()
    day, dow, month, year = octets[0] % 32, octets[0] // 32, octets[1] % 16, octets[2] % 128
    flags = {"reserved_bits"} if octets[1] > 15 or octets[2] > 127 else set()
    if day == 0 or month == 0:
        return [], flags | {"no_time"}
    try:
        there = date((1900 if year >= pivot else 2000) + year, month, day)
    except ValueError:
        return [], flags | {"date_invalid"}
    if year > 99:
        return [], flags | {"date_invalid"}
    if dow not in (0, there.isoweekday(), there.isoweekday() % 7 + 1):
        flags.add("dow_mismatch")
    return [there], flags

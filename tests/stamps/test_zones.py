"""Every minute around every change of a zone's clocks, 1970 to 2069, against the second decoder."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import TYPE_CHECKING

import pytest
import stamp_oracle
from hypothesis import example, given, settings
from hypothesis import strategies as st

from roclog.stamps import StampDecoder, Weekday, encode_stamp, parse_zone, split_stamp, weekday_of
from roclog.time_flags import TimeFlag, is_trusted

if TYPE_CHECKING:
    from collections.abc import Iterator

ZONES = [
    "Europe/Berlin",
    "America/New_York",
    "Australia/Lord_Howe",
    "Asia/Kolkata",
    "Pacific/Apia",
    "Europe/Dublin",
    "Europe/Moscow",
    "Africa/Casablanca",
    "Africa/Monrovia",
    "America/Caracas",
    "America/St_Johns",
]
PROPERTY = settings(derandomize=True, deadline=None, max_examples=300)
LAST = datetime(2070, 1, 1, tzinfo=UTC)
SECOND = 10**9
DAY = 86400 * SECOND
HOST = stamp_oracle.nanoseconds(datetime(2069, 12, 31, tzinfo=UTC)) + DAY
BEFORE = timedelta(minutes=3)


def offset(moment: datetime, name: str) -> timedelta:
    return stamp_oracle.wall(moment, name) - moment.replace(tzinfo=None)


@cache
def changes(name: str) -> list[tuple[datetime, timedelta]]:
    """Instants at which clocks move, and by how much."""
    found = []
    now = datetime(1970, 1, 2, tzinfo=UTC)
    while now < LAST:
        low, high = now, now + timedelta(hours=20)
        now = high
        if offset(low, name) == offset(high, name):
            continue
        while high - low > timedelta(seconds=1):
            middle = low + (high - low) // 2 // timedelta(seconds=1) * timedelta(seconds=1)
            before = offset(middle, name) == offset(low, name)
            low, high = (middle, high) if before else (low, middle)
        found.append((high, offset(high, name) - offset(low, name)))
    return found


def stamp(local: datetime, *, su: bool) -> bytes:
    """Octets written by the paper's table alone."""
    ms = local.second * 1000 + local.microsecond // 1000
    return bytes(
        (ms % 256, ms // 256, local.minute, local.hour + 128 * su, local.day, local.month)
    ) + bytes([local.year % 100])


def minutes_around(name: str) -> Iterator[datetime]:
    """Local times from before to after each change, on the minute and just before it."""
    for moment, step in changes(name):
        was = stamp_oracle.wall(moment - timedelta(seconds=1), name) + timedelta(seconds=1)
        first = min(was, was + step) - BEFORE
        for n in range(int((abs(step) + 2 * BEFORE) / timedelta(minutes=1))):
            yield first + timedelta(minutes=n)
            yield first + timedelta(minutes=n) - timedelta(milliseconds=1)


@pytest.mark.parametrize("name", ZONES)
def test_every_minute_around_every_change(name: str) -> None:
    decoder = StampDecoder(parse_zone(name))
    for local in minutes_around(name):
        for su in (False, True):
            octets = stamp(local, su=su)
            time, flags = stamp_oracle.decode(octets, name, read_at=HOST, changed_after=None)
            found = decoder.decode(octets, read_at=HOST, changed_after=None)
            assert found.device_time == time, (local, su)
            assert found.flags == sum(stamp_oracle.NAMES[flag] for flag in flags), (local, su)


@pytest.mark.parametrize("name", ZONES)
def test_there_and_back_around_every_change(name: str) -> None:
    """Seven octets and four, as of a device that follows its zone."""
    zone = parse_zone(name)
    decoder = StampDecoder(zone)
    for moment, step in changes(name):
        start = stamp_oracle.nanoseconds(moment) - abs(step) // timedelta(seconds=1) * SECOND
        for n in range(-2, int(2 * abs(step) / timedelta(minutes=1)) + 2):
            instant = start + n * 60 * SECOND + 1_000_000
            octets = encode_stamp(instant, zone)
            found = decoder.decode(octets, read_at=instant + SECOND, changed_after=None)
            if found.flags & TimeFlag.TIME_UNDECIDED:
                assert found.device_time == 0
                continue
            assert found.device_time == instant
            assert not found.flags & ~(TimeFlag.SU | TimeFlag.TIME_AMBIGUOUS)
            short = decoder.decode(
                octets[:4], read_at=instant + SECOND, changed_after=instant - SECOND
            )
            if not short.flags & TimeFlag.DATE_UNKNOWN:  # near a day that is left out
                assert short.device_time == instant
                assert short.flags == found.flags | TimeFlag.DATE_INFERRED
            else:
                assert abs(step) >= timedelta(hours=20)


@pytest.mark.parametrize("name", ["UTC", "+05:45", *ZONES])
@pytest.mark.parametrize("size", [7, 4])
def test_every_midnight(name: str, size: int) -> None:
    """Month ends, New Year and 29 February are among them."""
    zone = parse_zone(name)
    decoder = StampDecoder(zone)
    day = datetime(1972, 2, 1)  # noqa: DTZ001 - on the wall
    count = 0
    while day.year < 2069:
        day += timedelta(days=1)
        found = stamp_oracle.readings(day, name) if day.day in (1, 28, 29) else []
        for edge in (stamp_oracle.nanoseconds(moment) for moment in found):
            for instant in (edge - 1_000_000, edge, edge + 1_000_000):
                octets = encode_stamp(instant, zone, size=size)
                back = decoder.decode(
                    octets, read_at=instant + 2 * SECOND, changed_after=instant - 2 * SECOND
                )
                if back.flags & (TimeFlag.TIME_UNDECIDED | TimeFlag.DATE_UNKNOWN):
                    continue
                if octets == bytes(4):
                    assert back.flags == TimeFlag.NO_TIME
                    continue
                assert back.device_time == instant
                count += 1
    assert count > 5000


@PROPERTY
@given(
    st.one_of(st.binary(min_size=7, max_size=7), st.binary(min_size=4, max_size=4)),
    st.sampled_from(["UTC", "+14:00", "-09:30", *ZONES]),
    st.integers(0, 2**63 - 1),
    st.one_of(st.none(), st.integers(-DAY, 3 * DAY)),
    st.sampled_from([70, 85, 100]),
    st.booleans(),
)
@example(b"\x00\x00\x00\x00", "UTC", 0, 0, 70, False)
@example(b"\x01\x00\x00\x00", "Pacific/Apia", 1_325_239_200 * SECOND, 0, 70, True)
@example(bytes.fromhex("693d160d"), "UTC", 2**63 - 1, 0, 70, False)
def test_any_octets(  # noqa: PLR0917
    octets: bytes, name: str, read_at: int, ago: int | None, pivot: int, lenient: bool
) -> None:
    changed_after = None if ago is None else read_at - ago
    decoder = StampDecoder(parse_zone(name), year_pivot=pivot, lenient=lenient)
    found = decoder.decode(octets, read_at=read_at, changed_after=changed_after)
    time, flags = stamp_oracle.decode(
        octets, name, read_at=read_at, changed_after=changed_after, pivot=pivot, lenient=lenient
    )
    assert found.device_time == time
    assert found.flags == sum(stamp_oracle.NAMES[flag] for flag in flags)
    assert bool(found.device_time) == is_trusted(found.flags)


def test_many_are_decoded_as_one_by_one() -> None:
    decoder = StampDecoder(parse_zone("Europe/Berlin"))
    octets = [stamp(local, su=True) for local in list(minutes_around("Europe/Berlin"))[:5000]]
    octets += [o[:4] for o in octets[:100]]
    together = decoder.decode_all(octets, read_at=HOST, changed_after=HOST - SECOND)
    apart = [decoder.decode(o, read_at=HOST, changed_after=HOST - SECOND) for o in octets]
    assert together == apart


def test_more_days_than_are_remembered() -> None:
    decoder = StampDecoder()
    for _ in range(2):
        for number in range(1, 3000):
            instant = number * DAY
            found = decoder.decode(encode_stamp(instant), read_at=instant, changed_after=None)
            assert found.device_time == instant


@pytest.mark.parametrize("way", Weekday)
def test_the_day_of_the_week(way: Weekday) -> None:
    for number in range(1, 30):
        octets = encode_stamp(number * DAY, weekday=way)
        weekday = (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(number)).isoweekday()
        numbers = {Weekday.UNUSED: 0, Weekday.ISO: weekday, Weekday.SUNDAY_FIRST: weekday % 7 + 1}
        assert split_stamp(octets).weekday == numbers[way]
        assert weekday_of(octets) == (way,)


def test_marks_are_encoded() -> None:
    fields = split_stamp(encode_stamp(DAY, iv=True, res1=True, su=True))
    assert (fields.iv, fields.res1, fields.su, fields.reserved) == (True, True, True, False)
    octets = encode_stamp(DAY, iv=True)
    found = StampDecoder().decode(octets, read_at=DAY, changed_after=None)
    assert (found.device_time, found.flags) == (0, TimeFlag.IV)


def test_marks_from_outside() -> None:
    found = StampDecoder().decode(encode_stamp(DAY), read_at=DAY, changed_after=None)
    assert found.marked(TimeFlag.RES1) == found._replace(flags=TimeFlag.RES1)
    doubtful = found.marked(TimeFlag.LAYOUT_AMBIGUOUS)
    assert (doubtful.device_time, doubtful.flags) == (0, TimeFlag.LAYOUT_AMBIGUOUS)


@pytest.mark.parametrize("text", ["localtime", "Europe", "Europa/Berlin", "../etc/passwd", "", "Z"])
def test_no_zone(text: str) -> None:
    with pytest.raises(ValueError, match="is not a time zone: UTC, an offset like"):
        parse_zone(text)


@pytest.mark.parametrize("text", ["+14:01", "-12:01", "+01:60", "+99:00"])
def test_no_offset(text: str) -> None:
    with pytest.raises(ValueError, match="is not an offset from UTC: -12:00 to"):
        parse_zone(text)


@pytest.mark.parametrize("text", ["UTC", "+14:00", "-12:00", "+00:00", "Europe/Berlin", "EST5EDT"])
def test_zone(text: str) -> None:
    assert parse_zone(text).name == text


def test_a_machine_without_tables() -> None:
    program = """
import sys
sys.modules["tzdata"] = None
from roclog.stamps import parse_zone
for text in ("UTC", "+01:00", "Europe/Vienna"):
    try:
        print(parse_zone(text))
    except ValueError as error:
        print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={"PYTHONTZPATH": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [
        "Zone('UTC')",
        "Zone('+01:00')",
        (
            "'Europe/Vienna' cannot be looked up: this machine has no time zone tables;"
            " install the Debian package tzdata or the Python package tzdata"
        ),
    ]


@pytest.mark.parametrize("octets", [b"", bytes(3), bytes(5), bytes(6), bytes(8)])
def test_size(octets: bytes) -> None:
    with pytest.raises(ValueError, match=f"7 or 4 octets, not {len(octets)}"):
        StampDecoder().decode(octets, read_at=DAY, changed_after=None)
    with pytest.raises(ValueError, match=f"7 or 4 octets, not {len(octets)}"):
        split_stamp(octets)
    with pytest.raises(ValueError, match="7 or 4 octets"):
        encode_stamp(DAY, size=len(octets))


def test_wrong_arguments() -> None:
    for read_at in (-1, 2**63):
        with pytest.raises(ValueError, match="is not between 1970 and 2262"):
            StampDecoder().decode(bytes(7), read_at=read_at, changed_after=None)
    for pivot in (69, 101):
        with pytest.raises(ValueError, match="must be 70 to 100"):
            StampDecoder(year_pivot=pivot)
    with pytest.raises(ValueError, match="half a day"):
        StampDecoder(tolerance=-1)
    with pytest.raises(ValueError, match="year 2070 is not one of 1970 to 2069"):
        encode_stamp(stamp_oracle.nanoseconds(datetime(2070, 1, 1, tzinfo=UTC)))
    assert encode_stamp(4 * 10**18, size=4) == encode_stamp(4 * 10**18, size=7, year_pivot=100)[:4]
    with pytest.raises(ValueError, match="no date"):
        weekday_of(bytes(4))

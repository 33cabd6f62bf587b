"""Durations, sizes and instants: exact, or refused."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.quantities import (
    format_duration,
    format_instant,
    parse_duration,
    parse_instant,
    parse_size,
)

PROPERTY = settings(derandomize=True, deadline=None)


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("0s", 0),
        ("1us", 1_000),
        ("0.001us", 1),
        ("500ms", 500_000_000),
        ("1.5 h", 5_400_000_000_000),
        (" 15 s ", 15_000_000_000),
        ("1min", 60_000_000_000),
        ("90d", 7_776_000_000_000_000),
        ("0.000000001s", 1),
        ("123456789012345678901234567890.000000001s", 123456789012345678901234567890000000001),
    ],
)
def test_durations(text: str, nanoseconds: int) -> None:
    assert parse_duration(text) == nanoseconds


@pytest.mark.parametrize(
    "text",
    [
        "",
        "s",
        "5",
        "5 S",
        "5m",
        "-1s",
        "+1s",
        "1e3s",
        ".5s",
        "5.s",
        "1 s s",
        "1,5s",
        "inf s",
        "nans",
        "0.0001us",
        "0.0000000001s",
        "1.00000000000000000000000000000000001s",
        "٣s",
        "1\u2009s",
    ],
)
def test_texts_that_are_no_duration(text: str) -> None:
    with pytest.raises(ValueError):
        parse_duration(text)


@pytest.mark.parametrize(
    ("text", "octets"),
    [("0B", 0), ("64 MiB", 2**26), ("1.5KiB", 1536), ("20 GiB", 20 * 2**30), ("1TiB", 2**40)],
)
def test_sizes(text: str, octets: int) -> None:
    assert parse_size(text) == octets


@pytest.mark.parametrize("text", ["64", "64 MB", "64 mib", "0.5B", "1.0001KiB", "-1B"])
def test_texts_that_are_no_size(text: str) -> None:
    with pytest.raises(ValueError):
        parse_size(text)


@pytest.mark.parametrize(
    ("nanoseconds", "text"),
    [
        (0, "0us"),
        (1, "0.001us"),
        (1_500, "1.5us"),
        (500_000_000, "500ms"),
        (15_000_000_000, "15s"),
        (90_000_000_000, "1.5min"),
        (100 * 86400 * 10**9, "100d"),
        (1_000_000_001, "1000000.001us"),
    ],
)
def test_durations_as_text(nanoseconds: int, text: str) -> None:
    assert format_duration(nanoseconds) == text


@PROPERTY
@given(st.integers(0, 2**63))
def test_durations_there_and_back(nanoseconds: int) -> None:
    assert parse_duration(format_duration(nanoseconds)) == nanoseconds


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1970-01-01", 0),
        ("1970-01-01T00:00:00.000000001Z", 1),
        ("1969-12-31T23:59:59.5Z", -500_000_000),
        ("2026-11-23 06:00:00", 1_795_413_600 * 10**9),
        ("2026-11-23T08:00:00+02:00", 1_795_413_600 * 10**9),
        ("2026-11-23T00:30:00-05:30", 1_795_413_600 * 10**9),
        ("2000-02-29T00:00:00Z", 951_782_400 * 10**9),
    ],
)
def test_instants(text: str, nanoseconds: int) -> None:
    assert parse_instant(text) == nanoseconds


@pytest.mark.parametrize(
    "text",
    [
        "",
        "now",
        "2026-11-23T06:00",
        "2026-02-30",
        "2026-13-01T00:00:00Z",
        "2026-11-23T24:00:00Z",
        "2026-11-23T06:00:60Z",
        "2026-11-23T06:00:00.1234567891Z",
        "2026-11-23T06:00:00+25:00",
        "0000-01-01",
        "\uff12026-11-23",
        "2026-11-23T06:00:00z",
        "2026-11-23T06:00:00Z\n",
    ],
)
def test_texts_that_are_no_instant(text: str) -> None:
    with pytest.raises(ValueError):
        parse_instant(text)


@PROPERTY
@given(st.integers(-(2**63), 2**63 - 1))
def test_instants_there_and_back(nanoseconds: int) -> None:
    assert parse_instant(format_instant(nanoseconds)) == nanoseconds


@pytest.mark.parametrize(
    ("nanoseconds", "text"),
    [
        (0, "1970-01-01T00:00:00Z"),
        (1, "1970-01-01T00:00:00.000000001Z"),
        (-1, "1969-12-31T23:59:59.999999999Z"),
        (1_795_413_600_120_000_000, "2026-11-23T06:00:00.12Z"),
        (2**63 - 1, "2262-04-11T23:47:16.854775807Z"),
    ],
)
def test_instants_as_text(nanoseconds: int, text: str) -> None:
    assert format_instant(nanoseconds) == text

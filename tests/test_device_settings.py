"""Settings of the ROC as people write them: truth is the write ranges of its document, 4.0."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roclog.commanding.settings import (
    Difference,
    SettingErrors,
    Step,
    assumed,
    describe,
    differences,
    expected,
    parse_settings,
    plan,
    writable_of,
)
from roclog.devices import PROFILES
from roclog.devices.hiac_roc import REGISTER_MAP as ROC

NOW = 1_795_000_000 * 10**9 + 123
"""2026-11-18T11:06:40Z."""
SECOND = 10**9
DEFAULTS = (138, 0, 0, 0, 0, 0x000A, 0x0005, 0, 1, 0, 0xFFFD, 0xFFFD, 0xFFFD, 0xFFFD)
"""Column "Data Default" of registers 100-113."""
FIELDS = {
    "node_id": (100, range(1, 248)),
    "date_year": (101, range(2000, 2101)),
    "time_hour": (103, range(24)),
    "alarm_trigger": (107, range(4)),
    "alarm_direction": (108, range(2)),
    "alarm_logic": (109, range(2)),
}
"""Column "Data Write Range" of what is one number."""
TIMES = {"time_minute": (104, 0), "sample_period": (105, 5), "hold_period": (106, 2)}
"""Register and least seconds; the most is 59:59."""
ISO = {-3, *range(30), *range(291)}
NAS = {-3, -1, *range(13), *range(121)}
SAE = {-3, -2, -1, *range(13), *range(121)}
LIMITS = {
    ("limit_1", "ISO"): (110, 1, ISO),
    ("limit_2", "ISO"): (111, 1, ISO),
    ("limit_3", "ISO"): (112, 1, ISO),
    ("limit_4", "ISO"): (113, 1, ISO),
    ("limit_1", "NAS"): (110, 2, NAS),
    ("limit_2", "NAS"): (111, 2, NAS),
    ("limit_3", "NAS"): (112, 2, {-3}),
    ("limit_4", "NAS"): (113, 2, {-3}),
    ("limit_1", "SAE"): (110, 3, SAE),
    ("limit_2", "SAE"): (111, 3, SAE),
    ("limit_3", "SAE"): (112, 3, SAE),
    ("limit_4", "SAE"): (113, 3, SAE),
}
"""Register, register 107, and both readings: "0-29" as it stands, and in tenths."""


def words_of(*texts: str, words: tuple[int, ...] = DEFAULTS) -> dict[int, int]:
    """Register to word of every step."""
    found = plan(ROC, parse_settings(ROC, texts, NOW), words)
    return {step.address: step.new for step in found.steps}


def problems_of(*texts: str, words: tuple[int, ...] = DEFAULTS) -> tuple[str, ...]:
    with pytest.raises(SettingErrors) as caught:
        plan(ROC, parse_settings(ROC, texts, NOW), words)
    return caught.value.problems


@pytest.mark.parametrize("name", FIELDS)
def test_every_number_of_a_write_range_and_none_besides(name: str) -> None:
    register, allowed = FIELDS[name]
    other = tuple(0x7777 for _ in DEFAULTS)
    for number in allowed:
        assert words_of(f"{name}={number}", words=other) == {register: number}
    for number in (allowed[0] - 1, allowed[-1] + 1, -1, 65536, 10**30):
        if number not in allowed:
            assert f"{name}: {number} is not " in problems_of(f"{name}={number}")[0]


@pytest.mark.parametrize("name", TIMES)
def test_every_time_of_a_write_range_and_none_besides(name: str) -> None:
    register, least = TIMES[name]
    other = tuple(0x7777 for _ in DEFAULTS)
    for seconds in range(3600):
        minutes, rest = seconds // 60, seconds % 60
        for text in (f"{minutes:02}:{rest:02}", f"{seconds}s", f"{seconds * 1000}ms"):
            if seconds < least:
                assert problems_of(f"{name}={text}")[0].startswith(f"{name}: ")
            else:
                word = {register: 256 * minutes + rest}
                assert words_of(f"{name}={text}", words=other) == word
    for text in ("3600s", "60:00", "1h", "99:59"):
        assert "to 59:59" in problems_of(f"{name}={text}")[0]


def test_every_day_of_the_write_range() -> None:
    for month in range(14):
        for day in range(34):
            text = f"date_day={month:02}-{day:02}"
            if 1 <= month <= 12 and 1 <= day <= 31:
                assert words_of(text) == {102: 256 * month + day}
            else:
                assert "01-01 to 12-31" in problems_of(text)[0]


@pytest.mark.parametrize(("name", "scale"), LIMITS)
def test_every_limit_that_a_reading_allows_and_none_besides(name: str, scale: str) -> None:
    register, trigger, allowed = LIMITS[name, scale]
    present = tuple(trigger if at == 7 else 0x7777 for at in range(14))
    for number in range(-10, 400):
        if number in allowed:
            assert words_of(f"{name}={number}", words=present) == {register: number % 65536}
            both = words_of(f"{name}={number}", f"alarm_trigger={scale}")
            assert both[107] == trigger
        else:
            assert problems_of(f"{name}={number}", words=present)[0].startswith(f"{name}: ")
            assert problems_of(f"alarm_trigger={scale}", f"{name}={number}")


@given(st.sampled_from([*FIELDS, *TIMES, "date_day", "limit_1", "limit_4"]), st.text(max_size=8))
def test_any_text_is_a_word_in_range_or_a_problem_that_names_its_setting(
    name: str, text: str
) -> None:
    found, problems = {name: 0}, [f"{name}: "]
    try:
        found = parse_settings(ROC, [f"{name}={text}"], NOW)
    except SettingErrors as error:
        problems = list(error.problems)
    assert len(problems) == 1
    assert problems[0].startswith(f"{name}: ")
    assert list(found) == [name]
    assert 0 <= found[name] <= 0xFFFF


@pytest.mark.parametrize(
    ("text", "register", "word"),
    [
        ("alarm_trigger=ISO", 107, 1),
        ("alarm_trigger=nas", 107, 2),
        ("alarm_direction=CleanToDirty", 108, 0),
        ("alarm_direction=clean_to_dirty", 108, 0),
        ("alarm_logic=Active Open", 109, 1),
        ("alarm_logic=active-open", 109, 1),
        ("sample_period=1.5min", 105, 0x011E),
        ("sample_period=1:05", 105, 0x0105),
        ("date_day=2-9", 102, 0x0209),
    ],
)
def test_words_and_units(text: str, register: int, word: int) -> None:
    assert words_of(text) == {register: word}


@pytest.mark.parametrize(
    ("text", "word"), [("none", 0xFFFD), ("000", 0xFFFE), ("00", 0xFFFF), ("0", 0)]
)
def test_classes_of_a_limit_are_not_numbers(text: str, word: int) -> None:
    """The document: -3 = None, -2 = 000, -1 = 00, 0 = 0."""
    present = tuple(3 if at == 7 else 0x7777 for at in range(14))
    assert words_of(f"limit_1={text}", words=present) == {110: word}


@pytest.mark.parametrize(
    "text",
    [
        "sample_period=10",
        "sample_period=10 m",
        "sample_period=00:60",
        "sample_period=0.0015s",
        "sample_period=-10s",
        "sample_period=",
        "node_id=1e2",
        "node_id=0x11",
        "node_id=+17",
        "node_id=007",
        "node_id= 17",
        "node_id=\u0661\u0667",
        "node_id=17.0",
        "alarm_trigger=system",
        "alarm_logic=true",
        "limit_1=18.0",
        "limit_1=-0",
        "limit_1=0-0",
        "limit_1=0000",
        "date_day=1123",
        "date_day=02-00",
        "clock=yesterday",
        "clock=2026-02-30T00:00:00Z",
        "clock=2026-11-23T06:00:00.5Z",
    ],
)
def test_what_is_no_value(text: str) -> None:
    assert problems_of(text)[0].startswith(text.partition("=")[0] + ": ")


def test_all_problems_at_once() -> None:
    texts = (
        "nothing=1",
        "sample_period",
        "node_id=0",
        "hold_period=1s",
        "limit_2=999",
        "node_id=9",
    )
    found = problems_of(*texts)
    assert [text.partition(":")[0].strip("'") for text in found] == [
        "nothing",
        "sample_period",
        "node_id",
        "hold_period",
        "limit_2",
    ]
    assert "set twice" in found[2]


def test_the_clock_in_utc() -> None:
    assert words_of("clock=2027-02-03T04:05:06Z") == {101: 2027, 102: 0x0203, 103: 4, 104: 0x0506}
    assert words_of("clock=2027-02-03T04:05:06+05:00")[103] == 23
    assert words_of("clock=now") == {101: 2026, 102: 0x0B12, 103: 11, 104: 0x0628}
    assert "set twice" in problems_of("clock=now", "time_hour=1")[0]
    names = [text.partition(":")[0] for text in problems_of("clock=now", "clock=now")]
    assert names == ["date_year", "date_day", "time_hour", "time_minute"]
    assert "date_year: 1999 is not 2000 to 2100" in problems_of("clock=1999-01-01T00:00:00Z")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("2026-13-01T00:00:00Z", " (month must be in 1..12)"),
        ("2026-02-30T00:00:00", " (day is out of range for month)"),
        ("2026-11-23T24:30:00Z", " (hour must be in 0..23)"),
        ("yesterday", ""),
        ("", ""),
        ("0001-01-01T00:00:00+05:00", None),
    ],
)
def test_a_clock_that_cannot_be(text: str, reason: str | None) -> None:
    (found,) = problems_of(f"clock={text}")
    if reason is None:
        assert found.startswith(f"clock: {text!r} is no date and time (")
        return
    wanted = "write now, or an instant like 2026-11-23T06:00:00Z"
    assert found == f"clock: {text!r} is no date and time{reason}: {wanted}"


@pytest.mark.parametrize(
    ("text", "is_assumed"),
    [
        ("clock=2027-02-03T04:05:06", True),
        ("clock=2027-02-03 04:05:06", True),
        ("clock=2027-02-03", True),
        ("clock=2027-02-03T04:05:06Z", False),
        ("clock=2027-02-03T04:05:06+05:00", False),
        ("clock=2027-02-03T04:05:06-05:00", False),
        ("clock=now", False),
        ("time_hour=4", False),
    ],
)
def test_a_clock_without_a_zone_is_told(text: str, *, is_assumed: bool) -> None:
    assert parse_settings(ROC, [text], NOW)
    found = assumed([text, "sample_period=10s"])
    value = text.partition("=")[2]
    wanted = f"clock: {value} names no zone, it is taken as UTC"
    assert found == ((wanted,) if is_assumed else ())


def test_the_address_comes_last() -> None:
    wanted = parse_settings(ROC, ["node_id=17", "limit_1=none", "hold_period=9s"], NOW)
    found = plan(ROC, wanted, DEFAULTS)
    assert found.steps == (Step("hold_period", 106, 5, 9), Step("node_id", 100, 138, 17))
    assert found.already == ("limit_1",)


def test_limits_that_another_trigger_leaves_behind_are_told() -> None:
    present = tuple({7: 1, 10: 180, 11: 5}.get(at, word) for at, word in enumerate(DEFAULTS))
    found = plan(ROC, parse_settings(ROC, ["alarm_trigger=NAS"], NOW), present)
    assert [step.address for step in found.steps] == [107]
    assert found.remarks == (
        "limit_1: 180 is not one of -3, -1, 0 to 120 (NAS); it stays as it is",
    )


def test_differences_name_what_is_not_as_wanted() -> None:
    steps = plan(ROC, parse_settings(ROC, ["sample_period=20s"], NOW), DEFAULTS).steps
    wanted = expected(ROC, DEFAULTS, steps)
    assert differences(ROC, wanted, wanted, 0) == []
    assert differences(ROC, wanted, DEFAULTS, 0) == [Difference("sample_period", 105, 20, 10)]
    other = [*wanted[:13], 7]
    assert differences(ROC, wanted, other, 0) == [Difference("limit_4", 113, 0xFFFD, 7)]


def test_a_clock_that_runs_is_no_difference() -> None:
    before = (138, 2026, 0x0C1F, 23, 0x3B3B, *DEFAULTS[5:])
    later = (138, 2027, 0x0101, 0, 0x0001, *DEFAULTS[5:])
    assert differences(ROC, before, later, 2 * SECOND) == []
    assert len(differences(ROC, before, later, 0)) == 4
    assert len(differences(ROC, later, before, 60 * SECOND)) == 4
    gone = differences(ROC, before, DEFAULTS, 60 * SECOND)
    assert [each.address for each in gone] == [101, 102, 103, 104]


def described(**words: int) -> dict[str, Any]:
    present = [words.get(f"r{100 + at}", word) for at, word in enumerate(DEFAULTS)]
    return {shown.name: shown for shown in describe(ROC, present)}


def test_description() -> None:
    found = described(r107=1, r110=180, r111=29, r112=0, r105=0x00FF)
    assert [(r.value, r.inside) for r in found["limit_1"].readings] == [(180, False), (18, True)]
    assert [(str(r.value), r.inside) for r in found["limit_2"].readings] == [
        ("29", True),
        ("2.9", True),
    ]
    assert found["limit_3"].readings == ()
    assert (found["limit_4"].value, found["limit_4"].meaning) == (-3, "none")
    assert found["limit_1"].allowed == "-3, 0 to 290 (ISO)"
    assert found["alarm_trigger"].meaning == "ISO"
    assert found["sample_period"].doubtful
    assert found["hold_period"].text == "00:05"
    assert found["hold_period"].value == 5
    assert found["limit_1"].address == 110
    assert not found["date_year"].doubtful


def test_readings_without_a_range_in_force() -> None:
    found = described(r107=0, r110=18)["limit_1"]
    assert [reading.inside for reading in found.readings] == [None, None]
    assert found.allowed.count(";") == 2


def test_other_maps_have_no_settings() -> None:
    for name, profile in PROFILES.items():
        if name != "hiac-roc":
            with pytest.raises(ValueError, match="declares no settings"):
                writable_of(profile)

"""The simulated device with time-stamped inputs: what it answers against what it says it did.

Answers are taken apart by hand here, from the tables of the paper.
"""

from __future__ import annotations

import csv
import io
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from roclog.simulators.mei_timestamped import InputList, Quirk, SimulatedStampedInputs

NOON = 1_795_435_200 * 10**9  # 2026-11-23T12:00:00Z
ALL_INPUTS = bytes.fromhex("2B 82 00 C4 00 16")
BOTH_REGISTERS = bytes.fromhex("2B 94 00 08 00 02")


def device(**arguments: Any) -> SimulatedStampedInputs:
    return SimulatedStampedInputs(**{"seed": 1, "started_at_ns": NOON, **arguments})


def told(**arguments: Any) -> tuple[SimulatedStampedInputs, io.StringIO]:
    truth = io.StringIO()
    return device(truth=truth, **arguments), truth


def rows(truth: io.StringIO) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(truth.getvalue())))


def last(truth: io.StringIO, table: str) -> dict[int, tuple[int, str]]:
    """Value and stamp octets of each input, of its last row."""
    found = {int(row["address"]): row for row in rows(truth) if row["table"] == table}
    return {address: (int(row["value"]), row["time_octets"]) for address, row in found.items()}


def read_discrete(answer: bytes) -> list[tuple[int, str]]:
    status, stamps = answer[4:7], answer[8:].hex()
    return [(status[n // 8] >> n % 8 & 1, stamps[14 * n : 14 * n + 14]) for n in range(22)]


def seconds(text: str) -> datetime:
    return datetime.fromisoformat(text)


def test_answers_are_the_truth() -> None:
    simulated, truth = told(rate=5)
    for _ in range(50):
        answer = simulated.answer(ALL_INPUTS)
        assert (len(answer), answer[:4], answer[7]) == (162, bytes.fromhex("2B 82 9F 03"), 154)
        assert dict(zip(range(196, 218), read_discrete(answer), strict=True)) == last(
            truth, "discrete_inputs"
        )
        registers = simulated.answer(BOTH_REGISTERS)
        expected = last(truth, "input_registers")
        assert registers[3:].hex() == "".join(
            f"{value:04x}{octets}" for value, octets in (expected[8], expected[9])
        )
        simulated.step(1)
    assert 200 < len(rows(truth)) - 24 < 300  # 250 are expected, with a deviation of 16


def test_a_stamp_is_the_device_time_of_the_truth() -> None:
    simulated, truth = told(rate=5)
    simulated.step(60)
    for row in rows(truth):
        octets = bytes.fromhex(row["time_octets"])
        milliseconds = octets[0] | octets[1] << 8
        text = f"T{octets[3]:02}:{octets[2]:02}:{milliseconds // 1000:02}.{milliseconds % 1000:03}Z"
        assert row["device_time"].endswith(text)
        if len(octets) == 7:
            date = f"20{octets[6]:02}-{octets[5]:02}-{octets[4]:02}"
            assert row["device_time"] == date + text
        assert row["device_time"] == row["happened_at"]


def test_changes_do_not_depend_on_how_time_is_cut() -> None:
    texts = []
    for seed, cuts in ((1, [30.0]), (1, [0.25] * 120), (2, [30.0])):
        simulated, truth = told(seed=seed, rate=5)
        for each in cuts:
            simulated.step(each)
        texts.append(truth.getvalue())
    assert texts[0] == texts[1] != texts[2]


def test_every_change_changes_and_inputs_rest() -> None:
    simulated, truth = told(rate=20)
    simulated.step(100)
    history: dict[str, list[tuple[int, str]]] = {}
    for place, row in enumerate(rows(truth)[24:]):
        states = history.setdefault(row["table"] + row["address"], [])
        if states:
            assert place - states[-1][0] > 12
            assert row["value"] != states[-1][1]
        states.append((place, row["value"]))
    assert len(history) == 24


def test_nothing_changes_at_rate_0() -> None:
    simulated, truth = told(rate=0)
    before = simulated.answer(ALL_INPUTS)
    simulated.step(3600)
    assert simulated.answer(ALL_INPUTS) == before
    assert len(rows(truth)) == 24


def test_wrong_clocks() -> None:
    simulated, truth = told(rate=5, clock_offset_s=-90.5, clock_drift_ppm=1000)
    simulated.step(1000)
    late = rows(truth)[-1]
    passed = (seconds(late["happened_at"]) - datetime(2026, 11, 23, 12, tzinfo=UTC)) / timedelta(
        seconds=1
    )
    off = (seconds(late["device_time"]) - seconds(late["happened_at"])) / timedelta(seconds=1)
    assert off == pytest.approx(-90.5 + passed / 1000, abs=0.002)


def test_grouped_registers() -> None:
    simulated, truth = told(quirks=[Quirk.GROUPED])
    (first, stamp_1), (second, stamp_2) = last(truth, "input_registers").values()
    body = simulated.answer(BOTH_REGISTERS)[3:].hex()
    assert body == f"{first:04x}{second:04x}{stamp_1}{stamp_2}"


def test_an_invalid_time_is_marked_and_nothing_else() -> None:
    plain, marked = device(), device(quirks=[Quirk.INVALID_TIME])
    for (value, stamp), (same, octets) in zip(
        read_discrete(plain.answer(ALL_INPUTS)), read_discrete(marked.answer(ALL_INPUTS)),
        strict=True,
    ):  # fmt: skip
        minute = f"{int(stamp[4:6], 16) | 0x80:02x}"
        assert (same, octets) == (value, stamp[:4] + minute + stamp[6:])


def test_the_misprinted_example() -> None:
    lists = [InputList(0x92, 196, 22)]
    request = bytes.fromhex("2B 92 00 C4 00 16")
    answer = device(lists=lists, quirks=[Quirk.MISPRINTED]).answer(request)
    right = device(lists=lists).answer(request)
    assert (answer[:4], answer[7]) == (bytes.fromhex("2B 82 98 03"), 0x94)
    assert (right[:4], right[7]) == (bytes.fromhex("2B 92 5D 03"), 0x58)
    assert answer[8:] == right[8:]


@pytest.mark.parametrize(
    ("pdu", "long", "short"),
    [
        ("2B 82 00 C3 00 02", "AB 82 02", "AB 02"),
        ("2B 82 00 C4 00 17", "AB 82 02", "AB 02"),
        ("2B 82 00 C4 00 23", "AB 82 03", "AB 03"),
        ("2B 84 00 08 00 01", "AB 84 01", "AB 01"),
        ("2B 0E 01 00", "AB 0E 01", "AB 01"),
        ("2B", "AB 01", "AB 01"),
        ("03 00 00 00 01", "83 01", "83 01"),
    ],
)
def test_both_forms_of_refusal(pdu: str, long: str, short: str) -> None:
    octets = bytes.fromhex(pdu)
    assert device().answer(octets) == bytes.fromhex(long)
    assert device(quirks=[Quirk.SHORT_EXCEPTIONS]).answer(octets) == bytes.fromhex(short)


@pytest.mark.parametrize(
    "bad",
    [
        {"unit": 256},
        {"rate": -1},
        {"lists": []},
        {"lists": [InputList(0x83, 0, 1)]},
        {"lists": [InputList(0x82, 65535, 2)]},
        {"lists": [InputList(0x82, 0, 4), InputList(0x92, 3, 1)]},
        {"clock_offset_s": -60 * 365 * 86400},
        {"clock_offset_s": float("nan")},
    ],
)
def test_devices_that_do_not_exist(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        device(**bad)


def test_time_does_not_run_backwards() -> None:
    with pytest.raises(ValueError, match="backwards"):
        device().step(-1)

"""The simulated module against the document's frames and its own rules."""

from __future__ import annotations

import struct
import tomllib
from pathlib import Path
from typing import Any

import pytest

from roclog.simulators.msx_e3317 import SimulatedMsxE3317

FUNCTIONS = tomllib.loads(
    (Path(__file__).parents[1] / "vectors/msx/functions.toml").read_text(encoding="utf-8")
)["function"]
NOON = 1_413_547_200 * 10**9
TIME_EX = bytes.fromhex("03 29 04 00 04")
CALIBRATION = bytes.fromhex("03 52 9E 00 08")


def module(**arguments: Any) -> SimulatedMsxE3317:
    return SimulatedMsxE3317(**{"seed": 1, "started_at_ns": NOON, **arguments})


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f["name"])
@pytest.mark.parametrize("order", ["big", "little"])
def test_every_function_of_the_document(function: dict[str, Any], order: str) -> None:
    answer = module(byte_order=order).answer(bytes.fromhex(function["query"][order])[7:])
    assert answer.startswith(bytes.fromhex(function["answer"][order])[7:])
    assert len(answer) == function["length"] - 1


def test_the_clock_runs_with_its_steps() -> None:
    simulated = module()
    for _ in range(5):
        simulated.step(0.05)
    assert simulated.answer(TIME_EX) == bytes.fromhex("03 08 54 41 04 C0 00 03 D0 90")
    little = module(byte_order="little")
    little.step(0.25)
    answer = little.answer(bytes.fromhex("03 04 29 04 00"))
    assert answer == bytes.fromhex("03 08 C0 04 41 54 90 D0 03 00")


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        ("04 29 04 00 04", "84 01"),
        ("10 2A F8 00 04 08 00 00 00 04 00 00 00 00", "90 01"),
        ("03 29 05 00 04", "83 02"),
        ("03 3B C4 00 02", "83 02"),
        ("03 29 04 00 03", "83 03"),
        ("03 29 04 00", "83 03"),
        ("03", "83 03"),
    ],
)
def test_refusals(pdu: str, answer: str) -> None:
    assert module().answer(bytes.fromhex(pdu)) == bytes.fromhex(answer)


def test_a_calibration_goes_through_channels_and_references() -> None:
    simulated = module(channels=2)
    seen: list[tuple[int, float]] = []
    for _ in range(3 * 60):
        status, channel, reference, digital = struct.unpack(
            ">IIfI", simulated.answer(CALIBRATION)[2:]
        )
        assert digital == pytest.approx(reference / 10 * (2**24 - 1), abs=200)
        assert status in (0, 1)
        if (channel, reference) not in seen[-1:]:
            seen.append((channel, reference))
        simulated.step(1)
    assert seen == [(channel, 2.5 * step) for channel in (0, 1, 0) for step in range(5)]


def test_equal_seeds_give_equal_values() -> None:
    answers = []
    for seed in (1, 1, 2):
        simulated = module(seed=seed)
        simulated.step(30)
        answers.append(simulated.answer(CALIBRATION))
    assert answers[0] == answers[1] != answers[2]


@pytest.mark.parametrize("bad", [{"unit": 2}, {"byte_order": "x"}, {"channels": 0}])
def test_modules_that_do_not_exist(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        module(**bad)


def test_time_does_not_run_backwards() -> None:
    with pytest.raises(ValueError, match="backwards"):
        module().step(-1)

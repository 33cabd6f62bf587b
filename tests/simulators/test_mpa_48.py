"""The simulated analyser against its manual's examples and its own rules."""

from __future__ import annotations

import csv
import io
import struct
from decimal import Decimal
from itertools import pairwise
from random import Random
from typing import Any

import pytest

from roclog.simulators.basin import Basin
from roclog.simulators.mpa_48 import MODELS, SimulatedMpa48

RELAYS = bytes.fromhex("01 00 00 00 08")
CHANNEL_1 = bytes.fromhex("04 00 00 00 03")
CHANNEL_2 = bytes.fromhex("04 00 03 00 03")
EVERY_MODEL = {f"channel_{n}": model for n, model in enumerate(MODELS, start=1)}
PLACES = {"channel_3": 40, "channel_4": 50}
HOUR_S = 3600


def mpa(**arguments: Any) -> SimulatedMpa48:
    return SimulatedMpa48(**{"seed": 1, **arguments})


def words(simulated: SimulatedMpa48, request: bytes = CHANNEL_1) -> tuple[int, int, int]:
    answer = simulated.answer(request)
    assert answer[:2] == bytes.fromhex("04 06")
    status, primary, secondary = struct.unpack(">HHH", answer[2:])
    return status, primary, secondary


class Still(Basin):
    """A basin of which everything is given."""

    ph: float = 7.014
    orp_mv: float = -500.4
    temperature_cel: float = -0.14

    def live_one_second(self) -> None:
        self.oxygen_ppm, self.solids_mg_l = 8.304, 1234.4


@pytest.mark.parametrize(
    ("model", "primary", "secondary"),
    [
        ("model-10", 830, 0xFFFF),
        ("model-15", 1234, None),
        ("model-51", 701, 0xFFFF),
        ("model-52", 1500, None),
    ],
)
def test_scaling_of_page_25(
    model: str, primary: int, secondary: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hundredths of ppm and pH, tenths of a degree, mg/L as it is, mV and 2000."""
    monkeypatch.setattr("roclog.simulators.mpa_48.Basin", Still)
    monkeypatch.setattr("roclog.simulators.mpa_48.TROUBLE_EVERY_S", 10**12)
    simulated = mpa(sensors={"channel_1": model})
    assert words(simulated)[:2] == (0, primary)
    undefined = words(simulated)[2]
    assert secondary is None or undefined == secondary
    simulated.step(HOUR_S)
    assert words(simulated)[2] == undefined != 0


def test_relays_of_page_23(monkeypatch: pytest.MonkeyPatch) -> None:
    """Relays 1 and 3: answer 01 01 05; the blower runs and a sensor has a status."""
    monkeypatch.setattr("roclog.simulators.mpa_48.TROUBLE_EVERY_S", 1)
    simulated = mpa()
    while simulated.answer(RELAYS) != bytes.fromhex("01 01 05"):
        simulated.step(1)
    assert simulated.answer(bytes.fromhex("01 00 02 00 06")) == bytes.fromhex("01 01 01")
    assert simulated.answer(bytes.fromhex("01 00 01 00 01")) == bytes.fromhex("01 01 00")


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        ("02 00 00 00 08", "82 01"),
        ("03 00 00 00 03", "83 01"),
        ("05 00 00 FF 00", "85 01"),
        ("06 00 00 00 01", "86 01"),
        ("01 00 08 00 01", "81 02"),
        ("01 00 07 00 02", "81 02"),
        ("04 00 06 00 01", "84 02"),
        ("04 00 05 00 02", "84 02"),
        ("04 FF FF 00 02", "84 02"),
        ("01 00 00 00 00", "81 03"),
        ("01 00 00 07 D1", "81 03"),
        ("04 00 00 00 7E", "84 03"),
        ("04 00 00 00", "84 03"),
        ("01", "81 03"),
    ],
)
def test_refusals(pdu: str, answer: str) -> None:
    assert mpa().answer(bytes.fromhex(pdu)) == bytes.fromhex(answer)


def test_both_channels_in_one_answer() -> None:
    simulated = mpa()
    both = simulated.answer(bytes.fromhex("04 00 00 00 06"))
    one, two = simulated.answer(CHANNEL_1), simulated.answer(CHANNEL_2)
    assert both == bytes.fromhex("04 0C") + one[2:] + two[2:]


def test_a_channel_where_it_is_told_to_be() -> None:
    simulated = mpa(sensors=EVERY_MODEL, addresses=PLACES)
    assert len(simulated.answer(bytes.fromhex("04 00 28 00 03"))) == 8
    assert simulated.answer(bytes.fromhex("04 00 06 00 03")) == bytes.fromhex("84 02")


def test_a_day_at_the_basin() -> None:
    """Oxygen between the limits of the blower, solids between those of the pump, both switched."""
    basin = Basin(Random(1))
    oxygen, solids, switched, temperatures = [], [], [0, 0], []
    before = basin.is_blown, basin.is_pumped
    for _ in range(24 * HOUR_S):
        basin.live_one_second()
        oxygen.append(basin.oxygen_ppm)
        solids.append(basin.solids_mg_l)
        temperatures.append(basin.temperature_cel)
        now = basin.is_blown, basin.is_pumped
        switched = [n + (a != b) for n, a, b in zip(switched, before, now, strict=True)]
        before = now
    assert 1.4 < min(oxygen) < 1.5
    assert 3.0 < max(oxygen) < 3.1
    assert 2_550 < min(solids) < 2_600
    assert 3_400 < max(solids) < 3_450
    assert switched[0] > 500
    assert switched[1] > 40
    assert 10 < min(temperatures) < max(temperatures) < 22
    assert max(abs(a - b) for a, b in pairwise(temperatures)) < 0.05


def test_now_and_then_a_status_and_measurements_stand_still() -> None:
    simulated = mpa(seed=3)
    seen = []
    for _ in range(12 * HOUR_S):
        simulated.step(1)
        seen.append(words(simulated, CHANNEL_2))
    in_trouble = [status for status, *_ in seen if status]
    assert set(in_trouble) == {1, 2, 3}
    assert 0.02 < len(in_trouble) / len(seen) < 0.15
    for before, after in pairwise(seen):
        if after[0]:
            assert after[1:] == before[1:]
    assert len({primary for _, primary, _ in seen}) > 100


def test_equal_seeds_give_equal_values_however_time_is_cut() -> None:
    devices = [mpa(), mpa(), mpa(seed=2), mpa(unit=2)]
    devices[0].step(1000)
    for _ in range(4000):
        devices[1].step(0.25)
    for device in devices[2:]:
        device.step(1000)
    answers = [device.answer(CHANNEL_1) + device.answer(CHANNEL_2) for device in devices]
    assert answers[0] == answers[1]
    assert len(set(answers)) == 3


def test_the_truth_is_what_every_answer_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roclog.simulators.mpa_48.TROUBLE_EVERY_S", 30)
    file = io.StringIO()
    simulated = mpa(sensors=EVERY_MODEL, addresses=PLACES, truth=file)
    assert file.getvalue() == "answer,block,name,value\n"
    assert simulated.answer(bytes.fromhex("04 00 06 00 03"))[0] == 0x84
    factors = {
        "status": (1, 0),
        "dissolved_oxygen": (100, 0),
        "temperature": (10, 0),
        "suspended_solids": (1, 0),
        "ph": (100, 0),
        "orp": (1, 2000),
    }
    names = {
        "channel_1": ("dissolved_oxygen", "temperature"),
        "channel_2": ("suspended_solids",),
        "channel_3": ("ph", "temperature"),
        "channel_4": ("orp",),
    }
    expected: list[tuple[str, str, str, int | None]] = []
    number = 0
    for _ in range(200):
        simulated.step(1)
        number += 1
        octet = simulated.answer(RELAYS)[2]
        expected += [(str(number), "relays", f"relay_{n + 1}", octet >> n & 1) for n in range(8)]
        for n, (channel, quantities) in enumerate(names.items(), start=1):
            number += 1
            place = {**PLACES, "channel_1": 0, "channel_2": 3}[f"channel_{n}"]
            told = words(simulated, b"\4" + place.to_bytes(2) + b"\0\3")
            expected.append((str(number), channel, "status", told[0]))
            for quantity, word in zip(quantities, told[1:], strict=False):
                expected.append((str(number), channel, quantity, None if told[0] else word))
    rows = list(csv.DictReader(io.StringIO(file.getvalue())))
    assert len(rows) == len(expected)
    missing = 0
    for row, (answer, block, name, raw) in zip(rows, expected, strict=True):
        assert (row["answer"], row["block"], row["name"]) == (answer, block, name)
        factor, bias = factors.get(name, (1, 0))
        missing += raw is None
        assert (Decimal(row["value"]) * factor + bias if row["value"] else None) == raw
    assert missing > 10


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ({"unit": 0}, "unit 0 is not in 1-247"),
        ({"unit": 248}, "unit 248"),
        ({"sensors": {}}, "without sensors"),
        ({"sensors": {"channel_0": "model-10"}}, "'channel_0' is not channel_1 to channel_99"),
        ({"sensors": {"channel_1": "model-16"}}, "'model-16' is not one of model-10"),
        ({"sensors": {"channel_3": "model-10"}}, "the address of channel_3 is not known"),
        ({"addresses": {"channel_3": 9}}, "channel_3 has an address, but no sensor"),
        ({"addresses": {"channel_2": 2}}, "register 2 is in two channels"),
        ({"addresses": {"channel_2": 65534}}, "not in 0-65535"),
    ],
)
def test_devices_that_do_not_exist(bad: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        mpa(**bad)


def test_time_does_not_run_backwards() -> None:
    with pytest.raises(ValueError, match="backwards"):
        mpa().step(-1)

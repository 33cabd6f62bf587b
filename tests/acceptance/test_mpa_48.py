"""The real command against an independent MPA-48, its log of requests and what it told."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import pytest
from bench.mpa import CHANNELS, QUANTITIES, REQUESTS, Judge, Mpa
from bench.recorder import Recorder
from bench.recording import events, export, files, gaps, items, metadata

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bench.truth import Truth

POLL = 50_000_000
STATUS_3 = {
    "10": "new sensor codes needed",
    "15": "needs zero calibration",
    "51": "sensor error",
    "52": "sensor error",
}


def record(
    folder: Path, device: Mpa, enough: Callable[[], bool], connection: str = 'timeout = "1s"'
) -> tuple[Path, Truth]:
    """Until it is enough; the recording, exported, and what the device says."""
    recorder = Recorder(folder, device.toml("50ms", connection))
    with recorder.start() as child:
        child.while_it_runs(enough, "enough answers", 60)
        assert child.stop() == 0, child.talk()
        assert "Traceback" not in child.talk()
    export(recorder.directory, folder / "csv")
    return recorder.directory, device.end()


def link_sum(directory: Path, name: str) -> int:
    return sum(getattr(item.values, name) for item in items(directory, "/mpa1/link"))


def check_requests(directory: Path, truth: Truth) -> dict[str, int]:
    """Each block by one request of its own, and nothing else was ever asked; how often each was."""
    asked = [line["request"] for line in truth.lines if "request" in line]
    known = {request: name for name, request in REQUESTS.items()}
    assert set(asked) <= set(known)
    assert len(asked) == link_sum(directory, "requests")
    return {name: asked.count(request) for request, name in known.items()}


def seen(judge: Judge, truth: Truth) -> dict[str, list[dict[str, Any]]]:
    """What the recorded answers told, by channel."""
    answers = list(truth.of("answer"))
    return {
        name: [answers[n]["channels"][str(register)] for n in judge.found[name]]
        for name, (register, _) in CHANNELS.items()
    }


@pytest.mark.parametrize("line", ["tcp", "pty"])
def test_every_value_is_what_the_device_told(tmp_path: Path, line: str) -> None:
    with Mpa(tmp_path, line, period=0.02, trouble=0.5) as device:

        def all_statuses() -> bool:
            """Each often enough, and the values at both ends of the ranges among them."""
            if device.log_size < 120_000:  # octets; to look into them costs time
                return False
            answers = device.truth.lines
            told = [c for a in answers for c in a.get("channels", {}).values()]
            pairs = {(c["model"], c["status"]) for c in told}
            orp = {c["told"].get("orp") for c in told}
            cold = any(c["told"].get("temperature", "").startswith("-") for c in told)
            return len(told) > 300 and len(pairs) == 16 and {"-2000", "2000"} < orp and cold

        directory, truth = record(tmp_path, device, all_statuses)
    judge = Judge(directory, tmp_path / "csv", truth)
    assert judge.wrong == []
    for name in REQUESTS:
        assert judge.found[name] == judge.delivered(name) != []
    counts = check_requests(directory, truth).values()
    assert max(counts) - min(counts) <= 1
    assert truth.count("exception") == truth.count("ignored") == truth.count("noise") == 0
    told = seen(judge, truth)
    for name, (_, model) in CHANNELS.items():
        assert {line["status"] for line in told[name]} == {0, 1, 2, 3}
        assert {frozenset(line["told"]) for line in told[name]} == {
            frozenset(),
            frozenset(QUANTITIES[model]),
        }
    assert min(Decimal(c["told"].get("temperature", 0)) for c in told["channel_2"]) < 0
    orp = [int(c["told"]["orp"]) for c in told["channel_3"] if c["told"]]
    assert (min(orp), max(orp)) == (-2000, 2000)
    for name in REQUESTS:
        assert judge.holes(name, POLL) == []
    assert {gap.reason for gap in gaps(directory, "mpa1")} <= {"unread"}  # a busy computer


def test_the_file_says_what_its_numbers_mean(tmp_path: Path) -> None:
    with Mpa(tmp_path) as device:
        directory, _ = record(tmp_path, device, lambda: len(device.told("channel_4")) > 3)
    (path,) = files(directory)
    blocks = json.loads(metadata(path)["roclog.device.mpa1"]["register_map"])
    assert [block["block"] for block in blocks] == list(REQUESTS)
    assert [point["type"] for point in blocks[0]["points"]] == ["bit"] * 8
    for block in blocks[1:]:
        register, model = CHANNELS[block["block"]]
        status, *points = block["points"]
        assert (block["address"], block["count"]) == (register, 3)
        assert f"model-{model}" in block["title"]
        assert status["meanings"] == {
            "0": "normal",
            "1": "sensor not responding",
            "2": "sensor error",
            "3": STATUS_3[model],
        }
        gate = {"point": "status", "values": [0]}
        assert all(point["valid_when"] == gate for point in points)
    units = {point["name"]: point["unit"] for block in blocks[1:] for point in block["points"]}
    assert units == {
        "status": "",
        "suspended_solids": "mg/L",
        "dissolved_oxygen": "[ppm]",
        "temperature": "Cel",
        "ph": "[pH]",
        "orp": "mV",
    }
    (orp,) = (point for point in blocks[3]["points"] if point["name"] == "orp")
    assert orp["add"] == "-2000"


@pytest.mark.parametrize("line", ["tcp", "pty"])
def test_refusals_are_told_and_leave_the_rest_alone(tmp_path: Path, line: str) -> None:
    """Channel 4 is not where it was said to be, the relays are busy three times."""
    places = ";".join(f"{at}:{model}" for at, model in CHANNELS.values() if at < 1000)
    with Mpa(tmp_path, line, channels=places, fail="1:0:6:3", trouble=0.0) as device:
        directory, truth = record(tmp_path, device, lambda: len(device.told("relays")) >= 20)
    judge = Judge(directory, tmp_path / "csv", truth)
    assert judge.wrong == []
    for name in REQUESTS:
        assert judge.found[name] == judge.delivered(name)
        assert bool(judge.found[name]) == (name != "channel_4")
    check_requests(directory, truth)
    refused = list(truth.of("exception"))
    assert [each["code"] for each in refused].count(6) == 3
    assert link_sum(directory, "exception_6") == 3
    assert link_sum(directory, "exception_2") == len(refused) - 3 > 0
    texts = events(directory, "mpa1.refused")
    assert [text for text in texts if "block relays" in text][-1].endswith("answered again")
    assert any("block channel_4" in text and "exception 2" in text for text in texts)


FAULTS: dict[str, dict[str, Any]] = {
    "tcp": {"drop": 0.04, "late": 0.04, "short": 0.06, "other_unit": 0.06, "corrupt": 0.02},
    "pty": {"drop": 0.03, "late": 0.03, "short": 0.06, "other_unit": 0.06, "corrupt": 0.08},
}


@pytest.mark.parametrize("line", ["tcp", "pty"])
def test_faults_cost_samples_and_never_a_value(tmp_path: Path, line: str) -> None:
    faults = {"seed": 4, "late_by": 0.1, **FAULTS[line]}
    with Mpa(tmp_path, line, period=0.02, **faults) as device:
        directory, truth = record(
            tmp_path,
            device,
            lambda: len(device.told("relays")) >= 40,
            'timeout = "80ms"' + ('\nlate_answer = "150ms"' if line == "pty" else ""),
        )
    judge = Judge(directory, tmp_path / "csv", truth)
    assert judge.wrong == []
    fates = [line["fate"] for line in truth.of("answer")]
    assert set(fates) == {"ok", "late", "dropped", "short", "other_unit", "corrupt"}
    recorded = sum(map(len, judge.found.values()))
    assert 0.5 * len(fates) < recorded <= fates.count("ok") + fates.count("late")
    for name in REQUESTS:
        assert judge.holes(name, POLL) == []
    assert link_sum(directory, "wrong_answers") > 3
    assert link_sum(directory, "timeouts") > 3
    if line == "pty":
        assert link_sum(directory, "crc_errors") > 3
    asked = {line["request"] for line in truth.lines if "request" in line}
    assert asked == set(REQUESTS.values())

"""The real command against an independent MSX-E3317, its log of calls and what it told."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from bench.msx import CALIBRATION, CLOCK, FUNCTIONS, STATUS, TYPE, Judge, Msx
from bench.recorder import Recorder
from bench.recording import events, export, files, gaps, items, metadata

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bench.truth import Truth

POLL = 100_000_000
DEVICE = 'poll = "100ms"'


def record(
    folder: Path, module: Msx, enough: Callable[[], bool], connection: str = 'timeout = "1s"'
) -> tuple[Path, Truth]:
    """Until it is enough; the recording, exported, and what the module says."""
    recorder = Recorder(folder, module.toml(connection, DEVICE))
    with recorder.start() as child:
        child.while_it_runs(enough, "enough calls", 60)
        assert child.stop() == 0, child.talk()
        assert "Traceback" not in child.talk()
    export(recorder.directory, folder / "csv")
    return recorder.directory, module.end()


def link_sum(directory: Path, name: str) -> int:
    return sum(getattr(item.values, name) for item in items(directory, "/msx1/link"))


def check_that_nothing_was_repeated(directory: Path, truth: Truth, clock_calls: int) -> None:
    """Each request left once; every call is a request of its own; no more than were due."""
    calls = list(truth.of("call"))
    ignored = truth.count("ignored")
    assert link_sum(directory, "requests") == len(calls) + ignored
    numbers = [call["transaction"] for call in calls]
    assert len(set(numbers)) == len(numbers)
    assert {call["function"] for call in calls} == {3}
    at = [call["mono_ns"] for call in calls if call["register"] == CLOCK]
    assert len(at) == clock_calls
    assert len(at) <= (at[-1] - at[0]) // POLL + 2
    for register in {TYPE, *FUNCTIONS.values()} - {CLOCK, CALIBRATION}:
        assert sum(call["register"] == register for call in calls) <= 1


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_every_field_is_what_the_module_told(tmp_path: Path, transport: str, order: str) -> None:
    with Msx(tmp_path, transport, order, clock_offset=3.5, channels=11) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(CALIBRATION) >= 25)
        judge = Judge(directory, tmp_path / "csv", truth)
        check_that_nothing_was_repeated(directory, truth, module.calls(CLOCK))
    assert judge.wrong == []
    for name in FUNCTIONS:
        assert judge.found[name] == judge.delivered(name, truth) != []
    assert gaps(directory, "msx1") == []
    (path,) = files(directory)
    identity = metadata(path)["roclog.device.msx1"]
    assert identity["module_type"] == '{"module_type": "MSX-E3317-8"}'
    assert identity["word_order"] == ("ABCD" if order == "big" else "DCBA")
    (clock,) = [item.values for item in items(directory, "/msx1/clock_offset")]
    assert 0 < clock.uncertainty < 0.1
    assert abs(clock.offset - 3.5) <= clock.uncertainty + 1e-6  # whose clock has microseconds


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("other_count", "the byte count of the answer has 16 bits, register "),
        ("short", " octets instead of "),
        ("other_unit", "asked unit 1, unit 0 answered"),
    ],
)
@pytest.mark.parametrize("order", ["big", "little"])
def test_an_answer_of_another_shape_is_no_sample(
    tmp_path: Path, fault: str, words: str, order: str
) -> None:
    with Msx(tmp_path, "tcp", order, **{fault: 1.0}) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(CLOCK) >= 5)
    told = list(truth.of("answer"))
    registers = [call["register"] for call in truth.of("call")]
    assert registers.count(TYPE) == 1  # asked for again after a minute
    assert link_sum(directory, "wrong_answers") == len(told) == link_sum(directory, "requests")
    assert all(items(directory, f"/msx1/{name}") == [] for name in FUNCTIONS)
    (text,) = events(directory, "msx1.link")
    assert words in text


def test_answers_of_any_shape_among_right_ones(tmp_path: Path) -> None:
    faults = {"other_count": 0.1, "short": 0.1, "other_unit": 0.1}
    with Msx(tmp_path, "tcp", "big", seed=3, **faults) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(CLOCK) >= 60)
        judge = Judge(directory, tmp_path / "csv", truth)
        check_that_nothing_was_repeated(directory, truth, module.calls(CLOCK))
    assert judge.wrong == []
    assert judge.found["clock"] == judge.delivered("clock", truth)
    spoilt = [line for line in truth.of("answer") if line["fate"] in faults]
    assert link_sum(directory, "wrong_answers") == len(spoilt) > 5


@pytest.mark.parametrize("order", ["big", "little"])
def test_a_function_that_fails_says_why(tmp_path: Path, order: str) -> None:
    fail = f"{TYPE}:-3:0:no type today;{CALIBRATION}:-100:5:Input/output error"
    with Msx(tmp_path, "udp", order, fail=fail, fail_count=3) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(CALIBRATION) >= 10)
        judge = Judge(directory, tmp_path / "csv", truth)
        assert module.calls(STATUS) == 2
        check_that_nothing_was_repeated(directory, truth, module.calls(CLOCK))
    assert judge.wrong == []
    assert len(judge.found["calibration_status"]) >= 7
    assert judge.found["clock"] == judge.delivered("clock", truth)
    refusal = "exception 9 (not a standard code) to function 3, remote execution error; "
    refusal += "status of the last call: returned "
    (facts,) = events(directory, "msx1.facts")
    assert facts == f"module_type block: {refusal}-3: no type today"
    refused, answered = events(directory, "msx1.refused")
    assert refused.endswith(f"{refusal}-100, errno 5: Input/output error")
    assert refused.startswith("function 21150 (calibration_status) refused, asked for all the same")
    assert answered == "function 21150 (calibration_status) answered again"
    assert link_sum(directory, "exception_other") == 4


@pytest.mark.parametrize("order", ["big", "little"])
def test_datagrams_lost_twice_and_late(tmp_path: Path, order: str) -> None:
    faults = {"drop_request": 0.1, "drop": 0.1, "duplicate": 0.15, "reorder": 0.15}
    with Msx(tmp_path, "udp", order, seed=5, held_for=0.15, **faults) as module:
        directory, truth = record(
            tmp_path, module, lambda: module.calls(CLOCK) >= 80, 'timeout = "80ms"'
        )
        judge = Judge(directory, tmp_path / "csv", truth)
        check_that_nothing_was_repeated(directory, truth, module.calls(CLOCK))
    assert judge.wrong == []
    found = judge.found["clock"]
    assert found == sorted(set(found))
    assert set(judge.delivered("clock", truth)) <= set(found)
    fates = [line["fate"] for line in truth.of("answer")]
    assert min(fates.count(fate) for fate in ("drop", "duplicate", "reorder")) > 3
    assert truth.count("ignored") > 3
    assert link_sum(directory, "late_answers") > 3
    told = gaps(directory, "msx1")
    reads = [item.values.read_at for item in items(directory, "/msx1/clock")]
    for before, after in pairwise(reads):
        if after - before > 1.6 * POLL:
            assert any(abs(gap.since - before) + abs(gap.to - after) < 10**6 for gap in told)

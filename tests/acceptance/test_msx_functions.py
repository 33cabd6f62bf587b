"""Functions that the user declares, against an independent module that has them.

Their layouts are made up, as tests/peers/msx_model.py says; no document of the module gives them.
"""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import pytest
from bench.msx import DECLARATIONS, DECLARED, Judge, Msx
from bench.recorder import Recorder, roclog
from bench.recording import events, export, gaps, items, metadata
from bench.recording import files as segments

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bench.truth import Truth

VALUES, INFORMATION, OLD_VALUES = DECLARED.values()
PERIODS: Final = {VALUES: 100_000_000, INFORMATION: 200_000_000, OLD_VALUES: 100_000_000}
ONLY_DECLARED: Final = "calls = []\n"


def record(
    folder: Path,
    module: Msx,
    enough: Callable[[], bool],
    declarations: str = DECLARATIONS,
    connection: str = 'timeout = "1s"',
) -> tuple[Path, Truth]:
    """Until it is enough; the recording, exported, and what the module says."""
    recorder = Recorder(folder, module.toml(connection, ONLY_DECLARED + declarations))
    with recorder.start() as child:
        child.while_it_runs(enough, "enough calls", 60)
        assert child.stop() == 0, child.talk()
        assert "Traceback" not in child.talk()
    export(recorder.directory, folder / "csv")
    return recorder.directory, module.end()


def link_sum(directory: Path, name: str) -> int:
    return sum(getattr(item.values, name) for item in items(directory, "/msx1/link"))


def check_that_nothing_was_repeated(directory: Path, truth: Truth) -> None:
    """Each request left once, every call is a request of its own, and none came before its turn."""
    calls = list(truth.of("call"))
    assert link_sum(directory, "requests") == len(calls) + truth.count("ignored")
    numbers = [call["transaction"] for call in calls]
    assert len(set(numbers)) == len(numbers)
    assert {call["function"] for call in calls} == {3}
    for register, period in PERIODS.items():
        at = [call["mono_ns"] for call in calls if call["register"] == register]
        assert 1 <= len(at) <= (at[-1] - at[0]) // period + 2


def told(truth: Truth, register: int) -> dict[int, int]:
    """By call of this function: the counter in its answer, of those that arrived as they should."""
    calls = [line["call"] for line in truth.of("call") if line.get("register") == register]
    answers = [line for line in truth.of("answer") if line["fate"] == "ok" and "counter" in line]
    fine = {line["call"]: line for line in answers}
    return {call: fine[call]["counter"] for call in calls if call in fine}


def firsts(counters: dict[int, int]) -> list[int]:
    """The calls that told another counter than the one before."""
    calls = list(counters)
    news = [b for a, b in pairwise(calls) if counters[a] != counters[b]]
    return calls[:1] + news


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_every_declared_field_is_what_the_module_told(
    tmp_path: Path, transport: str, order: str
) -> None:
    with Msx(tmp_path, transport, order, acquisition=0.25, clock_offset=7.5) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(VALUES) >= 25)
    judge = Judge(directory, tmp_path / "csv", truth, DECLARED)
    check_that_nothing_was_repeated(directory, truth)
    assert judge.wrong == []
    assert judge.found["information"] == judge.delivered("information", truth) != []
    for name in ("values", "old_values"):
        counters = told(truth, DECLARED[name])
        assert judge.found[name] == firsts(counters) != []
        assert len(judge.found[name]) < len(counters)
    assert gaps(directory, "msx1") == []
    pdus = {line["call"]: bytes.fromhex(line["pdu"]) for line in truth.of("answer")}
    sizes = {"values": (2, 76), "information": (2, 133), "old_values": (3, 68)}
    for name, (head, octets) in sizes.items():
        kept = [item.values.raw for item in items(directory, f"/msx1/{name}")]
        assert kept == [pdus[call][head:] for call in judge.found[name]]
        assert {len(raw) for raw in kept} == {octets}
    (path,) = segments(directory)
    described = json.loads(metadata(path)["roclog.device.msx1"]["register_map"])
    assert [(b["block"], b["count"], b["packed"]) for b in described] == [
        ("values", 76, True),
        ("information", 133, True),
        ("old_values", 68, True),
    ]


def test_a_counter_says_what_was_missed(tmp_path: Path) -> None:
    with Msx(tmp_path, "tcp", "big", acquisition=0.03) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(VALUES) >= 20)
    judge = Judge(directory, tmp_path / "csv", truth, DECLARED)
    assert judge.wrong == []
    counters = list(told(truth, VALUES).values())
    missed = [gap for gap in gaps(directory, "msx1") if gap.reason == "overwritten"]
    assert sum(gap.expected for gap in missed) == sum(b - a - 1 for a, b in pairwise(counters)) > 20
    assert len(judge.found["values"]) == len(counters)


@pytest.mark.parametrize("order", ["big", "little"])
def test_a_declared_function_that_fails_says_why(tmp_path: Path, order: str) -> None:
    fail = f"{VALUES}:-7:0:acquisition is not started;{OLD_VALUES}:-100:5:Input/output error"
    with Msx(tmp_path, "udp", order, acquisition=0.2, fail=fail, fail_count=3) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(VALUES) >= 15)
    judge = Judge(directory, tmp_path / "csv", truth, DECLARED)
    check_that_nothing_was_repeated(directory, truth)
    assert judge.wrong == []
    assert judge.found["values"] == firsts(told(truth, VALUES)) != []
    assert judge.found["information"] == judge.delivered("information", truth)
    refusal = (
        " refused, asked for all the same: exception 9 (not a standard code) to function 3, "
        "remote execution error; status of the last call: returned "
    )
    assert sorted(events(directory, "msx1.refused")) == [
        "function 101 (old_values) answered again",
        f"function 101 (old_values){refusal}-100, errno 5: Input/output error",
        "function 15300 (values) answered again",
        f"function 15300 (values){refusal}-7: acquisition is not started",
    ]


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize("fault", ["short", "other_count"])
def test_an_answer_of_another_size_is_no_sample(tmp_path: Path, fault: str, order: str) -> None:
    with Msx(tmp_path, "tcp", order, acquisition=0.2, **{fault: 1.0}) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(VALUES) >= 3)
    answers = list(truth.of("answer"))
    facts = sum(line["register"] == 10200 for line in truth.of("call"))
    assert link_sum(directory, "wrong_answers") == len(answers) > facts
    assert all(items(directory, f"/msx1/{name}") == [] for name in DECLARED)


def test_a_layout_that_is_not_the_modules_is_told_and_never_a_sample(tmp_path: Path) -> None:
    """One octet too few is asked for as the same words, and one word too few is refused."""
    wrong = DECLARATIONS.replace("size = 51", "size = 50").replace("count = 16 }", "count = 15 }")
    assert wrong.count("count = 15") == 1
    wrong = 'poll = "100ms"' + wrong.replace("200ms", "100ms")
    with Msx(tmp_path, "tcp", "big", acquisition=0.2) as module:
        directory, truth = record(tmp_path, module, lambda: module.calls(VALUES) >= 8, wrong)
    for name in ("information", "old_values"):
        assert items(directory, f"/msx1/{name}") == []
    judge = Judge(directory, tmp_path / "csv", truth, {"values": VALUES})
    assert judge.wrong == []
    assert judge.found["values"] == firsts(told(truth, VALUES)) != []
    (text,) = events(directory, "msx1.refused")
    assert text.startswith(
        "function 101 (old_values) refused, asked for all the same: exception 3 "
    )
    (text,) = events(directory, "msx1.layout")
    assert text.startswith(
        "function 15450 (information) answers in another shape than its layout: "
        "135 octets instead of 134 (octets 03 85 "
    )


@pytest.mark.parametrize("order", ["big", "little"])
def test_datagrams_lost_twice_and_late(tmp_path: Path, order: str) -> None:
    faults = {"drop_request": 0.1, "drop": 0.1, "duplicate": 0.15, "reorder": 0.15}
    with Msx(tmp_path, "udp", order, seed=5, acquisition=0.2, held_for=0.15, **faults) as module:
        directory, truth = record(
            tmp_path, module, lambda: module.calls(VALUES) >= 50, connection='timeout = "80ms"'
        )
    judge = Judge(directory, tmp_path / "csv", truth, DECLARED)
    check_that_nothing_was_repeated(directory, truth)
    assert judge.wrong == []
    fates = [line["fate"] for line in truth.of("answer")]
    assert min(fates.count(fate) for fate in ("drop", "duplicate", "reorder")) > 3
    for name in DECLARED:
        assert judge.found[name] == sorted(set(judge.found[name])) != []


def test_only_what_is_repeatable_is_called_again_for_a_lost_answer(tmp_path: Path) -> None:
    slow = DECLARATIONS.replace("100ms", "200ms")
    repeatable = slow.replace("register = 15300", "register = 15300\nrepeatable = true")
    with Msx(tmp_path, "udp", "big", seed=5, acquisition=0.2, drop=0.3) as module:
        directory, truth = record(
            tmp_path, module, lambda: module.calls(VALUES) >= 40, repeatable, 'timeout = "60ms"'
        )
    judge = Judge(directory, tmp_path / "csv", truth, DECLARED)
    assert judge.wrong == []
    lost = {line["call"]: line["fate"] == "drop" for line in truth.of("answer")}
    calls = [line for line in truth.of("call") if line["register"] in PERIODS]
    repeats = [
        (before["call"], after["call"])
        for before, after in pairwise(calls)
        if before["register"] == after["register"] == VALUES
        and after["mono_ns"] - before["mono_ns"] < 90_000_000
    ]
    assert len(repeats) > 3
    assert all(lost[before] for before, _ in repeats)
    assert not {before for before, _ in repeats} & {after for _, after in repeats}
    assert any(not lost[after] and after in judge.found["values"] for _, after in repeats)
    for register in (INFORMATION, OLD_VALUES):
        at = [call["mono_ns"] for call in calls if call["register"] == register]
        assert len(at) <= (at[-1] - at[0]) // 200_000_000 + 2


def test_read_and_check_speak_of_functions(tmp_path: Path) -> None:
    with Msx(tmp_path, "tcp", "little", acquisition=1000.0) as module:
        config = Recorder(tmp_path, module.toml("", 'calls = ["clock"]\n' + DECLARATIONS)).config
        checked = roclog("check", config)
        read = roclog("read", config, "msx1")
        as_json = roclog("read", config, "msx1", "--json")
        registers = [line["register"] for line in module.end().of("call")]
    assert "little endian" in checked.stdout
    assert "calls function 15450 (information), 133 octets, every 200ms" in checked.stdout
    assert registers == 2 * [10200, 10500, VALUES, INFORMATION, OLD_VALUES]
    assert "information, function 15450" in read.stdout
    assert "MXCommon__GetTimeEx, function 10500" in read.stdout
    assert "register" not in read.stdout
    found = json.loads(as_json.stdout)["blocks"]["information"]
    assert len(found["octets"]) == 133
    assert found["values"]["key"] == bytes(found["octets"][49:82]).hex()
    assert found["values"]["text"] == "LVDT 0"

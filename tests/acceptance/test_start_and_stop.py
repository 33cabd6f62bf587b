"""Ends in order, second starts, and two recorders in one place."""

from __future__ import annotations

import json
import shutil
import signal
from typing import TYPE_CHECKING

import pytest
from bench.judge import check_gaps, compare
from bench.needs import need
from bench.peer import Roc
from bench.recorder import Recorder
from bench.recording import csv_rows, gaps, is_finished, items, metadata

if TYPE_CHECKING:
    from pathlib import Path

    from bench.process import Child

DEVICE = 'poll = "50ms"\ncycle = "200ms"'


def record_some(recorder: Recorder, roc: Roc, child: Child, more: int) -> None:
    before = len(roc.truth.cleared)
    what = f"{more} more clears"
    child.while_it_runs(lambda: len(roc.truth.cleared) >= before + more, what)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_in_order_and_the_next_start_goes_on(tmp_path: Path, number: int) -> None:
    with Roc(tmp_path, samples=10**6) as roc:
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE))
        for run in (1, 2):
            with recorder.start() as child:
                record_some(recorder, roc, child, 8)
                assert child.stop(number) == 0
                assert "Traceback" not in child.talk()
            assert recorder.hot() == []
            assert len(recorder.sealed()) == run
            assert all(is_finished(path) for path in recorder.sealed())
            state = json.loads((recorder.directory / "state.json").read_text())
            assert int(state["number"]) == run
        truth = roc.end()
    samples = items(recorder.directory, "/roc1/sample")
    assert [item.sequence for item in samples] == list(range(1, len(samples) + 1))
    assert len({item.values.epoch for item in samples}) == 1
    assert len({metadata(p)["roclog.segment"]["logger"] for p in recorder.sealed()}) == 1
    assert len({metadata(p)["roclog.segment"]["run"] for p in recorder.sealed()}) == 2
    comparison = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
    assert comparison.clean
    assert set(truth.cleared) <= set(comparison.found)
    assert [gap.reason for gap in gaps(recorder.directory, "roc1")].count("downtime") == 1


def test_record_for_a_time_ends_by_itself(tmp_path: Path) -> None:
    with Roc(tmp_path, samples=10**6) as roc:
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE))
        with recorder.start("--for", "1.5s") as child:
            assert child.wait() == 0
    assert len(recorder.sealed()) == 1
    assert items(recorder.directory, "/roc1/sample")


def test_a_second_recorder_is_turned_away(tmp_path: Path) -> None:
    with Roc(tmp_path, samples=10**6) as roc:
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE))
        with recorder.start() as first:
            record_some(recorder, roc, first, 2)
            with recorder.start("--quiet") as second:
                assert second.wait() == 6
                talk = second.talk().splitlines()
            assert len(talk) == 1
            assert str(recorder.directory) in talk[0]
            assert "another roclog is recording" in talk[0]
            record_some(recorder, roc, first, 2)
            assert first.stop() == 0


def test_being_stopped_in_the_middle_of_a_commit(tmp_path: Path) -> None:
    """A slow disk: the signal comes while the sample is on its way."""
    need("strace", shutil.which("strace") is not None)
    under = ["strace", "-f", "-qq", "-o", str(tmp_path / "strace"), "-e", "trace=fsync"]
    under += ["-e", "inject=fsync:delay_enter=300000"]
    with Roc(tmp_path, cycle=0.5, samples=10**6) as roc:
        recorder = Recorder(tmp_path, roc.toml(device='poll = "50ms"\ncycle = "500ms"'))
        with recorder.start(under=under) as child:
            child.while_it_runs(lambda: len(roc.truth.cleared) > 1, "some clears")
            made = len(roc.truth.made)
            child.while_it_runs(lambda: len(roc.truth.made) > made, "another sample")
            child.while_it_runs(lambda: len(reads(roc, made + 1)) >= 2, "its second read")
            assert child.stop() == 0
            assert "Traceback" not in child.talk()
        truth = roc.end()
    assert recorder.hot() == []
    comparison = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
    assert comparison.clean
    assert made + 1 in comparison.found


def reads(roc: Roc, k: int) -> list[object]:
    return [line for line in roc.truth.of("read") if line["k"] == k]


def test_downtime_is_told_for_each_device(tmp_path: Path) -> None:
    """A run in which one device does not answer leaves its downtime to the run after it."""
    with (
        Roc(tmp_path, "roc1", samples=10**6) as roc1,
        Roc(tmp_path, "roc2", samples=10**6, seed=2) as roc2,
    ):
        parts = (roc.toml('timeout = "200ms"', DEVICE) for roc in (roc1, roc2))
        recorder = Recorder(tmp_path, *parts, segment="1s")
        with recorder.start() as child:
            record_some(recorder, roc2, child, 5)
        ended = roc2.truth.made[max(roc2.truth.cleared)]["wall_ns"]
        roc2.child.send(signal.SIGSTOP)
        with recorder.start() as child:
            record_some(recorder, roc1, child, 8)
        roc2.child.send(signal.SIGCONT)
        with recorder.start() as child:
            record_some(recorder, roc2, child, 5)
            assert child.stop() == 0
        truth = roc2.end()
    comparison = compare(csv_rows(recorder.directory, tmp_path / "csv", "roc2"), truth)
    missing = [k for k in comparison.missing if k < comparison.found[-1]]
    told = [gap for gap in gaps(recorder.directory, "roc2") if gap.reason == "downtime"]
    assert check_gaps(missing, truth, told).uncovered == []
    assert len(told) == 1
    assert told[0].since < ended + 1e9

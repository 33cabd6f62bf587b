"""Inputs with time stamps through the real command: every state, to the millisecond, once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from bench.recorder import Recorder
from bench.recording import events
from bench.stamped import MEI, SPLIT, Mei, cycles, judge, run

if TYPE_CHECKING:
    from pathlib import Path

CASES: dict[str, dict[str, Any]] = {
    "tcp": {"layout": "interleaved"},
    "tcp-grouped": {"layout": "grouped", "zone": "Europe/Berlin", "dow": "sunday"},
    "tcp-auto": {"layout": "grouped", "asked": "auto", "clock_offset": 90.0, "exceptions": "short"},
    "rtu": {"line": "pty", "layout": "interleaved", "asked": "auto", "clock_drift": 100.0},
    "rtu-grouped": {"line": "pty", "layout": "grouped", "dow": "unused", "exceptions": "short"},
}


@pytest.mark.parametrize("case", CASES)
def test_every_value_and_stamp(tmp_path: Path, case: str) -> None:
    """One request is refused twice, in one of the two forms, and costs nothing."""
    options = dict(CASES[case])
    asked = options.pop("asked", options["layout"])
    zone = options.get("zone", "UTC")
    faults: dict[str, Any] = {"rate": 25, "events": 100, "same": 0.1, "iv": 0.05, "never": 0.02}
    with Mei(tmp_path, fail="0x82:40:4:2;0x94:41:4:2", **faults, **options) as mei:
        recorder = Recorder(tmp_path, mei.toml("200ms", layout=asked, zone=zone))
        with recorder.start() as child:

            def is_quiet() -> bool:
                """All events are made, and everything was asked for twice since then."""
                lines = mei.truth.lines
                states = [n for n, line in enumerate(lines) if line["event"] == "state"]
                rest = [x["mei"] for x in lines[states[-1] :] if x["event"] == "answer"]
                return len(states) == 700 and all(
                    rest.count(mei) >= 2 * SPLIT[mei] for mei in MEI.values()
                )

            child.while_it_runs(is_quiet, "the last event to be read", 60)
            assert child.stop() == 0
        truth = mei.end()
    assert truth.count("exception") == 4
    offset = options.get("clock_offset", 0.0)
    found = judge(recorder.directory, tmp_path / "csv", truth, offset=offset)
    for table, judgement in found.items():
        assert judgement.violations == [], table
        assert judgement.rows >= 300
        assert judgement.rows > 300, f"{table}: no event was recorded"
    for mei_type in MEI.values():
        assert set(cycles(truth, mei_type)[3:]) == {SPLIT[mei_type]}, hex(mei_type)
    assert len(events(recorder.directory, "rtu7.refused")) == 2
    if asked == "auto":
        told = events(recorder.directory, "rtu7.layout")
        assert told == [f"the layout of 300 input_registers from 0 on is {options['layout']}"]


def test_kills_while_events_come(tmp_path: Path) -> None:
    """The short version of campaigns/stamped_events.py."""
    report = run(tmp_path, kills=4, seconds=5, rate=60, seed=2, poll="100ms")
    print(report.summary())
    assert report.violations == []
    for table, found in report.tables.items():
        assert found.rows > 310, table
        assert found.due > 310, table


def test_a_faulty_serial_line(tmp_path: Path) -> None:
    """Spoiled, late and lost answers: no wrong state, none twice, none lost that was told twice."""
    faults: dict[str, Any] = {"late": 0.01, "late_by": 0.3, "corrupt": 0.02, "drop": 0.01}
    with Mei(tmp_path, line="pty", rate=20, same=0.1, garbage=0.02, seed=5, **faults) as mei:
        recorder = Recorder(tmp_path, mei.toml("200ms", connection='timeout = "150ms"'))
        with recorder.start() as child:
            wanted = 12 * sum(SPLIT.values())
            child.while_it_runs(lambda: mei.truth.count("answer") > wanted, "the answers", 60)
            assert child.stop() == 0
        truth = mei.end()
    fates = {line["fate"] for line in truth.of("answer")}
    assert fates == {"ok", "late", "corrupt", "dropped", "garbage"}
    for table, judgement in judge(recorder.directory, tmp_path / "csv", truth).items():
        assert judgement.violations == [], table
        assert judgement.due > 300, table

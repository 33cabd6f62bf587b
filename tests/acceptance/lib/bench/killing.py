"""SIGKILL at random instants, with the truth asked of two devices before each reading back."""

from __future__ import annotations

import signal
import time
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from bench.judge import check_gaps, compare
from bench.peer import Roc
from bench.process import until
from bench.recorder import Recorder, roclog
from bench.recording import csv_rows, files, gaps, indexed, is_finished, stream

if TYPE_CHECKING:
    from pathlib import Path

_SOONEST, _LATEST = 0.15, 2.0
"""Seconds from the start of the process to the kill: from the interpreter's start to the samples."""


@dataclass
class Report:
    kills: int = 0
    cleared: dict[str, int] = field(default_factory=dict)
    kept: dict[str, int] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    downtimes: dict[str, int] = field(default_factory=dict)
    copies: int = 0
    hot_after_kill: int = 0
    violations: list[str] = field(default_factory=list)

    def summary(self) -> str:
        return (
            f"{self.kills} kills, cleared {self.cleared}, kept {self.kept}, missing {self.missing}, "
            f"downtime gaps {self.downtimes}, copies on disk {self.copies}, "
            f"hot segments after kills {self.hot_after_kill}, {len(self.violations)} violations"
        )


def run(folder: Path, kills: int, seed: int) -> Report:
    random = Random(seed)
    report = Report()
    faults = {"late": 0.05, "late_by": 0.8, "corrupt": 0.05, "drop": 0.05, "garbage": 0.05}
    with (
        Roc(folder, "roc1", cycle=0.4, samples=10**6, seed=seed) as roc1,
        Roc(folder, "roc2", line="pty", cycle=1.0, samples=10**6, seed=seed + 1, **faults) as roc2,
    ):
        rocs = [roc1, roc2]
        recorder = Recorder(
            folder,
            roc1.toml(device='poll = "50ms"\ncycle = "400ms"'),
            roc2.toml('timeout = "500ms"', 'poll = "100ms"\ncycle = "1s"'),
            segment="2s",
        )
        for number in range(kills):
            left = recorder.hot()
            with recorder.start() as child:
                _live(random.uniform(_SOONEST, _LATEST))
                child.send(signal.SIGKILL)
                child.wait()
            report.kills += 1
            report.hot_after_kill += len(recorder.hot())
            _check(folder / f"csv{number}", recorder, rocs, report)
            del left
        _last_run(folder, recorder, rocs, report)
    return report


def _live(seconds: float) -> None:
    """The instant of the kill is drawn; nothing is waited for."""
    time.sleep(seconds)


def _check(out: Path, recorder: Recorder, rocs: list[Roc], report: Report) -> None:
    """What the crash left can be read as it is, and has everything that was cleared."""
    truths = {roc.name: roc.truth for roc in rocs}
    if not files(recorder.directory):
        if any(truth.cleared for truth in truths.values()):
            report.violations.append(f"{out.name}: cleared, but there is no file")
        return
    for path in files(recorder.directory):
        try:
            list(stream(path))
            if path in recorder.sealed():
                indexed(path)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is a violation
            report.violations.append(f"{out.name}: {path.name}: {error!r}")
    for name, truth in truths.items():
        try:
            rows = csv_rows(recorder.directory, out, name)
        except (AssertionError, OSError) as error:
            report.violations.append(f"{out.name}: export: {error}")
            return
        comparison = compare(rows, roc_now(rocs, name))
        where = f"{out.name}, {name}"
        kept = set(comparison.found)
        lost = [k for k in truth.cleared if k not in kept]
        if lost:
            report.violations.append(f"{where}: cleared but not in the recording: {lost}")
        report.violations += [f"{where}: twice: {k}" for k in comparison.twice]
        report.violations += [f"{where}: wrong: {text}" for text in comparison.wrong]


def roc_now(rocs: list[Roc], name: str) -> object:
    return next(roc for roc in rocs if roc.name == name).truth

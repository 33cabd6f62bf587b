"""SIGKILL at random instants, with the truth asked of two devices before each reading back."""

from __future__ import annotations

import signal
import time
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from bench.judge import check_gaps, compare
from bench.peer import Roc
from bench.recorder import Recorder, roclog
from bench.recording import csv_rows, files, gaps, indexed, is_finished, items, stream

if TYPE_CHECKING:
    from pathlib import Path

_SOONEST, _LATEST = 0.15, 2.5
"""Seconds from the start of the process to the kill: from its imports on."""


@dataclass
class Report:
    kills: int = 0
    cleared: dict[str, int] = field(default_factory=dict)
    kept: dict[str, int] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    downtimes: dict[str, int] = field(default_factory=dict)
    unread: dict[str, int] = field(default_factory=dict)
    """Completed between an unguarded read and its clear, and never sent intact: told by a gap."""
    copies: int = 0
    hot_after_kill: int = 0
    violations: list[str] = field(default_factory=list)

    def summary(self) -> str:
        return (
            f"{self.kills} kills, cleared {self.cleared}, kept {self.kept}, "
            f"missing {self.missing}, downtime gaps {self.downtimes}, "
            f"cleared unread by a race {self.unread}, "
            f"copies on disk {self.copies}, hot segments {self.hot_after_kill}, "
            f"{len(self.violations)} violations"
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
            with recorder.start() as child:
                time.sleep(random.uniform(_SOONEST, _LATEST))  # the instant of the kill is drawn
                child.send(signal.SIGKILL)
                child.wait()
            report.kills += 1
            report.hot_after_kill += len(recorder.hot())
            _check(folder / f"csv{number}", recorder, rocs, report)
        _last_run(recorder, rocs, report)
        for roc in rocs:
            roc.end()
        _check(folder / "csv", recorder, rocs, report)
        _count(folder / "csv", recorder, rocs, report)
    return report


def _check(out: Path, recorder: Recorder, rocs: list[Roc], report: Report) -> None:
    """What the crash left can be read as it is, and has everything that was cleared."""
    truths = {roc.name: roc.truth for roc in rocs}
    found = files(recorder.directory)
    if not any(truth.cleared for truth in truths.values()):
        return
    for path in found:
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
        comparison = compare(rows, truth)
        where = f"{out.name}, {name}"
        kept = set(comparison.found)
        lost = [k for k in truth.cleared if k not in kept and k in truth.delivered]
        if lost:
            report.violations.append(f"{where}: cleared but not in the recording: {lost}")
        report.violations += [f"{where}: twice: {k}" for k in comparison.twice]
        report.violations += [f"{where}: wrong: {text}" for text in comparison.wrong]


def _last_run(recorder: Recorder, rocs: list[Roc], report: Report) -> None:
    """The next start seals what the kills left; then an end in order."""
    left = recorder.hot()
    cleared = {roc.name: len(roc.truth.cleared) for roc in rocs}

    def goes_on() -> bool:
        return all(len(roc.truth.cleared) > cleared[roc.name] + 1 for roc in rocs)

    with recorder.start() as child:
        child.while_it_runs(goes_on, "clears on both lines")
        child.while_it_runs(lambda: not set(left) & set(recorder.hot()), "the crash to be sealed")
        code = child.stop()
    if code or recorder.hot():
        report.violations.append(f"end: exit code {code}, hot segments {recorder.hot()}")
    report.violations += [f"{p}: no footer" for p in recorder.sealed() if not is_finished(p)]
    said = roclog("verify", recorder.directory)
    if "0 damaged parts, 0 holes, 0 conflicts" not in said.stdout:
        report.violations.append(f"verify: {said.stdout}{said.stderr}")


def _count(out: Path, recorder: Recorder, rocs: list[Roc], report: Report) -> None:
    for roc in rocs:
        truth = roc.truth
        rows = csv_rows(recorder.directory, out, roc.name)
        comparison = compare(rows, truth)
        seqs = [int(row["seq"]) for row in rows]
        if seqs != list(range(1, len(seqs) + 1)):
            report.violations.append(f"{roc.name}: sequence numbers have holes or steps: {seqs}")
        last = comparison.found[-1]
        missing = [k for k in comparison.missing if k < last]
        check = check_gaps(missing, truth, gaps(recorder.directory, roc.name))
        report.cleared[roc.name] = len(truth.cleared)
        report.unread[roc.name] = len(set(truth.cleared) & set(missing) - truth.delivered)
        report.kept[roc.name] = len(comparison.found)
        report.missing[roc.name] = len(missing)
        report.downtimes[roc.name] = check.downtimes
        topic = f"/{roc.name}/sample"
        report.copies += len(items(recorder.directory, topic)) - len(rows)
        report.violations += [f"{roc.name}: sample {k} is in no gap" for k in check.uncovered]
        report.violations += [f"{roc.name}: nothing is missing in {g}" for g in check.empty]
        if not check.downtimes:
            report.violations.append(f"{roc.name}: no downtime was told")

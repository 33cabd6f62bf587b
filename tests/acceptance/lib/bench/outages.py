"""Devices are lost and come back, each many times; the recorder must go on."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from bench.judge import check_gaps, compare, excuse
from bench.outage_cases import CASES, CYCLE
from bench.peer import Roc
from bench.recorder import Recorder
from bench.recording import csv_rows, gaps, items

if TYPE_CHECKING:
    from bench.outage_cases import Moment, Outage
    from bench.process import Child
    from bench.truth import Truth

_DEVICE = f'poll = "250ms"\ncycle = "{CYCLE:g}s"'


@dataclass
class Report:
    """answered: seconds from the peer's return to the first good answer that it sent.

    kept: seconds to the first sample that was asked for after the return and is in the recording.
    """

    case: str
    answered: list[float] = field(default_factory=list)
    kept: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)
    code: int | None = None
    made: int = 0
    missing: int = 0
    told: int = 0
    losses: int = 0
    violations: list[str] = field(default_factory=list)

    def summary(self) -> str:
        return (
            f"{len(self.answered)} outages, answers again after {_spread(self.answered)}, "
            f"keeps samples again after {_spread(self.kept)}, {self.made} samples made, "
            f"{self.missing} missing (gaps say {self.told}), {self.losses} losses of the link, "
            f"open files {self.files}, exit {self.code}, {len(self.violations)} violations"
        )


def _spread(seconds: list[float]) -> str:
    return f"{min(seconds):.2f}-{max(seconds):.2f} s" if seconds else "-"


def run(folder: Path, case: str, times: int, seed: int = 1) -> Report:
    """A second device, on a serial line of its own, must not notice anything.

    seed: of the outages' lengths, which vary by a fifth.
    """
    report = Report(case)
    returns: list[Moment] = []
    random = Random(seed)
    with ExitStack() as stack:
        outage = CASES[case](folder, stack)
        witness = Roc(folder, "witness", line="pty", cycle=CYCLE, samples=10**6, seed=2)
        stack.enter_context(witness)
        recorder = Recorder(folder, _toml(outage), witness.toml(device=_DEVICE))
        child = stack.enter_context(recorder.start(under=outage.recorder_under))
        _goes_on(child, outage.roc, witness)
        report.files.append(_open_files(child))
        for number in range(times):
            outage.cut()
            length = outage.lengths[number % len(outage.lengths)]
            time.sleep(length * random.uniform(0.8, 1.2))  # the outage itself
            returns.append(outage.mend())
            _goes_on(child, outage.roc, witness)
        child.while_it_runs(lambda: _open_files(child) == report.files[0], "the open files")
        report.files.append(_open_files(child))
        report.code = child.stop()
        talk = child.talk()
        truths = {"roc1": outage.roc.end(), "witness": witness.end()}
    _measure(report, recorder, truths["roc1"], returns, outage.limit)
    for name, truth in truths.items():
        _judge(report, folder, recorder, name, truth)
    if report.code != 0 or "Traceback" in talk or "unexpected" in talk:
        report.violations.append(f"exit code {report.code}: {talk}")
    return report


def _toml(outage: Outage) -> str:
    return (
        f"[connections.line]\n{outage.connection()}\n[devices.roc1]\nprofile = "
        f'"hiac-roc"\nconnection = "line"\n{_DEVICE}\n'
    )


def _goes_on(child: Child, *rocs: Roc) -> None:
    """Two more clears on every device."""
    before = {roc.name: len(roc.truth.cleared) for roc in rocs}

    def more() -> bool:
        return all(len(roc.truth.cleared) >= before[roc.name] + 2 for roc in rocs)

    child.while_it_runs(more, "two more clears on every device", 30)


def _open_files(child: Child) -> int:
    return len(list(Path(f"/proc/{child.pid}/fd").iterdir()))


def _measure(
    report: Report, recorder: Recorder, truth: Truth, returns: list[Moment], limit: float
) -> None:
    good = [line["mono_ns"] for line in truth.of("read") if line["fate"] == "ok"]
    samples = [i.values for i in items(recorder.directory, "/roc1/sample")]
    for back in returns:
        answered = min((at for at in good if at > back.mono_ns), default=None)
        kept = min((s.read_at for s in samples if s.asked_at > back.wall_ns), default=None)
        assert answered is not None
        assert kept is not None
        report.answered.append((answered - back.mono_ns) / 1e9)
        report.kept.append((kept - back.wall_ns) / 1e9)
    links = items(recorder.directory, "/roc1/link")
    report.losses = sum(item.values.link_losses for item in links)
    for name, seconds in (("answers", report.answered), ("samples", report.kept)):
        late = [f"{s:.2f} s" for s in seconds if s > limit]
        if late:
            report.violations.append(f"{name} again only after {', '.join(late)}")


def _judge(report: Report, folder: Path, recorder: Recorder, name: str, truth: Truth) -> None:
    """Exact rows; what is missing lies in a gap record; the witness misses nothing."""
    comparison = compare(csv_rows(recorder.directory, folder / "csv", name), truth)
    last = comparison.found[-1]
    missing = [k for k in comparison.missing if k < last]
    check = check_gaps(missing, truth, gaps(recorder.directory, name))
    excuse(check, truth, CYCLE)
    if name == "roc1":
        report.made, report.missing, report.told = len(truth.made), len(missing), check.expected
    elif missing:
        report.violations.append(f"{name}: samples {missing} are missing")
    report.violations += [f"{name}: wrong: {text}" for text in comparison.wrong]
    report.violations += [f"{name}: twice: {k}" for k in comparison.twice]
    report.violations += [f"{name}: sample {k} is in no gap" for k in check.uncovered]
    report.violations += [f"{name}: nothing is missing in {gap}" for gap in check.empty]

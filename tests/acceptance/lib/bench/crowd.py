"""Thirty-one units on one line whose octets take their time: the healthy ones get their due."""

from __future__ import annotations

import json
import math
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bench.judge import check_gaps, compare, excuse
from bench.process import Child, until
from bench.recorder import Recorder
from bench.recording import csv_rows, gaps, items
from bench.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Iterable

_CROWD: Final = Path(__file__).parents[3] / "peers/crowd.py"
_BAUD: Final = 9600
_BITS: Final = 10
_TIMEOUT: Final = 0.5
_TURNAROUND: Final = 0.010
_LEAST_SILENCE: Final = 3.5
"""Characters before a request; the devices' document asks for five."""
_BLOCK: Final = (300, 27)

KINDS: Final = {
    **dict.fromkeys(range(1, 23), "healthy"),
    **dict.fromkeys(range(23, 28), "dead"),
    **dict.fromkeys(range(28, 31), "flapping"),
    31: "babbling",
}
LEAST_SHARE: Final = 0.95
MOST_WASTED: Final = 0.25
_LONG: Final = 600.0
"""Seconds after which the beginning, when the dead are not known yet, weighs little."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Seconds before they are divided by `scale`; octets are that much faster.

    settle: at the beginning, for which nobody's polls are counted. The recorder reads identity and
    configuration of every unit and learns who is dead then.
    """

    scale: float = 1.0
    seconds: float = 600.0
    settle: float = 0.0
    poll: float = 10.0
    cycle: float = 30.0
    flap: float = 40.0
    babble: float = 20.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.scale <= 10:
            raise ValueError("scale: 1 to 10; beyond that the host's scheduler is what is measured")

    @property
    def baud(self) -> int:
        return round(_BAUD * self.scale)

    def scaled(self, seconds: float) -> float:
        return seconds / self.scale


@dataclass
class Unit:
    """due: polls that fit into the run. polls: of the block, as they arrived at the unit; what
    follows within half a period (the confirming read) belongs to the same poll. requests, answers:
    as the recording's `link` channel has them. arrived: requests that the unit has heard.
    """

    unit: int
    kind: str
    due: float
    polls: int = 0
    arrived: int = 0
    requests: int = 0
    answers: int = 0
    timeouts: int = 0
    busy: float = 0.0
    """Part of the time for which it has taken the line."""
    made: int = 0
    kept: int = 0
    missing: int = 0
    told: int = 0

    @property
    def share(self) -> float:
        return self.polls / self.due


@dataclass
class Report:
    plan: Plan
    units: list[Unit] = field(default_factory=list)
    line: dict[str, Any] = field(default_factory=dict)
    """Statistics of the line, and how often the babbler spoke unasked."""
    code: int | None = None
    violations: list[str] = field(default_factory=list)

    @property
    def wasted(self) -> float:
        """Part of the time for which units that never answer rightly have taken the line."""
        return sum(unit.busy for unit in self.units if unit.kind in ("dead", "babbling"))

    def of(self, kind: str) -> list[Unit]:
        return [unit for unit in self.units if unit.kind == kind]


def run(folder: Path, plan: Plan) -> Report:
    report = Report(plan)
    with ExitStack() as stack:
        line = stack.enter_context(_lay_line(folder, plan))
        crowd = stack.enter_context(_gather(folder, plan))
        recorder = Recorder(folder, _toml(folder, plan))
        child = stack.enter_context(recorder.start())
        recorder.wait_for_hot(child)
        counted = time.monotonic_ns() + round(plan.scaled(plan.settle) * 1e9)
        while _seconds_since(counted) < plan.scaled(plan.seconds):
            for process in (line, crowd, child):
                assert process.code is None, process.talk()
            time.sleep(0.1)  # the run itself
        seconds = _seconds_since(counted)
        report.code = child.stop()
        crowd.stop()
        line.stop()
        talk = child.talk()
    said = line.said().splitlines()
    report.line = json.loads(said[2])
    for unit, kind in KINDS.items():
        truth = Truth(folder / f"u{unit}.truth.jsonl")
        found = Unit(unit, kind, seconds / plan.scaled(plan.poll))
        _count(found, truth, recorder, plan, counted)
        _judge(report, found, truth, recorder)
        report.units.append(found)
        if kind == "babbling":
            bursts = list(truth.of("babble"))
            report.line["bursts"] = len(bursts)
            report.line["bursts_into_answers"] = sum(b["spoils"] is not None for b in bursts)
    if report.wasted > MOST_WASTED and plan.seconds >= _LONG:
        report.violations.append(f"dead and babbling units took {report.wasted:.1%} of the line")
    if report.code != 0 or "Traceback" in talk or "unexpected" in talk:
        report.violations.append(f"exit code {report.code}: {talk}")
    return report


def _seconds_since(mono_ns: int) -> float:
    return (time.monotonic_ns() - mono_ns) / 1e9


def _lay_line(folder: Path, plan: Plan) -> Child:
    silence = _LEAST_SILENCE * _BITS / plan.baud
    command = [sys.executable, "-m", "roclog.simulators.serial_line", "--baud", str(plan.baud)]
    command += ["--link-a", str(folder / "client"), "--link-b", str(folder / "server")]
    command += ["--turnaround", f"{round(plan.scaled(_TURNAROUND) * 1e6)}us"]
    command += ["--silence", f"{round(silence * 1e6)}us"]
    line = Child(command, folder / "line", listens=True)
    line.while_it_runs(lambda: line.said().count("\n") == 2, "the line")
    return line


def _gather(folder: Path, plan: Plan) -> Child:
    command = [sys.executable, str(_CROWD), "--port", str(folder / "server")]
    command += ["--truth", str(folder), "--seed", str(plan.seed)]
    for kind in dict.fromkeys(KINDS.values()):
        units = [unit for unit, its_kind in KINDS.items() if its_kind == kind]
        command += [f"--{kind}", f"{units[0]}-{units[-1]}"]
    for name in ("cycle", "flap", "babble"):
        command += [f"--{name}", str(plan.scaled(getattr(plan, name)))]
    command += ["--character", str(_BITS / plan.baud)]
    crowd = Child(command, folder / "crowd")
    until(lambda: crowd.said().startswith("listening") or crowd.code is not None, "the crowd")
    assert crowd.code is None, crowd.talk()
    return crowd


def _toml(folder: Path, plan: Plan) -> str:
    text = f'[connections.line]\ntransport = "rtu"\nport = "{folder / "client"}"\n'
    text += f'baudrate = {plan.baud}\nsilence = "5 chars"\n'
    text += f'timeout = "{round(plan.scaled(_TIMEOUT) * 1000)}ms"\n'
    for unit in KINDS:
        text += f'[devices.u{unit}]\nprofile = "hiac-roc"\nconnection = "line"\nunit = {unit}\n'
        text += f'poll = "{round(plan.scaled(plan.poll) * 1000)}ms"\n'
        text += f'cycle = "{round(plan.scaled(plan.cycle) * 1000)}ms"\n'
    return text


def _count(found: Unit, truth: Truth, recorder: Recorder, plan: Plan, since: int) -> None:
    """since: monotonic nanoseconds from which on polls count."""
    heard = [line for line in truth.lines if "request_mono_ns" in line]
    found.arrived = len(heard)
    apart = plan.scaled(plan.poll) / 2 * 1e9
    last = -apart
    for at in sorted(line["request_mono_ns"] for line in heard if _is_poll(line, found.kind)):
        if at - last >= apart:
            found.polls += at >= since
            last = at
    spans = 0
    for item in items(recorder.directory, f"/u{found.unit}/link"):
        counts = item.values
        found.requests += counts.requests
        found.answers += counts.answers
        found.timeouts += counts.timeouts
        elapsed = counts.to - getattr(counts, "from")
        found.busy += counts.bus_load * elapsed
        spans += elapsed
    found.busy /= max(1, spans)


def _is_poll(line: dict[str, Any], kind: str) -> bool:
    """Whom nothing can be asked but the block's first words is counted by any request."""
    if kind == "healthy":
        return (line.get("address"), line.get("count")) == _BLOCK
    return True


def _judge(report: Report, found: Unit, truth: Truth, recorder: Recorder) -> None:
    name = f"u{found.unit}"
    _judge_traffic(report, found, name)
    has_samples = bool(items(recorder.directory, f"/{name}/sample"))
    if found.kind in ("dead", "babbling"):
        if has_samples:
            report.violations.append(f"{name}: samples of a {found.kind} unit")
        return
    if not has_samples:
        return
    comparison = compare(csv_rows(recorder.directory, recorder.folder / "csv", name), truth)
    since, last = _first_read(truth), comparison.found[-1]
    missing = [k for k in comparison.missing if k < last and truth.made[k]["mono_ns"] > since]
    check = check_gaps(missing, truth, gaps(recorder.directory, name))
    excuse(check, truth, report.plan.scaled(report.plan.cycle))
    found.made, found.kept = len(truth.made), len(comparison.found)
    found.missing, found.told = len(missing), check.expected
    report.violations += [f"{name}: invented or wrong: {text}" for text in comparison.wrong]
    report.violations += [f"{name}: twice: {k}" for k in comparison.twice]
    report.violations += [f"{name}: sample {k} is in no gap" for k in check.uncovered]
    report.violations += [f"{name}: nothing is missing in {gap}" for gap in check.empty]


def _first_read(truth: Truth) -> int:
    """Monotonic nanoseconds; what was complete before is not the recorder's."""
    reads = (line for line in truth.of("read") if line["fate"] == "ok")
    return next(int(line["mono_ns"]) for line in reads if line["address"] == _BLOCK[0])


def _judge_traffic(report: Report, found: Unit, name: str) -> None:
    if found.kind == "healthy" and found.polls < math.floor(LEAST_SHARE * found.due):
        report.violations.append(f"{name}: {found.polls} of {found.due:.1f} polls")
    if found.polls > found.due + 1:
        report.violations.append(f"{name}: {found.polls} polls, {found.due:.1f} were due")
    if not found.arrived <= found.requests <= found.arrived + report.line["collisions"]:
        report.violations.append(
            f"{name}: {found.requests} requests recorded, {found.arrived} arrived, "
            f"{report.line['collisions']} collisions"
        )


def table(units: Iterable[Unit]) -> str:
    heading = (
        f"{'unit':>4} {'kind':<9} {'due':>5} {'polls':>5} {'share':>6} {'heard':>5} {'sent':>5} "
        f"{'answers':>7} {'late/no':>7} {'line':>6} {'made':>5} {'kept':>5} {'lost':>5} {'told':>5}"
    )
    lines = [
        f"{u.unit:4} {u.kind:<9} {u.due:5.1f} {u.polls:5} {u.share:6.1%} {u.arrived:5} "
        f"{u.requests:5} {u.answers:7} {u.timeouts:7} {u.busy:6.1%} {u.made:5} {u.kept:5} "
        f"{u.missing:5} {u.told:5}"
        for u in units
    ]
    return "\n".join([heading, *lines])

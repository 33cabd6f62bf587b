"""A device with time-stamped inputs, recorded, killed, exported, and compared with its truth."""

from __future__ import annotations

import signal
import sys
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final

from bench.process import Child, until
from bench.recorder import Recorder, roclog
from bench.recording import export, gaps, nanoseconds, read_csv
from bench.truth import Truth

if TYPE_CHECKING:
    from typing import Self

    from bench.recording import Gap, Row
    from bench.truth import Line

_PEER: Final = Path(__file__).parents[3] / "peers" / "mei.py"
_MS: Final = 10**6
MEI: Final = {
    (7, "discrete_inputs"): 0x82,
    (7, "input_registers"): 0x84,
    (4, "discrete_inputs"): 0x92,
    (4, "input_registers"): 0x94,
}
_ARRIVED: Final = ("ok", "late", "garbage")
"""What may have become of an answer that the recorder took."""
SPLIT: Final = {0x82: 9, 0x84: 12, 0x92: 5, 0x94: 8}
"""Requests that read 300 inputs: 34, 27, 60 and 41 fit one answer."""


class Mei:
    """tests/peers/mei.py as a process; the options are its own."""

    def __init__(self, folder: Path, *, line: str = "tcp", **options: Any) -> None:
        self.line = line
        self.options = options
        self._log = folder / "mei.truth.jsonl"
        where = ["--tcp", "127.0.0.1:0"] if line == "tcp" else ["--pty", str(folder / "mei")]
        command = [sys.executable, str(_PEER), *where, "--truth", str(self._log)]
        for key, value in options.items():
            command += ["--" + key.replace("_", "-"), str(value)]
        self.child = Child(command, folder / "mei.peer")
        until(lambda: self.child.said().endswith("\n") or self.child.code, "the device to listen")
        assert self.child.code is None, self.child.talk()
        self.address = self.child.said().split()[1]

    @property
    def truth(self) -> Truth:
        return Truth(self._log)

    def end(self) -> Truth:
        self.child.stop()
        return self.truth

    def toml(
        self, poll: str, *, layout: str = "interleaved", zone: str = "UTC", connection: str = ""
    ) -> str:
        """One device for each size of stamps, both on the same unit; connection: further lines."""
        where = f'transport = "rtu"\nport = "{self.address}"\nsilence = "2ms"\nbaudrate = 115200'
        if self.line == "tcp":
            where = f'transport = "tcp"\nhost = "127.0.0.1"\nport = {self.address}'
        return f"[connections.line]\n{where}\n{connection}\n" + "".join(
            f'[devices.rtu{size}]\nprofile = "mei-timestamped"\nconnection = "line"\n'
            f'poll = "{poll}"\ntimezone = "{zone}"\npoints = [\n'
            f'  {{ kind = "discrete_inputs", stamp = {size}, address = 0, count = 300 }},\n'
            f'  {{ kind = "input_registers", stamp = {size}, address = 0, count = 300, '
            f'layout = "{layout}" }},\n]\n'
            for size in (7, 4)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()


@dataclass
class Judgement:
    """One table at one size of stamps. wrong: rows that are not what the device had."""

    rows: int = 0
    states: int = 0
    told: int = 0
    due: int = 0
    """States that two answers in turn told, on one connection."""
    missed: int = 0
    """States of the device that were not recorded; none of them due."""
    violations: list[str] = field(default_factory=list)


def cycles(truth: Truth, mei: int) -> list[int]:
    """Requests for each whole cycle of one MEI type; what asks for the layout is not counted."""
    asked = [line for line in truth.of("answer") if line["mei"] == mei]
    full = [line for line in asked if line["count"] > 2]
    starts = [index for index, line in enumerate(full) if line["address"] == 0]
    return [later - first for first, later in pairwise(starts)]


def judge(
    directory: Path, out: Path, truth: Truth, *, offset: float = 0
) -> dict[tuple[int, str], Judgement]:
    """offset: seconds that the device's clock is ahead."""
    if not out.exists():
        export(directory, out)
    return {
        key: _Judge(key, gaps(directory, f"rtu{key[0]}"), out, truth, offset).judge() for key in MEI
    }


class _Judge:
    def __init__(
        self, key: tuple[int, str], told: list[Gap], out: Path, truth: Truth, offset: float
    ) -> None:
        size, table = key
        self._size = size
        self._offset = int(offset * 1e9)
        self._rows = read_csv(out / f"rtu{size}.{table}.csv")
        self._states = {line["n"]: line for line in truth.of("state") if line["table"] == table}
        answers = [line for line in truth.of("answer") if line["mei"] == MEI[size, table]]
        self._answers = [line for line in answers if line["fate"] == "ok"]
        self._arrived = [line for line in answers if line["fate"] in _ARRIVED]
        self._gaps = told
        self._found = Judgement(rows=len(self._rows), states=len(self._states))

    def judge(self) -> Judgement:
        found = self._found
        kept = self._match()
        told = {n for line in self._arrived for n in line["states"]}
        due = self._due()
        found.told, found.due = len(told), len(due)
        counts = Counter(kept.values())
        self._blame("recorded twice", [n for n, count in counts.items() if count > 1])
        self._blame("told twice in a row, not recorded", due - counts.keys())
        self._blame("recorded, never told", counts.keys() - told)
        seqs = [int(row["seq"]) for row in self._rows]
        if seqs != list(range(1, len(seqs) + 1)):
            found.violations.append("sequence numbers have holes or steps")
        missed = self._states.keys() - counts.keys()
        found.missed = len(missed)
        self._explain(missed, kept)
        return found

    def _match(self) -> dict[int, int]:
        """Index of each row to the number of the state that it is."""
        known = {
            (line["address"], line["octets"][: 2 * self._size]): line
            for line in self._states.values()
        }
        kept = {}
        for index, row in enumerate(self._rows):
            state = known.get((int(row["address"]), row["time_octets"]))
            if state is None:
                self._found.violations.append(f"the device never had {row}")
            else:
                kept[index] = state["n"]
                self._compare(row, state)
        return kept

    def _compare(self, row: Row, state: Line) -> None:
        """To the nanosecond: the device says milliseconds, so the rest must be 0."""
        time_ns = nanoseconds(row["device_time"]) if row["device_time"] else 0
        flags = set(state["flags"])
        if self._size == 4 and "no_time" not in flags:
            flags.add("date_inferred")
        right = int(row["value"]), time_ns, set(row["time_flags"].split())
        if right != (state["value"], state["time_ns"], flags):
            self._found.violations.append(f"{row} is not {state}")
        if row["change"] in ("changed", "restamped") and row["previous_read_at"] and time_ns:
            since = nanoseconds(row["previous_read_at"]) - _MS
            if not since <= time_ns - self._offset <= nanoseconds(row["log_time"]):
                self._found.violations.append(f"{row} was not between its reads")

    def _due(self) -> set[int]:
        by_request: dict[tuple[int, int, int], list[set[int]]] = defaultdict(list)
        for line in self._answers:
            key = line["link"], line["address"], line["count"]
            by_request[key].append(set(line["states"]))
        turns = (pair for answers in by_request.values() for pair in pairwise(answers))
        return {n for first, later in turns for n in first & later}

    def _explain(self, missed: set[int], kept: dict[int, int]) -> None:
        """What is missing fell between two reads that the next row of its input names, or a gap."""
        later: dict[int, list[tuple[int, Row]]] = defaultdict(list)
        for index, n in kept.items():
            later[int(self._rows[index]["address"])].append((n, self._rows[index]))
        for n in sorted(missed):
            state = self._states[n]
            following = [pair for pair in later[state["address"]] if pair[0] > n]
            if following and not self._covered(state, min(following, key=lambda p: p[0])[1]):
                self._found.violations.append(f"nothing says that {state} may be missing")

    def _covered(self, state: Line, row: Row) -> bool:
        if row["change"] == "baseline":  # nobody had looked before
            return True
        at: int = state["wall_ns"]
        if row["previous_read_at"]:
            return nanoseconds(row["previous_read_at"]) <= at <= nanoseconds(row["log_time"])
        return any(_contains(gap, at) for gap in self._gaps)

    def _blame(self, what: str, numbers: Any) -> None:
        self._found.violations += [f"{what}: {self._states.get(n, n)}" for n in sorted(numbers)]


def _contains(gap: Gap, at: int) -> bool:
    return gap.reason == "downtime" and gap.since <= at <= gap.to


@dataclass
class Report:
    kills: int = 0
    events: int = 0
    polls: int = 0
    tables: dict[tuple[int, str], Judgement] = field(default_factory=dict)
    violations: list[str] = field(default_factory=list)

    def summary(self) -> str:
        lines = [f"{self.kills} kills, {self.events} events, {self.polls} answers"]
        lines += [
            f"{table}, {size} octets: {j.states} states, {j.told} told, {j.due} told twice in a "
            f"row, {j.rows} recorded, {j.missed} never seen, {len(j.violations)} violations"
            for (size, table), j in self.tables.items()
        ]
        return "\n".join(lines)


def run(folder: Path, *, kills: int, seconds: float, rate: float, seed: int, poll: str) -> Report:
    """Kills at drawn instants over so many seconds, then an end in order."""
    random = Random(seed)
    report = Report(kills=kills)
    each = seconds / max(1, kills)
    with Mei(folder, rate=rate, same=0.1, iv=0.02, never=0.02, seed=seed) as mei:
        recorder = Recorder(folder, mei.toml(poll), segment="2s")
        for _ in range(kills):
            ends = time.monotonic() + each * random.uniform(0.5, 1.5)
            with recorder.start() as child:
                time.sleep(max(0.15, ends - time.monotonic()))  # the instant of the kill is drawn
                child.send(signal.SIGKILL)
                child.wait()
        _last_run(mei, recorder, report)
        truth = mei.end()
    report.events = truth.count("state") - 600
    report.polls = truth.count("answer")
    report.tables = judge(recorder.directory, folder / "csv", truth)
    for (size, table), found in report.tables.items():
        report.violations += [f"{table}, {size} octets: {text}" for text in found.violations]
    said = roclog("verify", recorder.directory)
    if "0 damaged parts, 0 holes, 0 conflicts" not in said.stdout:
        report.violations.append(f"verify: {said.stdout}{said.stderr}")
    return report


def _last_run(mei: Mei, recorder: Recorder, report: Report) -> None:
    """Two whole cycles of everything, so that nothing waits any more; then an end in order."""
    answers = mei.truth.count("answer")
    wanted = answers + 3 * sum(SPLIT.values())
    with recorder.start() as child:
        child.while_it_runs(lambda: mei.truth.count("answer") >= wanted, "three cycles")
        code = child.stop()
    if code or recorder.hot():
        report.violations.append(f"end: exit code {code}, hot segments {recorder.hot()}")

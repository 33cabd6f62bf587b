"""One device from its first sample to its last, recorded, exported and compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bench.judge import Comparison, GapCheck, check_gaps, compare
from bench.peer import Roc
from bench.process import until
from bench.recorder import Recorder
from bench.recording import csv_rows, gaps

if TYPE_CHECKING:
    from pathlib import Path

    from bench.recording import Row
    from bench.truth import Truth


@dataclass
class Outcome:
    rows: list[Row]
    truth: Truth
    comparison: Comparison
    gaps: GapCheck
    directory: Path
    code: int

    def summary(self) -> str:
        c, g = self.comparison, self.gaps
        made = len(self.truth.made)
        return (
            f"{made} made, {len(c.found)} kept, {len(c.missing)} missing "
            f"(gaps say {g.expected}), {len(c.twice)} twice, {len(c.wrong)} wrong, "
            f"{len(g.uncovered)} uncovered, {len(g.empty)} empty gaps, exit {self.code}"
        )


def run(
    folder: Path,
    *,
    line: str = "tcp",
    cycle: float = 0.2,
    samples: int = 60,
    poll: str = "50ms",
    segment: str = "5s",
    connection: str = "",
    device: str = "",
    **options: object,
) -> Outcome:
    """connection, device: further lines of the configuration. options: of the peer."""
    directory = folder / "recordings"
    settled = {"linger": 60, "cycle": cycle, "samples": samples, **options}
    if options.pop("check_disk", False):
        settled["check_disk"] = directory
    with Roc(folder, line=line, **settled) as roc:
        device = f'poll = "{poll}"\ncycle = "{round(cycle * 1000)}ms"\n{device}'
        recorder = Recorder(folder, roc.toml(connection, device), segment=segment)
        with recorder.start() as child:
            child.while_it_runs(
                lambda: samples in roc.truth.made, "the last sample", 30 + samples * cycle * 2
            )
            _let_settle(roc, samples, cycle)
            code = child.stop()
            truth = roc.end()
    rows = csv_rows(directory, folder / "csv")
    comparison = compare(rows, truth)
    found = check_gaps(comparison.missing, truth, gaps(directory, "roc1"))
    return Outcome(rows, truth, comparison, found, directory, code)


def _let_settle(roc: Roc, last: int, cycle: float) -> None:
    """Until the last sample was read, but no longer: a device that ends looks overdue."""

    def done() -> bool:
        truth = roc.truth
        reads = [line for line in truth.of("read") if line["k"] == last]
        return sum(line["fate"] == "ok" for line in reads) > (1 if last in truth.cleared else 2)

    until(done, "the last sample to be read", 10 * cycle)

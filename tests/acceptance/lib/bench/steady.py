"""One device from its first sample to its last, recorded, exported and compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bench.judge import Comparison, GapCheck, check_gaps, compare, excuse
from bench.peer import Roc
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
            f"{len(g.uncovered)} uncovered, {len(g.empty)} empty gaps, "
            f"{g.idle} possible gaps without any, {g.excused} excused, exit {self.code}"
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
    **options: Any,
) -> Outcome:
    """Stops the recorder, not the device, after so many samples; a device that ends looks overdue.

    connection, device: further lines of the configuration. options: of the peer.
    """
    directory = folder / "recordings"
    settled = {"cycle": cycle, "samples": 10**6, **options}
    if options.pop("check_disk", False):
        settled["check_disk"] = directory
    with Roc(folder, line=line, **settled) as roc:
        device = f'poll = "{poll}"\ncycle = "{round(cycle * 1000)}ms"\n{device}'
        recorder = Recorder(folder, roc.toml(connection, device), segment=segment)
        with recorder.start() as child:
            wait = 30 + samples * cycle * 2
            child.while_it_runs(lambda: _was_read(roc, samples), "the last sample", wait)
            code = child.stop()
            truth = roc.end()
    rows = csv_rows(directory, folder / "csv")
    comparison = compare(rows, truth)
    last = comparison.found[-1]
    comparison.missing = [k for k in comparison.missing if k < last]
    found = check_gaps(comparison.missing, truth, gaps(directory, "roc1"))
    excuse(found, truth, cycle)
    return Outcome(rows, truth, comparison, found, directory, code)


def _was_read(roc: Roc, last: int) -> bool:
    reads = [line for line in roc.truth.of("read") if (line["k"] or 0) >= last]
    return len([line for line in reads if line["fate"] == "ok"]) >= 3

"""A week of samples in minutes: memory and open files over time, printed as a table."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.soak import SAMPLES_A_DAY, run

_ROWS = 24
_MOST_A_DAY = 1_000_000


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=40_500)
    parser.add_argument("--cycle", type=float, default=0.012, help="seconds")
    parser.add_argument("--poll", default="3ms")
    parser.add_argument("--segment", default="3s")
    parser.add_argument("--rotations", type=int, default=150, help="at least so many")
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="soak-"))
    print(f"recordings and truth log: {folder}", flush=True)
    report = run(folder, given.samples, cycle=given.cycle, poll=given.poll, segment=given.segment)
    print(f"{'time':>7} {'days':>6} {'samples':>8} {'segments':>8} {'resident':>10} {'files':>5}")
    step = max(1, len(report.measures) // _ROWS)
    for m in [*report.measures[::step], report.measures[-1]]:
        day = m.made / SAMPLES_A_DAY
        memory = f"{m.resident / 1e6:.2f} MB"
        print(f"{m.seconds:6.0f}s {day:6.2f} {m.made:8} {m.segments:8} {memory:>10} {m.files:5}")
    growth, files = report.growth_a_day(), report.files_seen()
    kept = len(report.comparison.found)
    rotations = report.measures[-1].segments
    print(f"after the first hour: {growth / 1e6:+.3f} MB a day, open files {files}")
    print(f"{kept} kept, {len(report.comparison.missing)} not read in time, {rotations} rotations")
    good = report.comparison.clean and report.code == 0 and growth < _MOST_A_DAY
    steady = files[-1] - files[0] <= 3  # the sealer and the state file come and go
    return 0 if good and steady and rotations >= given.rotations else 1


if __name__ == "__main__":
    sys.exit(main())

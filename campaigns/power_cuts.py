"""Power cuts on a loop-mounted ext4 (root), then the control: without fsync they must lose."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.power import possible, run, which


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if not possible() or which("eatmydata") is None:
        print("needs root, loop devices, mkfs.ext4 and eatmydata")
        return 1
    real, control = (Path(tempfile.mkdtemp(prefix="power-cuts-")) for _ in range(2))
    print(f"recordings and truth logs: {real}, {control}", flush=True)
    report = run(real, given.cuts, given.seed)
    print(report.summary())
    for violation in report.violations:
        print(f"    {violation}")
    without = run(control, 1, given.seed, under=["eatmydata"], segment="1h")
    print(f"control without fsync: {without.summary()}")
    return 1 if report.violations or not without.lost else 0


if __name__ == "__main__":
    sys.exit(main())

"""Kill -9 at random instants, two devices at once; every crash is read back before the next."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.killing import run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for everything, instead of a new one")
    given = parser.parse_args()
    folder = given.keep or Path(tempfile.mkdtemp(prefix="killed-"))
    folder.mkdir(exist_ok=True)
    print(f"recordings and truth logs: {folder}", flush=True)
    report = run(folder, given.kills, given.seed)
    print(report.summary())
    for violation in report.violations:
        print(f"    {violation}")
    return 1 if report.violations else 0


if __name__ == "__main__":
    sys.exit(main())

"""Time-stamped inputs with many events, the recorder killed again and again: each state once.

The default is ten minutes of 10 events a second and polls once a second, ten times as fast.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.stamped import run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rate", type=float, default=100, help="events per second")
    parser.add_argument("--poll", default="100ms")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for everything, instead of a new one")
    given = parser.parse_args()
    folder = given.keep or Path(tempfile.mkdtemp(prefix="stamped-"))
    folder.mkdir(exist_ok=True)
    print(f"recordings and truth log: {folder}", flush=True)
    report = run(
        folder,
        kills=given.kills,
        seconds=given.seconds,
        rate=given.rate,
        seed=given.seed,
        poll=given.poll,
    )
    print(report.summary())
    for violation in report.violations:
        print(f"    {violation}")
    return 1 if report.violations else 0


if __name__ == "__main__":
    sys.exit(main())

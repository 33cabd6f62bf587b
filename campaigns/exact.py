"""300 samples at 5/s with a race at every fifth clear; the device looks for each on disk itself."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.steady import run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="exact-"))
    print(f"recording and truth log: {folder}", flush=True)
    outcome = run(folder, samples=given.samples, race_every=5, check_disk=True, seed=given.seed)
    clears = list(outcome.truth.of("clear"))
    absent = [line["k"] for line in clears if line["on_disk"] is not True]
    races = sum(line["raced"] for line in clears)
    print(outcome.summary())
    print(f"{len(clears)} clears, {races} raced, {len(absent)} without their sample on disk")
    whole = outcome.comparison.found[: given.samples] == list(range(1, given.samples + 1))
    good = whole and outcome.comparison.clean and outcome.gaps.clean and not absent
    return 0 if good and outcome.code == 0 else 1


if __name__ == "__main__":
    sys.exit(main())

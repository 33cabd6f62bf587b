"""Many faulty serial lines at once: 300 samples each, other seeds, cycles, polls and manners."""

from __future__ import annotations

import argparse
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.steady import Outcome, run

PLANS = tuple(
    (cycle, poll, busy)
    for cycle, poll in (
        (1.0, "100ms"),
        (1.0, "50ms"),
        (1.0, "300ms"),
        (0.7, "50ms"),
        (0.7, "100ms"),
        (0.7, "200ms"),
        (2.0, "100ms"),
        (2.0, "300ms"),
    )
    for busy in ("queue", "deaf")
)


def one(folder: Path, seed: int, samples: int, plan: tuple[float, str, str]) -> Outcome:
    cycle, poll, busy = plan
    place = folder / f"{seed}-{cycle}-{poll}-{busy}"
    place.mkdir()
    return run(
        place,
        line="pty",
        cycle=cycle,
        samples=samples,
        poll=poll,
        segment="1min",
        connection='timeout = "500ms"',
        late=0.1,
        late_by=0.8,
        corrupt=0.05,
        drop=0.05,
        garbage=0.05,
        busy=busy,
        seed=seed,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--at-once", type=int, default=16)
    parser.add_argument("--keep", type=Path, help="folder for everything, instead of a new one")
    given = parser.parse_args()
    folder = given.keep or Path(tempfile.mkdtemp(prefix="faulty-line-"))
    folder.mkdir(exist_ok=True)
    print(f"recordings and truth logs: {folder}", flush=True)
    jobs = [(seed, plan) for seed in given.seeds for plan in PLANS]
    bad = 0
    with ThreadPoolExecutor(given.at_once) as pool:
        outcomes = pool.map(lambda job: one(folder, job[0], given.samples, job[1]), jobs)
        for (seed, (cycle, poll, busy)), outcome in zip(jobs, outcomes, strict=True):
            good = outcome.comparison.clean and outcome.gaps.clean and outcome.code == 0
            bad += not good
            name = f"seed {seed}, cycle {cycle} s, poll {poll}, {busy}"
            print(f"{'ok ' if good else 'BAD'} {name}: {outcome.summary()}", flush=True)
            for sample in outcome.gaps.uncovered:
                print(f"    sample {sample} is in no gap record")
            for gap in outcome.gaps.empty:
                print(f"    nothing is missing in {gap}")
            for text in outcome.comparison.wrong:
                print(f"    {text}")
    print(f"{len(jobs)} runs, {bad} with violations")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())

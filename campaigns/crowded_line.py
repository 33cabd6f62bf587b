"""31 units on one line of 9600 Bd: 22 healthy, 5 dead, 3 that come and go, 1 that babbles."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.crowd import LEAST_SHARE, MOST_WASTED, Plan, run, table

if TYPE_CHECKING:
    from bench.crowd import Report


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--seconds", type=float, default=600, help="before they are divided by the scale"
    )
    parser.add_argument(
        "--scale", type=float, default=1, help="1 to 10: octets, time-outs, periods so much faster"
    )
    parser.add_argument(
        "--settle", type=float, default=0, help="seconds before these that do not count, likewise"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="the figures as JSON on stdout")
    given = parser.parse_args()
    try:
        plan = Plan(scale=given.scale, seconds=given.seconds, settle=given.settle, seed=given.seed)
    except ValueError as error:
        parser.error(str(error))
    folder = Path(tempfile.mkdtemp(prefix="crowded-line-"))
    print(f"recording and truth logs: {folder}", file=sys.stderr, flush=True)
    report = run(folder, plan)
    if given.json:
        print(json.dumps({**asdict(report), "wasted": report.wasted}, indent=2))
    else:
        tell(report)
    return 1 if report.violations else 0


def tell(report: Report) -> None:
    print(table(report.units))
    line, healthy = report.line, report.of("healthy")
    least = min(unit.share for unit in healthy)
    print(
        f"{line['baud']} Bd, {line['duration_s']:.0f} s: octets on the line "
        f"{line['busy']:.1%} of the time, {line['collisions']} collisions, "
        f"{line['short_gaps']} short gaps, {line['bursts']} bursts unasked, "
        f"{line['bursts_into_answers']} of them into an answer"
    )
    print(
        f"healthy units: at least {least:.1%} of their polls (asked: {LEAST_SHARE:.0%}); "
        f"dead and babbling ones took {report.wasted:.1%} of the line (at most "
        f"{MOST_WASTED:.0%}); exit {report.code}, "
        f"{len(report.violations)} violations"
    )
    for violation in report.violations:
        print(f"    {violation}")


if __name__ == "__main__":
    sys.exit(main())

"""A device is lost and comes back, many times and in nine ways; the recorder must go on."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/acceptance/lib"))

from bench.outage_cases import CASES, namespaces_possible
from bench.outages import Report, run


def main() -> int:
    cases = "; ".join(f"{name}: {case.__doc__}" for name, case in CASES.items())
    parser = argparse.ArgumentParser(description=__doc__, epilog=cases)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all")
    parser.add_argument("--times", type=int, default=20, help="outages of each")
    parser.add_argument("--seed", type=int, default=1, help="of their lengths")
    parser.add_argument("--at-once", type=int, default=len(CASES), help="cases side by side")
    parser.add_argument("--json", action="store_true", help="the figures as JSON on stdout")
    given = parser.parse_args()
    wanted = given.cases or list(CASES)
    if unknown := set(wanted) - set(CASES):
        parser.error(f"{', '.join(sorted(unknown))}: not one of {', '.join(CASES)}")
    if any(CASES[name].needs_root for name in wanted) and not namespaces_possible():
        print("split, vanished and rebooted need root and network namespaces", file=sys.stderr)
        return 1
    folder = Path(tempfile.mkdtemp(prefix="outages-"))
    print(f"recordings and truth logs: {folder}", file=sys.stderr, flush=True)

    def one(name: str) -> Report:
        place = folder / name
        place.mkdir()
        try:
            return run(place, name, given.times, given.seed)
        except AssertionError as error:
            return Report(name, violations=[str(error)])

    with ThreadPoolExecutor(given.at_once) as pool:
        reports = list(pool.map(one, wanted))
    if given.json:
        print(json.dumps([asdict(report) for report in reports], indent=2))
    for report in [] if given.json else reports:
        print(f"{'BAD' if report.violations else 'ok '} {report.case}: {report.summary()}")
        for violation in report.violations:
            print(f"    {violation}")
    return 1 if any(report.violations for report in reports) else 0


if __name__ == "__main__":
    sys.exit(main())

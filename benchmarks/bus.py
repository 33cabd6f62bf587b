"""roclog's bus beside other Modbus clients, all in one run and in turns, so that noise hits all."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

sys.path.insert(0, str(Path(__file__).parent / "lib"))

from yardstick import late_answers, report, serial_line, tcp_polls
from yardstick.processes import MALLOC, choose_malloc

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.table import Table

PARTS: dict[str, Callable[[bool, Callable[[str], None]], tuple[list[Table], Any]]] = {
    "serial": serial_line.measure,
    "late": late_answers.measure,
    "tcp": tcp_polls.measure,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=PARTS, action="append", help="these parts (repeatable)")
    parser.add_argument("--quick", action="store_true", help="fewer and shorter rounds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every round's figures")
    parser.add_argument("--malloc", choices=MALLOC, default="equal", help="of the clients; README")
    given = parser.parse_args()
    choose_malloc(given.malloc)
    talk = Console(stderr=True)
    console = report.console()
    figures: dict[str, Any] = {"machine": {**report.machine(), "malloc": given.malloc}}
    console.print(*(f"{key} {value}" for key, value in figures["machine"].items()), sep=", ")
    for name in given.only or PARTS:
        with talk.status(name) as status:
            tables, figures[name] = PARTS[name](given.quick, status.update)
        for table in tables:
            console.print(table)
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Reads of a serial device that answers one in ten after the time-out."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from yardstick.job import Job, Outcome
from yardstick.processes import Peer, run_client
from yardstick.report import median, spread, table
from yardstick.rounds import in_turns

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.table import Table

_CLIENTS: Final = (
    "roclog",
    "raw serial",
    "raw serial, late kept",
    "pymodbus",
    "modbus-tk",
    "libmodbus",
)
_BASELINES: Final = ("raw serial", "raw serial, late kept")
_READS: Final = 250
_BAUD: Final = 115_200
_SILENCE: Final = 1.75e-3


def measure(quick: bool, tell: Callable[[str], None]) -> tuple[list[Table], Any]:
    tables, figures = [], {}
    for kind in ("queueing", "deaf"):
        once = partial(_once, kind=kind, reads=100 if quick else _READS)
        rounds = in_turns(_CLIENTS, 1 if quick else 3, once, tell, kind)
        tables.append(_table(kind, rounds))
        figures[kind] = {c: [asdict(each) for each in done] for c, done in rounds.items()}
    return tables, figures


def _once(client: str, number: int, *, kind: str, reads: int) -> Outcome:
    deaf = ["--deaf"] if kind == "deaf" else []
    manner = ("--turnaround=0.01", "--late=0.1", f"--seed={number}", *deaf)
    with Peer("yardstick.serial_device", *manner) as device:
        job = Job(
            client=client,
            port=device.ready[0],
            baud=_BAUD,
            timeout=0.06,
            late_answer=0.3,
            silence=_SILENCE,
            polls=reads,
            moving=True,
        )
        return run_client(job)


def _table(kind: str, rounds: dict[str, list[Outcome]]) -> Table:
    made = table(
        f"a {kind} device, 10 % of the answers late; sums of {len(rounds['roclog'])} rounds",
        "client",
        "good",
        "wrong",
        "failed",
        "good/s",
        "of the best policy",
        "spread",
    )
    best = max(median(each.rate for each in rounds[client]) for client in _BASELINES)
    for client, done in rounds.items():
        if not done:
            made.add_row(client, "not installed")
            continue
        rates = [each.rate for each in done]
        wrong = sum(each.wrong for each in done)
        made.add_row(
            client,
            str(sum(each.good for each in done)),
            str(wrong),
            str(sum(each.failed for each in done)),
            f"{median(rates):.2f}",
            f"{median(rates) / best:.1%}" if not wrong else "wrong data",
            f"{spread(rates):.1%}",
        )
    return made

"""Polls a second on a line on which every octet takes its time, against what the silence allows."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from yardstick.ceiling import Line
from yardstick.job import Job, Outcome
from yardstick.processes import Peer, run_client
from yardstick.report import median, quantile, spread, table
from yardstick.rounds import in_turns

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.table import Table

_LINES: Final = (Line(9600), Line(115_200), Line(9600, tick=0.016))
_CLIENTS: Final = (
    "roclog",
    "pymodbus",
    "raw serial",
    "minimalmodbus",
    "modbus-tk",
    "libmodbus",
)
_FIFO: Final = 16
"""Octets that a fast line delivers together, as a 16550 does."""


@dataclass(frozen=True)
class Round:
    outcome: Outcome
    wire: dict[str, Any]
    device: dict[str, Any]


def measure(quick: bool, tell: Callable[[str], None]) -> tuple[list[Table], Any]:
    tables, figures = [], {}
    for line in _LINES:
        once = partial(_once, line=line, polls=round((1.5 if quick else 2.5) / line.cycle))
        rounds = in_turns(_CLIENTS, 2 if quick else 5, once, tell, line.name)
        tables.append(_table(line, rounds))
        figures[line.name] = {
            "ceiling": line.ceiling,
            "rounds": {c: [asdict(r) for r in done] for c, done in rounds.items()},
        }
    return tables, figures


def _once(client: str, _: int, *, line: Line, polls: int) -> Round:
    with tempfile.TemporaryDirectory() as folder:
        near, far = str(Path(folder, "client")), str(Path(folder, "device"))
        wire = Peer(
            "roclog.simulators.serial_line",
            f"--baud={line.baud}",
            f"--turnaround={line.turnaround * 1e3:g}ms",
            f"--usb-latency={line.tick * 1e3:g}ms",
            f"--fifo={_FIFO if line.baud > 19_200 else 1}",
            f"--link-a={near}",
            f"--link-b={far}",
            lines=2,
        )
        with wire, Peer("yardstick.serial_device", "--port", far) as device:
            job = Job(client=client, port=near, baud=line.baud, silence=line.silence, polls=polls)
            outcome = run_client(job)
        return Round(outcome, wire.seen, device.seen)


def _table(line: Line, rounds: dict[str, list[Round]]) -> Table:
    made = table(
        f"{line.name}: the silence allows {line.ceiling:.3f} polls/s "
        f"(one each {line.cycle * 1e3:.2f} ms)",
        "client",
        "polls/s",
        "of the ceiling",
        "spread",
        "short gaps",
        "collisions",
        "not good",
        "CPU us/poll",
        "late us p50 / p99",
    )
    for client, done in rounds.items():
        if not done:
            made.add_row(client, "not installed")
            continue
        rates = [each.outcome.rate for each in done]
        late = [us for each in done for us in each.outcome.late_us]
        made.add_row(
            client,
            f"{median(rates):.3f}",
            f"{median(rates) / line.ceiling:.2%}",
            f"{spread(rates):.1%}",
            f"{_sum(done, 'short_gaps')} of {_sum(done, 'requests')}",
            str(_sum(done, "collisions")),
            str(sum(each.outcome.wrong + each.outcome.failed for each in done)),
            f"{median(each.outcome.cpu_us for each in done):.0f}",
            f"{quantile(late, 0.5):.0f} / {quantile(late, 0.99):.0f}" if late else "",
        )
    return made


def _sum(done: list[Round], name: str) -> int:
    return sum(int(each.wire[name]) for each in done)

"""As many reads as fit, on 1, 100 and 1000 TCP connections, one request out on each."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from yardstick.client import WARM_UP
from yardstick.job import Job, Outcome
from yardstick.processes import Peer, run_client
from yardstick.report import median, spread, table
from yardstick.rounds import in_turns

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.table import Table

_CLIENTS: Final = ("roclog", "pymodbus", "raw asyncio")
_BLOCKING: Final = ("pyModbusTCP", "modbus-tk", "libmodbus")
"""Measured on one connection only."""


def measure(quick: bool, tell: Callable[[str], None]) -> tuple[list[Table], Any]:
    tables, figures = [], {}
    for connections in (1, 100, 1000):
        clients = (*_CLIENTS, *_BLOCKING) if connections == 1 else _CLIENTS
        once = partial(_once, connections=connections, seconds=0.7 if quick else 1.5)
        what = f"{connections} connections"
        rounds = in_turns(clients, 2 if quick else 5, once, tell, what)
        tables.append(_table(connections, rounds))
        figures[str(connections)] = {c: [asdict(o) for o in done] for c, done in rounds.items()}
    return tables, figures


def _once(client: str, _: int, *, connections: int, seconds: float) -> Outcome:
    with Peer("yardstick.tcp_devices") as devices:
        job = Job(
            client=client,
            tcp_port=int(devices.ready[0]),
            connections=connections,
            seconds=seconds,
            timeout=3.0,
        )
        outcome = run_client(job)
    if devices.seen["unexpected"]:
        raise RuntimeError(f"{client} sent {devices.seen['unexpected']} other requests")
    counted = outcome.good + outcome.wrong + outcome.failed
    if devices.seen["answered"] != counted + WARM_UP * connections:
        raise RuntimeError(f"{client} counts {counted}, the devices {devices.seen['answered']}")
    return outcome


def _table(connections: int, rounds: dict[str, list[Outcome]]) -> Table:
    made = table(
        f"TCP, {connections} connection{'s' * (connections > 1)}",
        "client",
        "polls/s",
        "spread",
        "not good",
        "CPU us/poll",
        "of it system",
        "spread of CPU",
        "CPU, of pymodbus",
        "CPU, of raw asyncio",
    )
    cpu = {c: median(o.cpu_us for o in done) for c, done in rounds.items() if done}
    for client, done in rounds.items():
        if not done:
            made.add_row(client, "not installed")
            continue
        made.add_row(
            client,
            f"{median(o.rate for o in done):.0f}",
            f"{spread([o.rate for o in done]):.0%}",
            str(sum(o.wrong + o.failed for o in done)),
            f"{cpu[client]:.1f}",
            f"{median(o.system_us for o in done):.1f}",
            f"{spread([o.cpu_us for o in done]):.0%}",
            f"{cpu[client] / cpu['pymodbus']:.2f}",
            f"{cpu[client] / cpu['raw asyncio']:.2f}",
        )
    return made

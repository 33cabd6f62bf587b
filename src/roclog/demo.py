"""The demo: simulated devices, recorded for real, compared with what the devices made."""

from __future__ import annotations

import csv
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Final, TextIO

from roclog.clock import SystemClock
from roclog.config import load
from roclog.runner import record
from roclog.simulators import PtyEndpoint, SimulatedRoc, SimulatorServer, TcpEndpoint

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from roclog.session import Session

SPEED: Final = 30
"""Simulated seconds in one second: the 15 s cycle of the counters takes half a second."""
_LAST_SECOND: Final = 1.0
"""Simulated time stands still for the end of the demo, so that the last sample is read as well."""
_DEVICES: Final = {"roc1": 138, "roc2": 139, "roc3": 138}

_CONFIGURATION: Final = """\
# The demo's configuration: two particle counters on one serial line, one behind TCP.
# They are simulated at {speed} times real speed, hence the short cycle and poll.

[recording]
directory = "recordings"

[connections.line]
transport = "rtu"
port = "{link}"

[connections.plant]
transport = "tcp"
host = "127.0.0.1"
port = {port}

[devices.roc1]
profile = "hiac-roc"
connection = "line"
unit = {roc1}
poll = "100ms"
cycle = "500ms"

[devices.roc2]
profile = "hiac-roc"
connection = "line"
unit = {roc2}
poll = "100ms"
cycle = "500ms"

[devices.roc3]
profile = "hiac-roc"
connection = "plant"
unit = {roc3}
poll = "100ms"
cycle = "500ms"
"""


@dataclass(frozen=True, slots=True)
class Paths:
    """Everything the demo leaves behind."""

    root: Path

    @property
    def configuration(self) -> Path:
        return self.root / "demo.toml"

    @property
    def recordings(self) -> Path:
        return self.root / "recordings"

    @property
    def csv(self) -> Path:
        return self.root / "csv"

    @property
    def plot(self) -> Path:
        return self.root / "plot.png"

    def truth(self, device: str) -> Path:
        """What the simulated device made, written by the simulator itself."""
        return self.root / "truth" / f"{device}.csv"


async def run_demo(paths: Paths, seconds: float, on_second: Callable[[Session], None]) -> None:
    """Simulate and record for ``seconds`` of real time into an empty folder.

    Raises:
        OSError: no pseudo terminal or port to be had, or the folder cannot be written.
        StorageError: as Session.
    """
    paths.truth("").parent.mkdir(parents=True, exist_ok=True)
    freeze_at = time.monotonic() + seconds - _LAST_SECOND

    def simulated_clock() -> float:
        return min(time.monotonic(), freeze_at)

    async with AsyncExitStack() as stack:
        truths = {
            name: stack.enter_context(paths.truth(name).open("w", newline="")) for name in _DEVICES
        }
        plant = TcpEndpoint("127.0.0.1", 0)
        link = paths.root.absolute() / "serial-line"
        lines = (
            (_simulated(("roc1", "roc2"), truths), PtyEndpoint(str(link))),
            (_simulated(("roc3",), truths), plant),
        )
        for devices, endpoint in lines:
            server = SimulatorServer(devices, endpoint, speed=SPEED, clock=simulated_clock)
            await stack.enter_async_context(server)
        text = _CONFIGURATION.format(speed=SPEED, link=link, port=plant.port, **_DEVICES)
        paths.configuration.write_text(text)
        await record(load(paths.configuration), SystemClock(), seconds, on_second)


def _simulated(names: tuple[str, ...], truths: Mapping[str, TextIO]) -> list[SimulatedRoc]:
    return [SimulatedRoc(_DEVICES[name], seed=int(name[-1]), truth=truths[name]) for name in names]


def compare(truth: Path, exported: Path) -> tuple[int, int]:
    """Rows that the device made, and how many of them the export has, in order and exact."""
    made = _rows(truth)
    names = [name for name in made[0] if name != "sample"] if made else []
    found = [[_exact(row[name]) for name in names] for row in _rows(exported)]
    equal = 0
    for row in found:
        if equal < len(made) and row == [_exact(made[equal][name]) for name in names]:
            equal += 1
    return len(made), equal


def _exact(text: str) -> Decimal | str:
    """A number as a number, so that 144 and 144.0 are equal and 144.01 is not."""
    try:
        return Decimal(text)
    except InvalidOperation:
        return text


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))

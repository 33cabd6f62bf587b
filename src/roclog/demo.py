"""The demo: simulated devices, recorded for real, compared with what the devices made."""

from __future__ import annotations

import csv
import time
from collections import defaultdict
from contextlib import AsyncExitStack
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Final, TextIO

from roclog.clock import SystemClock
from roclog.config import load
from roclog.quantities import parse_instant
from roclog.runner import record
from roclog.simulators import (
    PtyEndpoint,
    SimulatedRoc,
    SimulatedStampedInputs,
    SimulatorServer,
    TcpEndpoint,
    UdpEndpoint,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from roclog.session import Session

    _State = tuple[str, str, int]

SPEED: Final = 30
"""Simulated seconds in one second: the 15 s cycle of the counters takes half a second."""
_LAST_SECOND: Final = 1.0
"""Simulated time stands still for the end of the demo, so that the last sample is read as well."""
_DEVICES: Final = {"roc1": 138, "roc2": 139, "roc3": 138}
STAMPED: Final = "rtu7"
"""The device with time-stamped inputs; it runs at real speed, since its clock is compared with the
host's."""
_CHANGES_PER_SECOND: Final = 4
_DATELESS: Final = 4
"""Octets of a stamp without a date."""

_CONFIGURATION: Final = """\
# The demo's configuration: two particle counters on one serial line, one behind TCP, and a device
# with time-stamped inputs on UDP. The counters are simulated at {speed} times real speed, hence
# their short cycle and poll.

[recording]
directory = "recordings"

[connections.line]
transport = "rtu"
port = "{link}"

[connections.plant]
transport = "tcp"
host = "127.0.0.1"
port = {port}

[connections.station]
transport = "udp"
host = "127.0.0.1"
port = {udp_port}

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

[devices.rtu7]
profile = "mei-timestamped"
connection = "station"
unit = 1
poll = "250ms"
points = [
  {{ kind = "discrete_inputs", stamp = 7, address = 196, count = 22 }},
  {{ kind = "input_registers", stamp = 4, address = 8, count = 2 }},
]
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
            name: stack.enter_context(paths.truth(name).open("w", newline=""))
            for name in (*_DEVICES, STAMPED)
        }
        plant = TcpEndpoint("127.0.0.1", 0)
        station = UdpEndpoint("127.0.0.1", 0)
        link = paths.root.absolute() / "serial-line"
        inputs = SimulatedStampedInputs(seed=7, truth=truths[STAMPED], rate=_CHANGES_PER_SECOND)
        servers = (
            (_simulated(("roc1", "roc2"), truths), PtyEndpoint(str(link)), SPEED),
            (_simulated(("roc3",), truths), plant, SPEED),
            ([inputs], station, 1),
        )
        for devices, endpoint, speed in servers:
            server = SimulatorServer(devices, endpoint, speed=speed, clock=simulated_clock)
            await stack.enter_async_context(server)
        text = _CONFIGURATION.format(
            speed=SPEED, link=link, port=plant.port, udp_port=station.port, **_DEVICES
        )
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


def compare_changes(truth: Path, folder: Path) -> tuple[int, int]:
    """States that the device's inputs had, and how many of them the export has, exact.

    An input is followed from the state in which it was read first: a device keeps the last state
    only, so what was before nobody can know. States are equal when value, octets of the stamp and
    device time are.
    """
    made = _states(_rows(truth))
    found = _states(
        {**row, "table": table}
        for table in ("discrete_inputs", "input_registers")
        for row in _rows(folder / f"{STAMPED}.{table}.csv")
    )
    equal = 0
    for point, states in made.items():
        recorded = found[point]
        if recorded:
            _begin_with(recorded[0], states)
        equal += sum(one == other for one, other in zip(states, recorded, strict=False))
    return sum(map(len, made.values())), equal


def _begin_with(first: _State, states: list[_State]) -> None:
    """Drop the states before the first that was read.

    Its stamp has no date when it is one of 4 octets, since it may be of any age, and so no time.
    """
    value, octets, device_time = first
    for place, state in enumerate(states):
        if state[:2] == (value, octets):
            del states[:place]
            if not device_time and len(bytes.fromhex(octets)) == _DATELESS:
                states[0] = first
            return


def _states(rows: Iterable[Mapping[str, str]]) -> defaultdict[tuple[str, str], list[_State]]:
    """Of each input, by table and address: value, octets of the stamp and device time."""
    found: defaultdict[tuple[str, str], list[_State]] = defaultdict(list)
    for row in rows:
        device_time = parse_instant(row["device_time"]) if row["device_time"] else 0
        state = row["value"], row["time_octets"], device_time
        found[row["table"], row["address"]].append(state)
    return found


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

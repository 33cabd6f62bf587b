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
    SimulatedMpa48,
    SimulatedMsxE3317,
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
    from roclog.simulators import SimulatedDevice
    from roclog.simulators.server import Endpoint

    _State = tuple[str, str, int]

SPEED: Final = 30
"""Simulated seconds in one second: the 15 s cycle of the counters takes half a second."""
_LAST_SECOND: Final = 1.0
"""Simulated time stands still for the end of the demo, so that the last sample is read as well."""
_COUNTERS: Final = {"roc1": 138, "roc2": 139, "roc3": 138}
STAMPED: Final = "rtu7"
"""The device with time-stamped inputs; it runs at real speed, since its clock is compared with the
host's. So does MODULE."""
ANALYSER: Final = "basin"
MODULE: Final = "msx1"
READ_ON_SCHEDULE: Final = (ANALYSER, MODULE)
"""Devices of which every read is a sample."""
_CHANGES_PER_SECOND: Final = 4
_DATELESS: Final = 4
"""Octets of a stamp without a date."""

_CONFIGURATION: Final = """\
# The demo's configuration: two particle counters on one serial line, one behind TCP together with
# an analyser at a basin, a pressure module on TCP and a device with time-stamped inputs on UDP.
# Counters and analyser are simulated at {speed} times real speed, hence their short cycle and poll.

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
port = {station_port}

[connections.lab]
transport = "tcp"
host = "127.0.0.1"
port = {lab_port}

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

[devices.basin]
profile = "mpa-48"
connection = "plant"
unit = 3
poll = "500ms"
sensors = {{ channel_1 = "model-15", channel_2 = "model-10" }}

[devices.msx1]
profile = "msx-e3317"
connection = "lab"
poll = "500ms"
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
            for name in (*_COUNTERS, STAMPED, *READ_ON_SCHEDULE)
        }
        plant, lab = TcpEndpoint("127.0.0.1", 0), TcpEndpoint("127.0.0.1", 0)
        station = UdpEndpoint("127.0.0.1", 0)
        link = paths.root.absolute() / "serial-line"
        inputs = SimulatedStampedInputs(seed=7, truth=truths[STAMPED], rate=_CHANGES_PER_SECOND)
        analyser = SimulatedMpa48(3, seed=3, truth=truths[ANALYSER])
        module = SimulatedMsxE3317(seed=1, truth=truths[MODULE])
        servers: tuple[tuple[list[SimulatedDevice], Endpoint, float], ...] = (
            (_counters(("roc1", "roc2"), truths), PtyEndpoint(str(link)), SPEED),
            ([*_counters(("roc3",), truths), analyser], plant, SPEED),
            ([inputs], station, 1),
            ([module], lab, 1),
        )
        for devices, endpoint, speed in servers:
            server = SimulatorServer(devices, endpoint, speed=speed, clock=simulated_clock)
            await stack.enter_async_context(server)
        ports = {"port": plant.port, "station_port": station.port, "lab_port": lab.port}
        text = _CONFIGURATION.format(speed=SPEED, link=link, **ports, **_COUNTERS)
        paths.configuration.write_text(text)
        await record(load(paths.configuration), SystemClock(), seconds, on_second)


def _counters(names: tuple[str, ...], truths: Mapping[str, TextIO]) -> list[SimulatedDevice]:
    return [SimulatedRoc(_COUNTERS[name], seed=int(name[-1]), truth=truths[name]) for name in names]


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


def compare_reads(truth: Path, folder: Path, device: str) -> tuple[int, int]:
    """Answers that the device gave, and how many of them the export has, in order and exact."""
    made: defaultdict[str, list[dict[str, Decimal | str]]] = defaultdict(list)
    answers: dict[tuple[str, str], dict[str, Decimal | str]] = {}
    for row in _rows(truth):
        key = row["block"], row["answer"]
        if key not in answers:
            answers[key] = {}
            made[row["block"]].append(answers[key])
        answers[key][row["name"]] = _exact(row["value"])
    equal = 0
    for block, told in made.items():
        names = list(told[0])
        rows = _rows(folder / f"{device}.{block}.csv")
        found = [{name: _exact(row[name]) for name in names} for row in rows]
        equal += sum(one == other for one, other in zip(told, found, strict=False))
    return len(answers), equal


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
    """A number as a number, so that 144 and 144.0 are equal and 144.01 is not; truth as 1 or 0."""
    try:
        return Decimal({"true": "1", "false": "0"}.get(text, text))
    except InvalidOperation:
        return text


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))

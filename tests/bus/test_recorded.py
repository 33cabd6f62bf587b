"""A simulated ROC recorded over each transport: every row is what the device made."""

from __future__ import annotations

import asyncio
import io
import signal
import time
from typing import TYPE_CHECKING

import pytest

from roclog.clock import SystemClock
from roclog.config import load
from roclog.demo import compare
from roclog.export import export
from roclog.recording.reader import open_recording
from roclog.runner import record
from roclog.simulators import (
    PtyEndpoint,
    RtuOverTcpEndpoint,
    SimulatedRoc,
    SimulatorServer,
    TcpEndpoint,
    UdpEndpoint,
)

if TYPE_CHECKING:
    from pathlib import Path

SAMPLES = 5
SPEED = 60
NETWORK: dict[str, type[TcpEndpoint | UdpEndpoint | RtuOverTcpEndpoint]]
NETWORK = {"tcp": TcpEndpoint, "udp": UdpEndpoint, "rtu-over-tcp": RtuOverTcpEndpoint}


class Pace:
    """Time of the device: stands still while a sample waits, and when there are enough."""

    def __init__(self, roc: SimulatedRoc, truth: io.StringIO) -> None:
        self._roc = roc
        self._truth = truth
        self._seconds = 0.0
        self._last = time.monotonic()

    @property
    def waits(self) -> bool:
        return self._roc.answer(bytes.fromhex("03 01 2C 00 01")) != bytes.fromhex("03 02 00 00")

    @property
    def samples(self) -> int:
        return max(self._truth.getvalue().count("\n") - 1, 0)

    @property
    def is_over(self) -> bool:
        return self.samples >= SAMPLES and not self.waits

    def __call__(self) -> float:
        now = time.monotonic()
        if not self.waits and self.samples < SAMPLES:
            self._seconds += min(now - self._last, 0.02)
        self._last = now
        return self._seconds


@pytest.mark.parametrize("transport", ["rtu", *NETWORK])
def test_rows_are_what_the_device_made(transport: str, tmp_path: Path) -> None:
    truth = io.StringIO()
    roc = SimulatedRoc(seed=5, truth=truth)
    pace = Pace(roc, truth)
    endpoint: PtyEndpoint | TcpEndpoint | UdpEndpoint | RtuOverTcpEndpoint
    endpoint = (
        NETWORK[transport]("127.0.0.1", 0) if transport in NETWORK else PtyEndpoint(tmp_path / "l")
    )

    async def main() -> None:
        async with (
            asyncio.timeout(20),
            SimulatorServer([roc], endpoint, speed=SPEED, clock=pace),
        ):
            where = 'port = "l"'
            if not isinstance(endpoint, PtyEndpoint):
                where = f'host = "127.0.0.1"\nport = {endpoint.port}'
            config = tmp_path / "roclog.toml"
            config.write_text(
                f'[connections.line]\ntransport = "{transport}"\n{where}\n'
                '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "line"\n'
                'poll = "20ms"\ncycle = "250ms"\n'
            )
            running = asyncio.create_task(record(load(config), SystemClock(), 15))
            while not pace.is_over and not running.done():  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.01)
            if not running.done():
                signal.raise_signal(signal.SIGTERM)  # as a service manager ends it
            await running

    asyncio.run(main())
    made = tmp_path / "truth.csv"
    made.write_text(truth.getvalue())
    export(open_recording(tmp_path / "recordings"), tmp_path / "csv", form="csv")
    rows = tmp_path / "csv" / "roc1.sample.csv"
    assert compare(made, rows) == (SAMPLES, SAMPLES)
    assert len(rows.read_text().splitlines()) == 1 + SAMPLES

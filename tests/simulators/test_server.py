"""Routing and time, without any wire."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

import pytest

from roclog.simulators.server import SimulatorServer

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from roclog.simulators.server import Answer

    Until = Callable[[Callable[[], bool]], Awaitable[None]]


class Device:
    """Answers every request with its own unit id and keeps its time."""

    def __init__(self, unit: int) -> None:
        self.unit = unit
        self.age_s = 0.0
        self.stepped = asyncio.Event()
        self.is_broken = False

    def step(self, seconds: float) -> None:
        if self.is_broken:
            raise OSError("no disk space left for the truth")
        self.age_s += seconds
        self.stepped.set()

    def answer(self, pdu: bytes) -> bytes | None:
        return bytes((pdu[0], self.unit))


class Bench:
    """An endpoint in the process, and a clock that is set by hand."""

    def __init__(self, *, is_gateway: bool = True) -> None:
        self.is_gateway = is_gateway
        self.is_open = False
        self.now_s = 1_000.0
        self.ask: Answer

    async def open(self, answer: Answer) -> None:
        self.is_open = True
        self.ask = answer

    async def close(self) -> None:
        self.is_open = False

    def clock(self) -> float:
        return self.now_s


def test_requests_go_to_the_unit_they_name() -> None:
    async def main() -> None:
        bench = Bench()
        async with SimulatorServer([Device(5), Device(9)], bench):
            assert bench.ask(5, b"\x03") == b"\x03\x05"
            assert bench.ask(9, b"\x03") == b"\x03\x09"

    asyncio.run(main())


def test_absent_unit_is_a_gateway_exception_or_silence() -> None:
    async def main() -> None:
        gateway, line = Bench(), Bench(is_gateway=False)
        async with SimulatorServer([Device(5)], gateway), SimulatorServer([Device(5)], line):
            assert gateway.ask(6, b"\x03\x00\x00\x00\x01") == b"\x83\x0b"
            assert line.ask(6, b"\x03\x00\x00\x00\x01") is None

    asyncio.run(main())


def test_device_that_moved_is_found_at_its_new_unit() -> None:
    async def main() -> None:
        bench, device = Bench(is_gateway=False), Device(5)
        async with SimulatorServer([device], bench):
            device.unit = 6
            assert bench.ask(5, b"\x03") is None
            assert bench.ask(6, b"\x03") == b"\x03\x06"

    asyncio.run(main())


def test_time_is_current_at_each_request_and_runs_at_the_given_speed() -> None:
    async def main() -> None:
        bench, device = Bench(), Device(5)
        async with SimulatorServer([device], bench, speed=30.0, clock=bench.clock):
            bench.now_s += 2.0
            bench.ask(5, b"\x03")
            assert device.age_s == 60.0
            bench.ask(5, b"\x03")
            assert device.age_s == 60.0

    asyncio.run(main())


def test_time_passes_without_requests() -> None:
    async def main() -> None:
        device = Device(5)
        async with SimulatorServer([device], Bench()):
            await asyncio.wait_for(device.stepped.wait(), 5)
        assert device.age_s > 0

    asyncio.run(main())


def test_device_that_fails_while_time_passes_is_reported(
    caplog: pytest.LogCaptureFixture, until: Until
) -> None:
    async def main() -> None:
        device = Device(5)
        device.is_broken = True
        async with SimulatorServer([device], Bench()):
            await until(lambda: bool(caplog.records))

    with caplog.at_level(logging.ERROR):
        asyncio.run(main())
    assert "simulated time stands still" in caplog.text
    assert "no disk space" in caplog.text


def test_stop_closes_the_endpoint_and_may_be_repeated() -> None:
    async def main() -> None:
        bench = Bench()
        server = SimulatorServer([Device(5)], bench)
        await server.stop()
        await server.start()
        assert bench.is_open
        await server.stop()
        await server.stop()
        assert not bench.is_open

    asyncio.run(main())


def test_wrong_arguments() -> None:
    async def main() -> None:
        with pytest.raises(ValueError, match="same unit"):
            SimulatorServer([Device(5), Device(5)], Bench())
        for speed in (0.0, -1.0, float("nan")):
            with pytest.raises(ValueError, match="speed"):
                SimulatorServer([Device(5)], Bench(), speed=speed)

    asyncio.run(main())

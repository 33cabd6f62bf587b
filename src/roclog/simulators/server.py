"""Runs simulated devices in real time and routes requests to them by unit id.

Nothing here knows a framing or a library; that is the endpoint's part.
"""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final, Protocol, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType

    Answer = Callable[[int, bytes], bytes | None]

logger = logging.getLogger(__name__)

TICK_S: Final = 0.02
GATEWAY_TARGET_FAILED_TO_RESPOND: Final = 0x0B


class SimulatedDevice(Protocol):
    """What a device offers to be served."""

    @property
    def unit(self) -> int:
        """The address that the device answers to at present; it may change during its life."""

    def step(self, seconds: float) -> None:
        """Let `seconds` of the device's time pass."""

    def answer(self, pdu: bytes) -> bytes | None:
        """Answer a request; both PDUs start with the function code. None means silence.

        `pdu` has at least the function code and comes unchecked otherwise.
        """


class Endpoint(Protocol):
    """A place where a client can reach the devices.

    `is_gateway` tells what happens to a unit id that no device has: a gateway answers with
    exception 0x0B (Application Protocol V1.1b3, section 7), on a serial line there is silence.
    """

    is_gateway: bool

    async def open(self, answer: Answer) -> None:
        """Begin to pass requests to `answer(unit, pdu)`; OSError when the place is taken."""

    async def close(self) -> None:
        """Stop; harmless when not open."""


class SimulatorServer:
    """Serves devices at one endpoint, between `start` and `stop` or inside `async with`.

    Time passes for the devices before each request and every 20 ms, at `speed` times the rate of
    `clock`. Server, endpoint and devices belong to one event loop; a device belongs to one server.

    Args:
        devices: The devices of this line. Two that get the same unit id during their life are not
            told apart: the first one answers.
        endpoint: A `TcpEndpoint`, `UdpEndpoint`, `RtuOverTcpEndpoint` or `PtyEndpoint`.
        speed: Seconds of the devices' time per second of `clock`.
        clock: Monotonic seconds.

    Raises:
        ValueError: Two devices have the same unit id, or `speed` is not positive.
    """

    def __init__(
        self,
        devices: Iterable[SimulatedDevice],
        endpoint: Endpoint,
        *,
        speed: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._devices = tuple(devices)
        self._endpoint = endpoint
        self._speed = speed
        self._clock = clock
        self._advanced_at_s = 0.0
        self._ticking: asyncio.Task[None] | None = None
        if len({device.unit for device in self._devices}) != len(self._devices):
            raise ValueError("two devices have the same unit id")
        if not speed > 0:
            raise ValueError(f"speed {speed} is not positive")

    async def start(self) -> None:
        """Open the endpoint and let time pass.

        Raises:
            OSError: The endpoint cannot be opened.
        """
        await self._endpoint.open(self._answer)
        self._advanced_at_s = self._clock()
        self._ticking = asyncio.create_task(self._tick(), name="roclog simulator time")

    async def stop(self) -> None:
        """Close the endpoint and stop time; harmless when not started."""
        if self._ticking is not None:
            self._ticking.cancel()
            with suppress(asyncio.CancelledError):
                await self._ticking
            self._ticking = None
        await self._endpoint.close()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.stop()

    async def _tick(self) -> None:
        try:
            while True:
                await asyncio.sleep(TICK_S)
                self._advance()
        except Exception:
            logger.exception("simulated time stands still")

    def _advance(self) -> None:
        now_s = self._clock()
        passed_s = (now_s - self._advanced_at_s) * self._speed
        self._advanced_at_s = now_s
        for device in self._devices:
            device.step(passed_s)

    def _answer(self, unit: int, pdu: bytes) -> bytes | None:
        self._advance()
        for device in self._devices:
            if device.unit == unit:
                return device.answer(pdu)
        if self._endpoint.is_gateway:
            return bytes((pdu[0] | 0x80, GATEWAY_TARGET_FAILED_TO_RESPOND))
        return None

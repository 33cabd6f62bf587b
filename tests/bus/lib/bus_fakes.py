"""A link whose other end is a function, and an event loop in which waiting takes no time."""

from __future__ import annotations

import asyncio
import math
import selectors
from typing import TYPE_CHECKING, Any

from wire import mbap_frame, rtu_frame

from roclog.bus.bus import Bus
from roclog.bus.link import Link
from roclog.bus.timing import Framing, Timing
from roclog.clock import Instant
from roclog.modbus.request import ReadRegisters, WriteRegister

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from roclog.bus.bus import Answer

MS = 1_000_000
START = 1_000 * 10**9
UNIT = 138
SILENCE = 5 * MS
LATE = 1000 * MS
RTU = Timing(framing=Framing.RTU, timeout=500 * MS, late_answer=LATE, silence=SILENCE, character=MS)
TCP = Timing(framing=Framing.MBAP_STREAM, timeout=500 * MS)
READ = ReadRegisters(3, 300, 2)
OTHER = ReadRegisters(3, 400, 2)
CLEAR = WriteRegister(300, 0)
PERMITTED = frozenset({(UNIT, 300, 0)})
SLACK = 1000
"""Nanoseconds by which the event loop rounds a sleep up."""
UTC_OFFSET = 1_800_000_000 * 10**9


class VirtualSelector(selectors.DefaultSelector):
    """Where the loop would sleep, time jumps."""

    loop: VirtualLoop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready
        if timeout is None:
            raise RuntimeError("everything waits for nothing")
        self.loop.nanoseconds += math.ceil(timeout * 1e9)
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    def __init__(self) -> None:
        self.nanoseconds = START
        selector = VirtualSelector()
        selector.loop = self
        super().__init__(selector)

    def time(self) -> float:
        return self.nanoseconds / 1e9


class VirtualClock:
    """The clock of the running VirtualLoop."""

    def now(self) -> Instant:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        return Instant(UTC_OFFSET + loop.nanoseconds, loop.nanoseconds)

    def pause(self, nanoseconds: int) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.nanoseconds += nanoseconds


def run(main: Coroutine[Any, Any, None]) -> None:
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main)


def now() -> int:
    return VirtualClock().now().monotonic


class FakeLink(Link):
    """Notes what is sent, and when. ``on_send`` is called with every frame.

    failures: what the next attempts to open or to send raise, in order.
    """

    name = "fake"

    def __init__(self, on_send: Callable[[bytes], None] | None = None) -> None:
        self.on_send = on_send
        self.opened: list[int] = []
        self.sent: list[tuple[int, bytes]] = []
        self.open_failures: list[OSError] = []
        self.send_failures: list[OSError] = []
        self.is_open = False
        self._receive: Callable[[bytes], None] | None = None
        self._lost: Callable[[str], None] | None = None

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        assert not self.is_open
        self.opened.append(now())
        await asyncio.sleep(0)
        if self.open_failures:
            raise self.open_failures.pop(0)
        self._receive, self._lost = receive, lost
        self.is_open = True

    def send(self, octets: bytes) -> None:
        assert self.is_open
        if self.send_failures:
            raise self.send_failures.pop(0)
        self.sent.append((now(), octets))
        if self.on_send is not None:
            self.on_send(octets)

    def close(self) -> None:
        self.is_open = False

    def say(self, octets: bytes, after: int = 0) -> None:
        """The other end sends octets, ``after`` nanoseconds from now."""
        asyncio.get_running_loop().call_later(after / 1e9, self._say, octets)

    def say_one_by_one(self, octets: bytes, character: int, after: int = 0) -> None:
        for index, octet in enumerate(octets, start=1):
            self.say(bytes([octet]), after + index * character)

    def break_off(self, reason: str = "unplugged") -> None:
        self.is_open = False
        assert self._lost is not None
        self._lost(reason)

    def _say(self, octets: bytes) -> None:
        if self.is_open and self._receive is not None:
            self._receive(octets)


def registers(request: bytes) -> bytes:
    """The answer's PDU to a read: every register holds its own address."""
    first, count = int.from_bytes(request[1:3]), int.from_bytes(request[3:5])
    data = b"".join((first + index & 0xFFFF).to_bytes(2) for index in range(count))
    return bytes([request[0], len(data)]) + data


def answer_to(adu: bytes) -> bytes:
    """The whole RTU answer to a read or a write."""
    return rtu_frame(adu[0], registers(adu[1:-2]) if adu[1] < 5 else adu[1:-2])


def make(timing: Timing = RTU) -> tuple[FakeLink, Bus]:
    link = FakeLink()
    return link, Bus(link, timing, VirtualClock(), PERMITTED)


def device(link: FakeLink, delay: int = 10 * MS) -> None:
    """The other end answers every RTU frame, its first octet coming ``delay`` after its last."""
    link.on_send = lambda adu: link.say(answer_to(adu), len(adu) * MS + delay)


async def outcome(transaction: Coroutine[object, object, Answer]) -> Answer | Exception:
    try:
        return await transaction
    except Exception as error:  # noqa: BLE001 - the error is the outcome
        return error


def tcp_answer(adu: bytes) -> bytes:
    return mbap_frame(int.from_bytes(adu[:2]), adu[6], registers(adu[7:]))

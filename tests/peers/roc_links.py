"""How requests and answers travel: the faults of a link, a TCP connection, a serial line."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import socket
import struct
import time
import tty
from collections import deque
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, cast

from roc_options import PTY_AWAY, Options, rng
from wire import IDLE_GAP, MbapFramer, Request, RtuFramer, StreamError, mbap_frame, rtu_frame

if TYPE_CHECKING:
    from collections.abc import Callable

    from roc_model import Model, Reply
    from roc_truth import Truth

_MBAP_CHECKED = 9
"""Octets of an MBAP answer that a client can check: nothing guards the data behind them."""


class Faults:
    def __init__(self, options: Options) -> None:
        shares = {
            "late": options.late,
            "corrupt": options.corrupt,
            "dropped": options.drop,
            "garbage": options.garbage,
        }
        self._fates = [*shares, "ok"]
        self._weights = [*shares.values(), max(0.0, 1 - sum(shares.values()))]
        self._random = rng(options.seed, "faults")

    def draw(self) -> str:
        return self._random.choices(self._fates, self._weights)[0]

    def flip(self, frame: bytes, octets: int) -> bytes:
        """One bit among the first `octets` of the frame."""
        spoiled = bytearray(frame)
        bit = self._random.randrange(8 * octets)
        spoiled[bit // 8] ^= 1 << bit % 8
        return bytes(spoiled)

    def noise(self) -> bytes:
        return self._random.randbytes(self._random.randint(1, 8))


@dataclass
class Shared:
    """`mute`: nothing is answered. `off`: TCP connections are reset, too."""

    options: Options
    truth: Truth
    model: Model
    faults: Faults
    mute: bool = False
    off: bool = False
    numbers: count[int] = field(default_factory=lambda: count(1))


@dataclass(frozen=True)
class Arrival:
    request: Request
    end: float
    origin: dict[str, object]


class Exchange:
    """Requests of one link in, answers out, in order; at most one answer is late at a time."""

    def __init__(
        self, shared: Shared, send: Callable[[bytes], None], wrap: Callable[[Request, bytes], bytes]
    ) -> None:
        self._shared = shared
        self._send = send
        self._wrap = wrap
        self._link = next(shared.numbers)
        self._loop = asyncio.get_running_loop()
        self._queue: deque[Arrival] = deque()
        self._late: asyncio.TimerHandle | None = None
        self._late_reply: Reply | None = None

    def arrive(self, request: Request, idle_ms: float | None = None) -> None:
        """`idle_ms`: silence on a serial line before the request's octets."""
        shared = self._shared
        origin: dict[str, object] = {"link": self._link, "request_mono_ns": time.monotonic_ns()}
        if idle_ms is not None:
            origin["idle_ms"] = round(idle_ms, 3)
        if request.unit != shared.model.unit:
            shared.truth.log("ignored", why="unit", unit=request.unit, **origin)
            return
        arrival = Arrival(request, self._loop.time(), origin)
        if shared.mute or self._late is None:
            self._serve(arrival)
        elif shared.options.busy == "queue":
            self._queue.append(arrival)
        else:
            shared.truth.log("ignored", why="deaf", request=request.pdu.hex(), **origin)

    def close(self) -> None:
        """What is still to be answered never will be."""
        self._queue.clear()
        if self._late is not None and self._late_reply is not None:
            self._late.cancel()
            self._shared.model.settled(self._late_reply, "dropped", why="link lost")
        self._late = self._late_reply = None

    def _serve(self, arrival: Arrival) -> None:
        shared = self._shared
        if shared.mute:
            shared.truth.log("ignored", why="silence", **arrival.origin)
            return
        fate = shared.faults.draw()
        reply = shared.model.execute(arrival.request.pdu, fate, arrival.origin)
        if reply.pdu is None:
            return
        request = arrival.request
        if fate == "other_unit":
            request = replace(request, unit=request.unit % 247 + 1)
        frame = self._wrap(request, reply.pdu)
        if fate == "late":
            due = max(self._loop.time(), arrival.end + shared.options.late_by)
            self._late_reply = reply
            self._late = self._loop.call_at(due, self._send_late, frame, reply)
            return
        if fate == "corrupt":
            span = len(frame) if shared.options.pty else _MBAP_CHECKED
            frame = shared.faults.flip(frame, span)
        elif fate == "garbage":
            frame = shared.faults.noise() + frame
        shared.model.settled(reply, fate)  # before any client can act upon the answer
        if fate != "dropped":
            self._send(frame)

    def _send_late(self, frame: bytes, reply: Reply) -> None:
        self._late = self._late_reply = None
        fate = "dropped" if self._shared.mute else "late"
        self._shared.model.settled(reply, fate)
        if fate == "late":
            self._send(frame)
        while self._queue and self._late is None:
            self._serve(self._queue.popleft())


class TcpLink(asyncio.Protocol):
    def __init__(self, shared: Shared, links: set[TcpLink]) -> None:
        self._shared = shared
        self._links = links
        self._framer = MbapFramer()
        self._transport: asyncio.Transport | None = None
        self._exchange: Exchange | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._exchange = Exchange(self._shared, self._transport.write, self._wrap)
        self._links.add(self)
        if self._shared.off:
            self.reset()

    def data_received(self, data: bytes) -> None:
        try:
            requests = self._framer.feed(data)
        except StreamError as error:
            self._shared.truth.log("noise", octets=str(error))
            self.reset()
            return
        for request in requests:
            if self._exchange is not None:
                self._exchange.arrive(request)

    def connection_lost(self, exc: Exception | None) -> None:
        self._links.discard(self)
        if self._exchange is not None:
            self._exchange.close()
            self._exchange = None

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def reset(self) -> None:
        """RST, not FIN: nothing in flight arrives."""
        if self._transport is None:
            return
        sock = self._transport.get_extra_info("socket")
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._transport.abort()

    @staticmethod
    def _wrap(request: Request, pdu: bytes) -> bytes:
        return mbap_frame(request.transaction, request.unit, pdu)


class TcpSide:
    def __init__(self, shared: Shared, where: str) -> None:
        self._shared = shared
        self._host, _, self._port = where.rpartition(":")
        self._links: set[TcpLink] = set()
        self._server: asyncio.Server | None = None

    async def open(self) -> str:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(
            lambda: TcpLink(self._shared, self._links), self._host, int(self._port)
        )
        return str(self._server.sockets[0].getsockname()[1])

    def drop(self) -> None:
        for link in list(self._links):
            link.reset()

    def power_fails(self) -> None:
        self.drop()

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
        for link in list(self._links):
            link.close()


class PtySide:
    """A serial line. The slave stays open here, so a client may come and go."""

    def __init__(self, shared: Shared, link: str) -> None:
        self._shared = shared
        self._path = Path(link)
        self._loop = asyncio.get_running_loop()
        self._ends: tuple[int, int] | None = None
        self._framer = RtuFramer()
        self._exchange: Exchange | None = None
        self._gap: asyncio.TimerHandle | None = None
        self._back: asyncio.TimerHandle | None = None
        self._last_octet = self._loop.time()
        self._idle_ms = 0.0

    async def open(self) -> str:
        self._attach()
        return str(self._path)

    def drop(self) -> None:
        self._detach()
        self._back = self._loop.call_later(PTY_AWAY, self._attach)

    def power_fails(self) -> None:
        if self._exchange is not None:
            self._exchange.close()

    def close(self) -> None:
        if self._back is not None:
            self._back.cancel()
        self._detach()

    def _attach(self) -> None:
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._ends = (master, slave)
        self._framer = RtuFramer()
        self._exchange = Exchange(self._shared, self._send, self._wrap)
        self._loop.add_reader(master, self._readable, master)
        new = self._path.with_name(self._path.name + ".new")
        new.unlink(missing_ok=True)
        new.symlink_to(os.ttyname(slave))
        new.replace(self._path)

    def _detach(self) -> None:
        if self._ends is None:
            return
        self._path.unlink(missing_ok=True)
        if self._gap is not None:
            self._gap.cancel()
        if self._exchange is not None:
            self._exchange.close()
        self._loop.remove_reader(self._ends[0])
        for end in self._ends:
            os.close(end)
        self._ends = None

    def _readable(self, master: int) -> None:
        now = self._loop.time()
        try:
            octets = os.read(master, 4096)
        except BlockingIOError:
            return
        if not self._framer:
            self._idle_ms = 1000 * (now - self._last_octet)
        self._last_octet = now
        if self._gap is not None:
            self._gap.cancel()
        self._arrived(self._framer.feed(octets))
        if self._framer:
            self._gap = self._loop.call_later(IDLE_GAP, self._idle)

    def _idle(self) -> None:
        requests, lost = self._framer.idle()
        if lost:
            self._shared.truth.log("noise", octets=lost.hex(" "))
        self._arrived(requests)

    def _arrived(self, requests: list[Request]) -> None:
        for request in requests:
            if self._exchange is not None:
                self._exchange.arrive(request, self._idle_ms)

    def _send(self, frame: bytes) -> None:
        """With nobody reading the buffer fills up and octets are lost, as on a real line."""
        if self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], frame)
        self._last_octet = self._loop.time()

    @staticmethod
    def _wrap(request: Request, pdu: bytes) -> bytes:
        return rtu_frame(request.unit, pdu)

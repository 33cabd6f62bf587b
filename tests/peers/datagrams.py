"""A network between a client and a device that loses datagrams, doubles some, holds some back.

    python tests/peers/datagrams.py --udp 127.0.0.1:0 --to 127.0.0.1:5020 --lose 0.2 --late 0.1
    python tests/peers/datagrams.py --udp 127.0.0.1:0 --to 127.0.0.1:5020 --over tcp --twice 0.1

`listening PORT` on stdout: it carries. Each direction has its own draws from the seed. What a
datagram says is not understood, except where the device is reached over TCP: then its answers are
cut by the length in their headers (big endian). Standard library only.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
from dataclasses import asdict, dataclass, field
from itertools import count
from typing import TYPE_CHECKING, cast

from peer_options import option, parse
from roc_options import rng
from roc_truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable

    Send = Callable[[bytes], None]
    Address = tuple[str, int]

_MOST = 65536
_HEADER = 6
"""Octets of an MBAP header up to its length, which counts what follows."""


@dataclass(frozen=True, kw_only=True)
class Options:
    udp: str = option("127.0.0.1:0", "HOST:PORT to listen on, port 0 for any")
    to: str = option("", "HOST:PORT of the device")
    over: str = option("udp", "how the device is reached", choices=("udp", "tcp"))
    lose: float = option(0.0, "share of datagrams lost, in each direction", float)
    twice: float = option(0.0, "share sent twice, the copy at once or behind later ones", float)
    late: float = option(0.0, "share sent behind later ones of their direction", float)
    behind: int = option(3, "later ones that may go before, at most", int)
    held_for: float = option(0.5, "seconds after which a datagram waits no longer", float)
    calm: int = option(0, "datagrams of each direction that pass before it begins", int)
    seed: int = option(1, "of everything that is drawn", int)
    truth: str | None = option(None, "JSONL file of what became of each datagram")

    def __post_init__(self) -> None:
        if not self.to:
            raise ValueError("--to is needed")
        if min(self.lose, self.twice, self.late) < 0 or self.lose + self.twice + self.late > 1:
            raise ValueError("lose, twice, late: shares, together at most 1")
        if self.behind < 1:
            raise ValueError("behind: at least 1")


@dataclass(eq=False)
class Held:
    """`passed`: later datagrams that have gone before; with `behind` of them it goes itself."""

    n: int
    octets: bytes
    send: Send
    behind: int
    timer: asyncio.TimerHandle = field(init=False)
    passed: int = 0


class Way:
    """Datagrams of one direction. `came`: one line for each; `sent`: one for each that went on."""

    def __init__(self, name: str, options: Options, truth: Truth) -> None:
        self._name = name
        self._options = options
        self._truth = truth
        self._random = rng(options.seed, name)
        self._numbers = count(1)
        self._held: list[Held] = []
        self._fates = {"lost": options.lose, "twice": options.twice, "late": options.late}
        self._weights = [*self._fates.values(), max(0.0, 1 - sum(self._fates.values()))]

    def take(self, octets: bytes, send: Send) -> None:
        n, most = next(self._numbers), self._options.behind
        fate = self._random.choices([*self._fates, "ok"], self._weights)[0]
        behind = self._random.randint(0 if fate == "twice" else 1, most)
        if n <= self._options.calm:
            fate = "ok"
        self._truth.log("came", way=self._name, n=n, fate=fate, octets=octets.hex())
        held = list(self._held)
        if fate in ("ok", "twice"):
            self._send(n, octets, send, 0)
            for other in held:
                self._count(other)
        if fate == "twice" and not behind:
            self._send(n, octets, send, 0)
        elif fate in ("twice", "late"):
            self._hold(Held(n, octets, send, behind))

    def close(self) -> None:
        for held in self._held:
            held.timer.cancel()
            self._truth.log("kept", way=self._name, n=held.n)
        self._held.clear()

    def _hold(self, held: Held) -> None:
        loop = asyncio.get_running_loop()
        held.timer = loop.call_later(self._options.held_for, self._release, held)
        self._held.append(held)

    def _count(self, held: Held) -> None:
        held.passed += 1
        if held.passed == held.behind:
            self._release(held)

    def _release(self, held: Held) -> None:
        held.timer.cancel()
        self._held.remove(held)
        self._send(held.n, held.octets, held.send, held.passed)

    def _send(self, n: int, octets: bytes, send: Send, passed: int) -> None:
        """The line is there before anybody can act upon the octets."""
        self._truth.log("sent", way=self._name, n=n, behind=passed)
        send(octets)


class Far:
    """The device, as one client reaches it; opened anew when the device has closed it."""

    def __init__(self, options: Options, answered: Send) -> None:
        host, _, port = options.to.rpartition(":")
        self._place = host, int(port)
        self._kind = socket.SOCK_STREAM if options.over == "tcp" else socket.SOCK_DGRAM
        self._answered = answered
        self._buffer = b""
        self._socket: socket.socket | None = None

    def send(self, octets: bytes) -> None:
        """A device that is away hears nothing, and nothing says so."""
        with contextlib.suppress(OSError):
            if self._socket is None:
                self._open()
            if self._socket is not None:
                self._socket.sendall(octets)

    def close(self) -> None:
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
        self._socket, self._buffer = None, b""

    def _open(self) -> None:
        opened = socket.socket(socket.AF_INET, self._kind)
        try:
            opened.connect(self._place)
            if self._kind == socket.SOCK_STREAM:
                opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            opened.setblocking(False)
        except OSError:
            opened.close()
            raise
        asyncio.get_running_loop().add_reader(opened, self._readable, opened)
        self._socket = opened

    def _readable(self, source: socket.socket) -> None:
        try:
            octets = source.recv(_MOST)
        except BlockingIOError:
            return
        except OSError:  # nobody listens there
            octets = b""
        if self._kind == socket.SOCK_DGRAM:
            if octets:
                self._answered(octets)
        elif octets:
            self._cut(octets)
        else:
            self.close()

    def _cut(self, octets: bytes) -> None:
        self._buffer += octets
        while len(self._buffer) >= _HEADER:
            end = _HEADER + int.from_bytes(self._buffer[4:_HEADER], "big")
            if len(self._buffer) < end:
                return
            answer, self._buffer = self._buffer[:end], self._buffer[end:]
            self._answered(answer)


class Near(asyncio.DatagramProtocol):
    """The socket that clients send to; each of them has a way of its own to the device."""

    def __init__(self, options: Options, truth: Truth) -> None:
        self._options = options
        self._there = Way("request", options, truth)
        self._back = Way("answer", options, truth)
        self._transport: asyncio.DatagramTransport | None = None
        self._devices: dict[Address, Far] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if addr not in self._devices:
            self._devices[addr] = Far(self._options, lambda octets: self._answered(octets, addr))
        self._there.take(data, self._devices[addr].send)

    def close(self) -> None:
        for way in (self._there, self._back):
            way.close()
        for device in self._devices.values():
            device.close()
        if self._transport is not None:
            self._transport.abort()

    def _answered(self, octets: bytes, client: Address) -> None:
        self._back.take(octets, lambda answer: self._send(answer, client))

    def _send(self, octets: bytes, client: Address) -> None:
        if self._transport is not None:
            self._transport.sendto(octets, client)


async def _run(options: Options) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    truth = Truth(options.truth)
    host, _, port = options.udp.rpartition(":")
    transport, near = await loop.create_datagram_endpoint(
        lambda: Near(options, truth), local_addr=(host, int(port))
    )
    truth.log("start", options=asdict(options))
    print(f"listening {transport.get_extra_info('sockname')[1]}", flush=True)
    await ended.wait()
    near.close()
    truth.log("end")
    truth.close()


if __name__ == "__main__":
    asyncio.run(_run(parse(Options, __doc__.partition("\n")[0])))

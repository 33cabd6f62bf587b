"""Scripted far ends of every transport, octets of their own: a line, a server, a gateway."""

from __future__ import annotations

import asyncio
import os
import tty
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, cast

from wire import mbap_frame, rtu_frame

from roclog.bus.bus import Bus
from roclog.bus.serial_port import SerialLink
from roclog.bus.tcp import TcpLink
from roclog.bus.timing import Framing, Timing
from roclog.bus.udp import UdpLink
from roclog.clock import SystemClock

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from roclog.bus.link import Link

    Script = Callable[["Asked"], list[tuple[float, bytes]]]

MS = 1_000_000
UNIT = 138
PERMITTED = frozenset({(UNIT, 300, 0)})


@dataclass(frozen=True)
class Asked:
    """One request. wrap: the frame with a unit and a PDU that answers it. index: from 0 on."""

    unit: int
    pdu: bytes
    wrap: Callable[[int, bytes], bytes]
    index: int

    @property
    def address(self) -> int:
        return int.from_bytes(self.pdu[1:3])

    @property
    def count(self) -> int:
        return int.from_bytes(self.pdu[3:5])


def registers(asked: Asked) -> bytes:
    """The good answer's PDU: every register holds its own address; a write is repeated."""
    if asked.pdu[0] == 6:
        return asked.pdu
    data = b"".join((asked.address + k & 0xFFFF).to_bytes(2) for k in range(asked.count))
    return bytes([asked.pdu[0], len(data)]) + data


def good(asked: Asked) -> list[tuple[float, bytes]]:
    return [(0, asked.wrap(asked.unit, registers(asked)))]


class Peer(ABC):
    """What is at the other end of a link.

    script: from a request to the pieces to send, each so many seconds later.
    overlaps: requests that came before the one before was answered.
    """

    framing: ClassVar[Framing]

    def __init__(self) -> None:
        self.script: Script = good
        self.asked: list[Asked] = []
        self.overlaps = 0
        self._is_pending = False
        self._stream = bytearray()

    @abstractmethod
    async def start(self) -> None: ...

    @abstractmethod
    def stop(self) -> None: ...

    @abstractmethod
    def link(self) -> Link: ...

    @property
    def numbered(self) -> bool:
        return self.framing is not Framing.RTU

    def bus(self, timeout: int = 2000 * MS, late_answer: int = 0) -> Bus:
        late, silence = (0, 0) if self.numbered else (late_answer or 2 * timeout, 5 * MS)
        timing = Timing(framing=self.framing, timeout=timeout, late_answer=late, silence=silence)
        return Bus(self.link(), timing, SystemClock(), PERMITTED)

    def hear(self, octets: bytes, send: Callable[[bytes], None]) -> None:
        """Cut a stream into requests: reads and single writes only, so all have one length."""
        self._stream += octets
        size = 12 if self.numbered else 8
        while len(self._stream) >= size:
            adu = bytes(self._stream[:size])
            del self._stream[:size]
            self._take(adu, send)

    def _take(self, adu: bytes, send: Callable[[bytes], None]) -> None:
        if self.numbered:
            number = int.from_bytes(adu[:2])
            assert adu == mbap_frame(number, adu[6], adu[7:])
            asked = Asked(
                adu[6], adu[7:], lambda u, pdu: mbap_frame(number, u, pdu), len(self.asked)
            )
        else:
            assert adu == rtu_frame(adu[0], adu[1:-2])
            asked = Asked(adu[0], adu[1:-2], rtu_frame, len(self.asked))
        self.overlaps += self._is_pending
        pieces = self.script(asked)
        self._is_pending = bool(pieces)
        self.asked.append(asked)

        def say(octets: bytes) -> None:
            self._is_pending = False
            send(octets)

        for delay, octets in pieces:
            asyncio.get_running_loop().call_later(delay, say, octets)


class LinePeer(Peer):
    """A device on a pseudo-terminal."""

    framing = Framing.RTU

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._master = self._terminal = -1

    async def start(self) -> None:
        self._master, self._terminal = os.openpty()
        tty.setraw(self._terminal)
        os.set_blocking(self._master, False)
        self._path.symlink_to(os.ttyname(self._terminal))
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def stop(self) -> None:
        if self._master >= 0:
            asyncio.get_running_loop().remove_reader(self._master)
            os.close(self._master)
            os.close(self._terminal)
            self._path.unlink()
            self._master = -1

    def link(self) -> Link:
        return SerialLink(str(self._path), 9600, 8, "N", 1)

    def _readable(self) -> None:
        self.hear(os.read(self._master, 4096), self._send)

    def _send(self, octets: bytes) -> None:
        if self._master >= 0:
            os.write(self._master, octets)


class NetworkPeer(Peer):
    """On a port of the loopback that stays the same when the peer comes back."""

    port = 0

    def link(self) -> Link:
        return (UdpLink if isinstance(self, UdpPeer) else TcpLink)("127.0.0.1", self.port)


class TcpPeer(NetworkPeer):
    framing = Framing.MBAP_STREAM

    def __init__(self) -> None:
        super().__init__()
        self._server: asyncio.Server | None = None
        self.connections: set[asyncio.Transport] = set()

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Served(self), "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    def stop(self) -> None:
        if self._server is not None:
            self._server.close()
            for connection in self.connections:
                connection.abort()
            self._server = None


class GatewayPeer(TcpPeer):
    """Passes RTU frames through."""

    framing = Framing.RTU


class _Served(asyncio.Protocol):
    def __init__(self, peer: TcpPeer) -> None:
        self._peer = peer
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._peer.connections.add(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        assert self._transport is not None
        self._peer.connections.discard(self._transport)

    def data_received(self, data: bytes) -> None:
        self._peer.hear(data, self._send)

    def _send(self, octets: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(octets)


class UdpPeer(NetworkPeer, asyncio.DatagramProtocol):
    framing = Framing.MBAP_DATAGRAM

    def __init__(self) -> None:
        super().__init__()
        self._socket: asyncio.DatagramTransport | None = None
        self.client: tuple[str, int] | None = None

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        place = "127.0.0.1", self.port
        self._socket, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=place)
        self.port = self._socket.get_extra_info("sockname")[1]

    def stop(self) -> None:
        if self._socket is not None:
            self._socket.abort()
            self._socket = None

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.client = addr

        def send(octets: bytes) -> None:
            if self._socket is not None:
                self._socket.sendto(octets, addr)

        self.hear(data, send)

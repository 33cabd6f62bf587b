"""The TCP link and the bus over loopback."""

from __future__ import annotations

import asyncio
import shutil
import socket
import struct
import subprocess
import sys
import time
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from wire import mbap_frame

from roclog.bus import tcp
from roclog.bus.bus import Answer, Bus
from roclog.bus.tally import Tally
from roclog.bus.tcp import TcpLink
from roclog.bus.timing import Framing, Timing
from roclog.clock import SystemClock
from roclog.errors import LinkDown, NoAnswer
from roclog.modbus.request import ReadRegisters, words

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable

    Behaviour = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]

MS = 1_000_000
READ = ReadRegisters(3, 300, 2)
PDU = bytes.fromhex("03 04 01 2C 01 2D")


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def ignore(_: object) -> None:
    pass


@asynccontextmanager
async def serving(behaviour: Behaviour) -> AsyncIterator[Bus]:
    """A server that treats every connection so, and a bus that will connect to it."""

    async def treat(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError, asyncio.IncompleteReadError):
            await behaviour(reader, writer)
        writer.close()

    server = await asyncio.start_server(treat, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    timing = Timing(framing=Framing.MBAP_STREAM, timeout=2000 * MS)
    bus = Bus(TcpLink("127.0.0.1", port), timing, SystemClock(), frozenset())
    try:
        yield bus
    finally:
        bus.close()
        server.close()
        await asyncio.sleep(0.01)


async def answers(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while True:
        adu = await reader.readexactly(12)
        writer.write(mbap_frame(int.from_bytes(adu[:2]), adu[6], PDU))


async def resets(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.readexactly(12)
    connection: socket.socket = writer.get_extra_info("socket")
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


async def hangs_up(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
    await reader.readexactly(12)


def test_octets_one_by_one() -> None:
    async def drips(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        adu = await reader.readexactly(12)
        for octet in mbap_frame(int.from_bytes(adu[:2]), adu[6], PDU):
            writer.write(bytes([octet]))
            await asyncio.sleep(0.001)

    async def main() -> None:
        async with serving(drips) as bus:
            assert words((await bus.transact(1, READ, Tally())).pdu) == (300, 301)

    asyncio.run(main())


@pytest.mark.parametrize("behaviour", [resets, hangs_up])
def test_a_connection_that_ends_fails_the_pending_request_at_once(behaviour: Behaviour) -> None:
    async def main() -> None:
        async with serving(behaviour) as bus:
            begun = time.monotonic()
            with pytest.raises(LinkDown, match=r"reset by peer|peer closed"):
                await bus.transact(1, READ, Tally())
            assert time.monotonic() - begun < 0.5  # it takes no time; a busy machine does

    asyncio.run(main())


def test_a_server_that_closes_idle_connections_is_called_again() -> None:
    async def once(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        adu = await reader.readexactly(12)
        writer.write(mbap_frame(int.from_bytes(adu[:2]), adu[6], PDU))

    async def main() -> None:
        tally = Tally()
        async with serving(once) as bus:
            for _ in range(3):
                assert isinstance(await bus.transact(1, READ, tally), Answer)
                await asyncio.sleep(0.02)
        assert (tally.answers, tally.link_losses) == (3, 2)

    asyncio.run(main())


def test_nobody_listens() -> None:
    async def main() -> None:
        async with serving(answers) as bus:
            pass
        with pytest.raises(LinkDown, match="cannot be opened"):
            await bus.transact(1, READ, Tally())

    asyncio.run(main())


@pytest.mark.parametrize("host", ["a" * 64 + ".invalid", "no-such-host.invalid"])
def test_a_name_that_leads_nowhere(host: str) -> None:
    async def main() -> None:
        with pytest.raises(OSError):
            await TcpLink(host, 502).open(ignore, ignore)

    asyncio.run(main())


def test_a_host_that_does_not_say_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp, "_CONNECT_SECONDS", 0.05)

    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0), backlog=0) as full, socket.socket() as first:
            first.connect(full.getsockname())  # takes the only place in the queue
            link = TcpLink(*full.getsockname())
            with pytest.raises(OSError, match="no connection within"):
                await link.open(ignore, ignore)

    asyncio.run(main())


def test_closing_is_not_losing() -> None:
    async def main() -> None:
        lost: list[str] = []
        async with serving(answers) as bus:
            link = bus.link
            for _ in range(3):
                await link.open(ignore, lost.append)
                link.close()
                link.close()
                await asyncio.sleep(0.005)
                with pytest.raises(OSError, match="closed"):
                    link.send(b"1")
        assert lost == []

    asyncio.run(main())


def test_a_vanished_peer_is_watched_for() -> None:
    async def main() -> None:
        async with serving(answers) as bus:
            await bus.transact(1, READ, Tally())
            assert isinstance(bus.link, TcpLink)
            assert bus.link._stream is not None
            assert bus.link._stream._transport is not None
            connection: socket.socket = bus.link._stream._transport.get_extra_info("socket")
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 5000
            assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1

    asyncio.run(main())


@pytest.mark.root
def test_a_half_open_connection_ends_after_the_user_timeout() -> None:
    unshare = shutil.which("unshare")
    if unshare is None or subprocess.run([unshare, "-Urn", "true"], check=False).returncode:
        pytest.skip("no network namespaces here: a half-open connection cannot be made")
    script = Path(__file__).with_name("half_open_peer.py")
    command = [unshare, "-Urn", sys.executable, str(script), "400"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=20)
    seconds = float(done.stdout.split()[0])
    assert 0.3 < seconds < 3, done.stdout


def test_no_descriptor_is_left_behind() -> None:
    async def main() -> None:
        async with serving(resets) as bus:
            await asyncio.sleep(0.01)
            before = descriptors()
            link = bus.link
            for _ in range(200):
                gone = asyncio.Event()
                await link.open(ignore, lambda _, gone=gone: gone.set())  # type: ignore[misc]
                link.send(bytes(12))
                await gone.wait()
            for _ in range(50):
                await link.open(ignore, ignore)
            link.close()
            await asyncio.sleep(0.05)
            assert descriptors() <= before

    asyncio.run(main())


def test_a_peer_that_never_answers() -> None:
    async def listens(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        await reader.read()

    async def main() -> None:
        async with serving(listens) as bus:
            bus.timing = replace(bus.timing, timeout=20 * MS)
            tally = Tally()
            for _ in range(3):
                with pytest.raises(NoAnswer):
                    await bus.transact(1, READ, tally)
            assert (tally.timeouts, tally.link_losses) == (3, 0)

    asyncio.run(main())

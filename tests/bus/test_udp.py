"""What only datagrams do: they come whole, twice, in another order, from strangers, or not."""

from __future__ import annotations

import asyncio
import random
import socket
import time
from typing import TYPE_CHECKING

import pytest
from bus_fakes import outcome
from raw_peers import MS, UNIT, Asked, UdpPeer, good, registers

from roclog.bus import udp
from roclog.bus.bus import Answer, Bus
from roclog.bus.tally import Tally
from roclog.bus.udp import UdpLink
from roclog.errors import LinkDown, NoAnswer, WrongAnswer
from roclog.modbus.request import ReadRegisters, words

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

READ = ReadRegisters(3, 300, 2)


def ignore(_: object) -> None:
    pass


def play(behaviour: Callable[[UdpPeer], Awaitable[None]]) -> None:
    async def main() -> None:
        peer = UdpPeer()
        await peer.start()
        try:
            async with asyncio.timeout(20):
                await behaviour(peer)
        finally:
            peer.stop()

    asyncio.run(main())


def frame(asked: Asked) -> bytes:
    return asked.wrap(asked.unit, registers(asked))


@pytest.mark.parametrize("unit", [0, 255])
def test_every_unit_can_be_asked(unit: int) -> None:
    async def behaviour(peer: UdpPeer) -> None:
        bus = peer.bus()
        assert words((await bus.transact(unit, READ, Tally())).pdu) == (300, 301)
        assert peer.asked[0].unit == unit
        bus.close()

    play(behaviour)


PIECES: dict[str, Callable[[bytes], list[bytes]]] = {
    "in two": lambda whole: [whole[:9], whole[9:]],
    "short": lambda whole: [whole[:-1]],
    "long": lambda whole: [whole + b"\0"],
    "two in one": lambda whole: [whole + whole],
    "header only": lambda whole: [whole[:7]],
    "one octet": lambda whole: [whole[:1]],
    "another protocol": lambda whole: [whole[:2] + b"\0\1" + whole[4:]],
}


@pytest.mark.parametrize("how", PIECES)
def test_a_datagram_that_is_not_one_answer_is_wrong_and_no_part_of_the_next(how: str) -> None:
    async def behaviour(peer: UdpPeer) -> None:
        bus, tally = peer.bus(), Tally()
        peer.script = lambda asked: [(0, piece) for piece in PIECES[how](frame(asked))]
        with pytest.raises(WrongAnswer, match="not one answer"):
            await bus.transact(UNIT, READ, tally)
        peer.script = good
        for _ in range(3):
            assert words((await bus.transact(UNIT, READ, tally)).pdu) == (300, 301)
        assert (tally.wrong_answers, tally.answers, tally.link_losses) == (1, 3, 0)
        bus.close()

    play(behaviour)


def test_what_is_left_of_an_earlier_answer_ends_nothing() -> None:
    """A late datagram with another number is dropped, broken or not."""

    def script(asked: Asked) -> list[tuple[float, bytes]]:
        old = (int.from_bytes(frame(asked)[:2]) + 7).to_bytes(2) + frame(asked)[2:]
        return [(0, old), (0, old[:-3]), (0, frame(asked))]

    async def behaviour(peer: UdpPeer) -> None:
        peer.script = script
        bus, tally = peer.bus(), Tally()
        assert words((await bus.transact(UNIT, READ, tally)).pdu) == (300, 301)
        assert (tally.late_answers, tally.wrong_answers) == (2, 0)
        bus.close()

    play(behaviour)


def test_datagrams_that_nobody_waits_for_are_counted() -> None:
    async def behaviour(peer: UdpPeer) -> None:
        peer.script = lambda asked: [(0, frame(asked)), (0, frame(asked)), (0, b"hello")]
        bus, tally = peer.bus(), Tally()
        await bus.transact(UNIT, READ, tally)
        while not bus._stray:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
        peer.script = good
        await bus.transact(UNIT, READ, tally)
        assert (tally.answers, tally.late_answers, tally.discarded_octets) == (2, 1, 5)
        bus.close()

    play(behaviour)


def test_answers_of_strangers_are_not_heard() -> None:
    async def behaviour(peer: UdpPeer) -> None:
        heard: list[Asked] = []

        def script(asked: Asked) -> list[tuple[float, bytes]]:
            heard.append(asked)
            forged = asked.wrap(asked.unit, bytes.fromhex("03 04 66 66 66 66"))
            assert peer.client is not None
            with socket.socket(type=socket.SOCK_DGRAM) as stranger:
                stranger.bind(("127.0.0.1", 0))
                stranger.sendto(forged, peer.client)
            return [(0.02, frame(asked))]

        peer.script = script
        bus, tally = peer.bus(), Tally()
        for _ in range(3):
            assert words((await bus.transact(UNIT, READ, tally)).pdu) == (300, 301)
        assert len(heard) == 3
        assert (tally.late_answers, tally.wrong_answers, tally.discarded_octets) == (0, 0, 0)
        bus.close()

    play(behaviour)


def test_a_port_where_nobody_listens_is_told_at_once() -> None:
    async def behaviour(peer: UdpPeer) -> None:
        bus, tally = peer.bus(timeout=10_000 * MS), Tally()
        peer.stop()
        begun = time.monotonic()
        with pytest.raises(LinkDown, match="refused"):
            await bus.transact(UNIT, READ, tally)
        assert time.monotonic() - begun < 2  # it takes no time; a busy machine does
        assert (tally.link_losses, tally.timeouts) == (1, 0)

    play(behaviour)


def test_a_refusal_that_is_told_when_sending() -> None:
    """The answer of the computer to one datagram can come as the error of the next."""

    async def behaviour(peer: UdpPeer) -> None:
        lost: list[str] = []
        link = peer.link()
        peer.stop()
        await link.open(ignore, lost.append)
        link.send(b"1")
        with pytest.raises(OSError, match="refused"):
            link.send(b"2")  # nothing was read in between
        link.close()
        await asyncio.sleep(0)
        assert lost == []

    play(behaviour)


def test_a_datagram_that_cannot_be_sent() -> None:
    async def behaviour(peer: UdpPeer) -> None:
        link = peer.link()
        await link.open(ignore, ignore)
        with pytest.raises(OSError, match="too long"):
            link.send(bytes(70_000))
        link.close()

    play(behaviour)


def test_closing_is_not_losing() -> None:
    async def behaviour(peer: UdpPeer) -> None:
        lost: list[str] = []
        link = peer.link()
        with pytest.raises(OSError, match="closed"):
            link.send(b"1")
        for _ in range(3):
            await link.open(ignore, lost.append)
            link.close()
            link.close()
            await asyncio.sleep(0)
            with pytest.raises(OSError, match="closed"):
                link.send(b"1")
        assert lost == []

    play(behaviour)


@pytest.mark.parametrize("host", ["a" * 64 + ".invalid", "no-such-host.invalid"])
def test_a_name_that_leads_nowhere(host: str) -> None:
    async def main() -> None:
        with pytest.raises(OSError):
            await UdpLink(host, 502).open(ignore, ignore)

    asyncio.run(main())


def test_a_name_that_takes_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "_RESOLVE_SECONDS", 0.05)

    async def main() -> None:
        async def never(*_: object, **__: object) -> None:
            await asyncio.Event().wait()

        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", never)
        with pytest.raises(OSError, match="no address within"):
            await UdpLink("slow.invalid", 502).open(ignore, ignore)

    asyncio.run(main())


class BadNetwork(asyncio.DatagramProtocol):
    """Between one client and a peer: loses, copies and delays datagrams in both directions."""

    def __init__(self, peer: UdpPeer, seed: int) -> None:
        self._target = "127.0.0.1", peer.port
        self._rng = random.Random(seed)
        self._client: tuple[str, int] | None = None
        self._socket: asyncio.DatagramTransport | None = None
        self.lost = self.copied = self.delayed = 0

    async def start(self) -> int:
        loop = asyncio.get_running_loop()
        place = "127.0.0.1", 0
        self._socket, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=place)
        port: int = self._socket.get_extra_info("sockname")[1]
        return port

    def stop(self) -> None:
        if self._socket is not None:
            self._socket.abort()
            self._socket = None

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if addr == self._target:
            target = self._client
        else:
            self._client, target = addr, self._target
        if self._rng.random() < 0.08:
            self.lost += 1
            return
        copies = 1 + (self._rng.random() < 0.2)
        self.copied += copies - 1
        for _ in range(copies):
            delay = self._rng.choice((0, 0, 0, 0.01, 0.06))
            self.delayed += delay > 0
            asyncio.get_running_loop().call_later(delay, self._pass_on, data, target)

    def _pass_on(self, data: bytes, target: tuple[str, int] | None) -> None:
        if self._socket is not None and target is not None:
            self._socket.sendto(data, target)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_wrong_value_through_a_bad_network(seed: int) -> None:
    async def behaviour(peer: UdpPeer) -> None:
        network = BadNetwork(peer, seed)
        bus, tally = peer.bus(timeout=30 * MS), Tally()
        bus.link = UdpLink("127.0.0.1", await network.start())

        async def ask(bus: Bus, first: int) -> None:
            for address in range(first, first + 40):
                result = await outcome(bus.transact(UNIT, ReadRegisters(3, address, 2), tally))
                if isinstance(result, Answer):
                    assert words(result.pdu) == (address, address + 1)
                else:
                    assert isinstance(result, NoAnswer)

        await asyncio.gather(ask(bus, 1000), ask(bus, 2000))
        assert tally.requests == 80
        assert tally.answers + tally.timeouts == 80
        assert tally.answers > 20
        assert tally.late_answers > 5
        assert min(network.lost, network.copied, network.delayed) > 5
        assert (tally.wrong_answers, tally.link_losses) == (0, 0)
        bus.close()
        network.stop()

    play(behaviour)

"""What every transport promises, over real links, against a peer that speaks octets."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bus_fakes import outcome
from raw_peers import (
    MS,
    UNIT,
    Asked,
    GatewayPeer,
    LinePeer,
    Peer,
    TcpPeer,
    UdpPeer,
    good,
    registers,
)

from roclog.bus.bus import Answer, Bus
from roclog.bus.tally import Tally
from roclog.errors import (
    DeviceError,
    ExceptionAnswer,
    LinkDown,
    NoAnswer,
    WriteRefused,
    WrongAnswer,
)
from roclog.modbus.request import ReadRegisters, WriteRegister, words

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from raw_peers import Script

    Behaviour = Callable[[Peer], Awaitable[None]]

READ = ReadRegisters(3, 300, 2)
TRANSPORTS = ["rtu", "tcp", "udp", "rtu-over-tcp"]


@pytest.fixture(params=TRANSPORTS)
def peer(request: pytest.FixtureRequest, tmp_path: Path) -> Peer:
    kinds: dict[str, Callable[[], Peer]] = {
        "rtu": lambda: LinePeer(tmp_path / "line"),
        "tcp": TcpPeer,
        "udp": UdpPeer,
        "rtu-over-tcp": GatewayPeer,
    }
    return kinds[request.param]()


def play(peer: Peer, behaviour: Behaviour) -> None:
    async def main() -> None:
        await peer.start()
        try:
            async with asyncio.timeout(20):
                await behaviour(peer)
        finally:
            peer.stop()

    asyncio.run(main())


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(5):
        while not condition():  # noqa: ASYNC110 - a condition that has no event
            await asyncio.sleep(0.002)


def numbers(asked: Asked) -> bytes:
    """Answer equal questions differently: every register holds the number of the request."""
    return bytes([3, 2 * asked.count]) + asked.index.to_bytes(2) * asked.count


@pytest.mark.parametrize(
    "request_", [ReadRegisters(3, 300, 27), ReadRegisters(4, 65_411, 125), ReadRegisters(3, 0, 1)]
)
def test_a_good_answer_is_exact(peer: Peer, request_: ReadRegisters) -> None:
    async def behaviour(peer: Peer) -> None:
        bus, tally = peer.bus(), Tally()
        before = time.monotonic_ns()
        answer = await bus.transact(UNIT, request_, tally)
        (asked,) = peer.asked
        assert (asked.unit, asked.pdu[0]) == (UNIT, request_.function)
        assert (asked.address, asked.count) == (request_.address, request_.count)
        assert answer.pdu == registers(asked)
        assert before <= answer.asked.monotonic <= answer.read.monotonic <= time.monotonic_ns()
        assert (tally.requests, tally.answers, tally.discarded_octets) == (1, 1, 0)
        bus.close()

    play(peer, behaviour)


def test_an_exception_answer_is_one(peer: Peer) -> None:
    async def behaviour(peer: Peer) -> None:
        peer.script = lambda asked: [(0, asked.wrap(asked.unit, b"\x83\x02"))]
        bus, tally = peer.bus(), Tally()
        with pytest.raises(ExceptionAnswer) as caught:
            await bus.transact(UNIT, READ, tally)
        assert (caught.value.code, tally.exceptions) == (2, {2: 1})
        bus.close()

    play(peer, behaviour)


def test_no_answer_is_told_in_time(peer: Peer) -> None:
    async def behaviour(peer: Peer) -> None:
        peer.script = lambda _: []
        bus, tally = peer.bus(100 * MS, 250 * MS), Tally()
        begun = time.monotonic()
        with pytest.raises(NoAnswer):
            await bus.transact(UNIT, READ, tally)
        taken = time.monotonic() - begun
        assert (0.1 if peer.numbered else 0.25) <= taken < 2
        assert (tally.timeouts, tally.link_losses) == (1, 0)
        peer.script = good
        bus.timing = peer.bus().timing
        assert words((await bus.transact(UNIT, READ, tally)).pdu) == (300, 301)
        bus.close()

    play(peer, behaviour)


def test_a_late_answer_is_never_taken_for_the_next_request(peer: Peer) -> None:
    """The question is the same each time; every answer says to which request it belongs."""

    def script(asked: Asked) -> list[tuple[float, bytes]]:
        late, soon = (0.2, 0.1) if peer.numbered else (0.2, 0)
        return [(soon if asked.index % 2 else late, asked.wrap(asked.unit, numbers(asked)))]

    async def behaviour(peer: Peer) -> None:
        peer.script = script
        bus, tally = peer.bus(150 * MS, 1000 * MS), Tally()
        results = [await outcome(bus.transact(UNIT, READ, tally)) for _ in range(8)]
        for index, result in enumerate(results):
            if isinstance(result, Answer):
                assert words(result.pdu) == (index, index)
            else:
                assert isinstance(result, NoAnswer)
                assert peer.numbered
        assert tally.late_answers >= 3  # the last one may still be under way
        bus.close()

    play(peer, behaviour)


WRONG: dict[str, Callable[[Asked], bytes]] = {
    "unit": lambda asked: asked.wrap(UNIT + 1, registers(asked)),
    "function": lambda asked: asked.wrap(UNIT, b"\x04" + registers(asked)[1:]),
    "count": lambda asked: asked.wrap(UNIT, bytes.fromhex("03 02 01 2C")),
    "too many": lambda asked: asked.wrap(UNIT, bytes.fromhex("03 06 01 2C 01 2D 01 2E")),
}


@pytest.mark.parametrize("what", WRONG)
def test_an_answer_to_something_else_is_rejected(peer: Peer, what: str) -> None:
    async def behaviour(peer: Peer) -> None:
        wrong = WRONG[what]
        peer.script = lambda asked: [(0, wrong(asked))]
        bus, tally = peer.bus(100 * MS, 250 * MS), Tally()
        with pytest.raises(WrongAnswer):
            await bus.transact(UNIT, READ, tally)
        assert (tally.wrong_answers, tally.answers) == (1, 0)
        peer.script = good
        bus.timing = peer.bus().timing
        assert words((await bus.transact(UNIT, READ, tally)).pdu) == (300, 301)
        bus.close()

    play(peer, behaviour)


def test_copies_of_an_answer_do_no_harm(peer: Peer) -> None:
    """On a line they follow at once; where answers are numbered, also into the next exchange."""

    def script(asked: Asked) -> list[tuple[float, bytes]]:
        frame = asked.wrap(asked.unit, numbers(asked))
        copies = [(0.0, frame)] * 2
        return [*copies, (0.004, frame)] if peer.numbered else copies

    async def behaviour(peer: Peer) -> None:
        peer.script = script
        bus, tally = peer.bus(), Tally()
        for index in range(20):
            answer = await bus.transact(UNIT, READ, tally)
            assert words(answer.pdu) == (index, index)
        assert tally.answers == tally.requests == 20
        assert (tally.late_answers if peer.numbered else tally.discarded_octets) > 0
        bus.close()

    play(peer, behaviour)


async def first_of(kind: type[Exception | Answer], bus: Bus, tally: Tally) -> None:
    """Asks until it ends so, for 5 s."""
    async with asyncio.timeout(5):
        while not isinstance(result := await outcome(bus.transact(UNIT, READ, tally)), kind):
            assert isinstance(result, Answer | DeviceError)
            await asyncio.sleep(0.01)


def test_a_peer_that_was_gone_is_found_again(peer: Peer) -> None:
    async def behaviour(peer: Peer) -> None:
        bus, tally = peer.bus(200 * MS, 400 * MS), Tally()
        for _ in range(2):
            await first_of(Answer, bus, tally)
            peer.stop()
            await first_of(LinkDown, bus, tally)
            await peer.start()
        await first_of(Answer, bus, tally)
        assert tally.link_losses >= 2
        bus.close()

    play(peer, behaviour)


def test_no_descriptor_is_left_behind(peer: Peer) -> None:
    async def behaviour(peer: Peer) -> None:
        bus, tally = peer.bus(), Tally()
        before = descriptors()
        for _ in range(50):
            await bus.transact(UNIT, READ, tally)
            bus.close()
        await until(lambda: descriptors() <= before)
        assert (tally.answers, tally.link_losses) == (50, 0)

    play(peer, behaviour)


def test_two_tasks_take_turns(peer: Peer) -> None:
    async def behaviour(peer: Peer) -> None:
        peer.script = lambda asked: [(0.002, good(asked)[0][1])]
        bus, tally = peer.bus(), Tally()

        async def ask(first: int) -> None:
            for address in range(first, first + 20):
                answer = await bus.transact(UNIT, ReadRegisters(3, address, 2), tally)
                assert words(answer.pdu) == (address, address + 1)

        await asyncio.gather(ask(100), ask(500))
        assert (tally.answers, peer.overlaps, len(peer.asked)) == (40, 0, 40)
        bus.close()

    play(peer, behaviour)


def test_only_the_acknowledgement_is_written(peer: Peer) -> None:
    async def behaviour(peer: Peer) -> None:
        bus, tally = peer.bus(), Tally()
        for unit, address, value in ((UNIT, 300, 1), (UNIT, 301, 0), (UNIT + 1, 300, 0)):
            with pytest.raises(WriteRefused):
                await bus.transact(unit, WriteRegister(address, value), tally)
        assert not peer.asked
        await bus.transact(UNIT, READ, tally)
        await bus.transact(UNIT, WriteRegister(300, 0), tally)
        assert peer.asked[1].pdu == bytes.fromhex("06 01 2C 00 00")
        bus.close()

    play(peer, behaviour)


def test_the_script_of_the_peers_is_checked() -> None:
    script: Script = good
    asked = Asked(UNIT, bytes.fromhex("03 01 2C 00 02"), lambda unit, pdu: bytes([unit]) + pdu, 0)
    assert script(asked) == [(0, bytes.fromhex("8A 03 04 01 2C 01 2D"))]

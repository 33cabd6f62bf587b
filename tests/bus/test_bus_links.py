"""Links that go away, do not open, or break, in virtual time."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from itertools import pairwise

import pytest
from bus_fakes import (
    CLEAR,
    LATE,
    MS,
    OTHER,
    READ,
    SLACK,
    START,
    TCP,
    UNIT,
    FakeLink,
    answer_to,
    device,
    make,
    now,
    outcome,
    registers,
    run,
)

from roclog.bus.bus import Answer, Bus
from roclog.bus.tally import Tally
from roclog.errors import DeviceError, LinkDown, NoAnswer
from roclog.modbus.request import ReadRegisters, Request, words
from roclog.modbus.rtu import Echo, RtuExchange


def test_what_a_line_echoes_is_forgotten_when_it_is_opened_again() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        await bus.transact(UNIT, READ, Tally())
        assert bus.echo is Echo.ABSENT
        link.break_off()
        link.on_send = lambda adu: link.say(adu, 8 * MS)
        with pytest.raises(NoAnswer):
            await bus.transact(UNIT, CLEAR, Tally())

    run(main())


def test_a_fault_in_the_judging_of_octets_reaches_the_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main() -> None:
        link, bus = make()
        device(link)

        def feed(self: RtuExchange, octets: bytes) -> bytes | None:
            raise RuntimeError("a bug")

        with monkeypatch.context() as patch:
            patch.setattr(RtuExchange, "feed", feed)
            with pytest.raises(RuntimeError, match="a bug"):
                await bus.transact(UNIT, READ, Tally())
        assert now() - START < 50 * MS
        assert words((await bus.transact(UNIT, OTHER, Tally())).pdu) == (400, 401)
        assert link.sent[1][0] - link.sent[0][0] >= LATE

    run(main())


def test_a_lost_link_fails_the_pending_request_at_once() -> None:
    async def main() -> None:
        link, bus = make()

        def on_send(_: bytes) -> None:
            asyncio.get_running_loop().call_later(0.1, link.break_off)

        link.on_send = on_send
        tally = Tally()
        with pytest.raises(LinkDown, match="unplugged") as caught:
            await bus.transact(UNIT, READ, tally)
        assert isinstance(caught.value, ConnectionError)
        assert 0 <= now() - link.sent[0][0] - 100 * MS <= SLACK
        assert (tally.link_losses, tally.timeouts, tally.requests) == (1, 0, 1)

    run(main())


def test_closing_fails_the_pending_request_at_once() -> None:
    async def main() -> None:
        _, bus = make()
        pending = asyncio.create_task(bus.transact(UNIT, READ, Tally()))
        await asyncio.sleep(0.1)
        bus.close()
        with pytest.raises(LinkDown, match="closed"):
            await pending
        assert 0 <= now() - START - 100 * MS <= SLACK
        bus.close()

    run(main())


def test_an_old_answer_may_still_come_through_a_link_that_was_opened_again() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu), 400 * MS if len(link.sent) == 1 else 0)
        first = asyncio.create_task(bus.transact(UNIT, READ, Tally()))
        await asyncio.sleep(0.1)
        link.break_off()
        with pytest.raises(LinkDown):
            await first
        await asyncio.sleep(0.1)
        assert words((await bus.transact(UNIT, OTHER, Tally())).pdu) == (400, 401)
        assert link.sent[1][0] - link.sent[0][0] >= LATE

    run(main())


def test_a_link_that_takes_no_octets() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        link.send_failures = [OSError(5, "Input/output error")]
        tally = Tally()
        with pytest.raises(LinkDown, match="Input/output error"):
            await bus.transact(UNIT, READ, tally)
        assert not link.is_open
        assert (tally.requests, tally.link_losses) == (0, 1)
        await asyncio.sleep(0.2)
        await bus.transact(UNIT, READ, tally)
        assert tally.link_losses == 1

    run(main())


async def _keep_asking(bus: Bus, seconds: float, tally: Tally) -> None:
    end = now() + int(seconds * 1e9)
    while now() < end:
        with pytest.raises(LinkDown):
            await bus.transact(UNIT, READ, tally)
        await asyncio.sleep(0.01)


def _delays(link: FakeLink) -> list[float]:
    return [round((after - before) / 1e9, 1) for before, after in pairwise(link.opened)]


def test_a_missing_port_is_tried_for_ever_and_not_too_often() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        link.open_failures = [OSError(2, "No such file or directory")] * 50
        tally = Tally()
        with pytest.raises(LinkDown, match="cannot be opened: No such file"):
            await bus.transact(UNIT, READ, tally)
        with pytest.raises(LinkDown, match="next attempt soon: No such file"):
            await bus.transact(UNIT, READ, tally)
        await _keep_asking(bus, 90, tally)
        assert _delays(link)[:6] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0]
        assert set(_delays(link)[6:]) == {2.0}
        assert tally.link_losses == len(link.opened)
        link.open_failures.clear()
        await asyncio.sleep(2)
        await bus.transact(UNIT, READ, tally)
        link.break_off()
        link.opened.clear()
        link.open_failures = [OSError(2, "No such file or directory")] * 50
        await _keep_asking(bus, 1, tally)
        assert _delays(link)[:3] == [0.1, 0.2, 0.4]

    run(main())


def test_a_peer_that_hangs_up_before_it_answers_is_not_called_at_once_again() -> None:
    async def main() -> None:
        link, bus = make(TCP)
        link.on_send = lambda _: link.break_off("reset")
        await _keep_asking(bus, 20, Tally())
        assert _delays(link)[:6] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0]

    run(main())


def test_a_link_that_has_worked_is_opened_again_at_once() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        for _ in range(10):
            await bus.transact(UNIT, READ, tally)
            link.break_off()
        assert tally.answers == 10
        assert now() - START < 400 * MS

    run(main())


def test_a_bus_serves_on_after_every_kind_of_failure() -> None:
    async def main() -> None:
        rng = random.Random(3)
        link, bus = make()

        def on_send(adu: bytes) -> None:
            match rng.randrange(6):
                case 0:
                    link.say(answer_to(adu), rng.randrange(900) * MS)
                case 1:
                    link.say(rng.randbytes(rng.randrange(1, 90)), rng.randrange(900) * MS)
                case 2:
                    link.break_off()
                case 3:
                    link.say_one_by_one(answer_to(adu), MS, 10 * MS)
                case 4:
                    link.say(adu + answer_to(adu), 10 * MS)

        link.on_send = on_send
        kinds = Counter[str]()
        for _ in range(500):
            request: Request = ReadRegisters(3, rng.randrange(0xFF00), rng.randrange(1, 126))
            result = await outcome(bus.transact(UNIT, request, Tally()))
            kinds[type(result).__name__] += 1
            if isinstance(result, Answer):
                assert result.pdu == registers(request.pdu)
            else:
                assert isinstance(result, DeviceError)
        assert set(kinds) == {"Answer", "NoAnswer", "LinkDown"}

    run(main())

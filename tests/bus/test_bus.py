"""Who speaks when on a serial line, in virtual time: every instant below is exact."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import pytest
from bus_fakes import (
    CLEAR,
    LATE,
    MS,
    READ,
    RTU,
    SILENCE,
    SLACK,
    START,
    UNIT,
    FakeLink,
    answer_to,
    device,
    make,
    now,
    outcome,
    run,
)
from wire import exception_pdu, rtu_frame

from roclog.bus.bus import Answer, Bus
from roclog.bus.tally import Tally
from roclog.errors import ExceptionAnswer, LinkDown, NoAnswer, WrongAnswer
from roclog.modbus.request import ReadRegisters, words
from roclog.modbus.rtu import Echo


def test_a_line_that_babbles_between_polls_costs_no_memory() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        await bus.transact(UNIT, READ, Tally())
        kept = len(bus._heard)
        for _ in range(1000):
            link._say(b"\x55")
        assert len(bus._heard) == kept

    run(main())


def test_one_transaction_at_a_time() -> None:
    async def main() -> None:
        link, bus = make()
        open_exchanges = Counter[str]()

        def on_send(adu: bytes) -> None:
            open_exchanges["now"] += 1
            assert open_exchanges["now"] == 1
            link.say(answer_to(adu), 30 * MS)
            asyncio.get_running_loop().call_later(0.03, open_exchanges.subtract, ["now"])

        link.on_send = on_send
        asked = [ReadRegisters(3, address, 2) for address in range(20)]
        answers = await asyncio.gather(*(bus.transact(UNIT, r, Tally()) for r in asked))
        assert [words(a.pdu) for a in answers] == [(n, n + 1) for n in range(20)]
        assert [adu[2:4] for _, adu in link.sent] == [r.pdu[1:3] for r in asked]

    run(main())


def test_silence_before_every_frame() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say_one_by_one(answer_to(adu), MS, 18 * MS)
        for _ in range(5):
            await bus.transact(UNIT, READ, Tally())
        starts = [at for at, _ in link.sent]
        assert START + SILENCE <= starts[0] <= START + SILENCE + SLACK
        cycle = (18 + len(answer_to(link.sent[0][1]))) * MS + SILENCE
        for before, after in pairwise(starts):
            assert cycle <= after - before <= cycle + 50 * SLACK

    run(main())


def test_silence_after_a_request_that_nobody_answers() -> None:
    async def main() -> None:
        link, bus = make(replace(RTU, timeout=MS, late_answer=MS, silence=50 * MS))
        for _ in range(2):
            with pytest.raises(NoAnswer):
                await bus.transact(UNIT, READ, Tally())
        gap = link.sent[1][0] - link.sent[0][0]
        assert (8 + 50) * MS <= gap <= (8 + 50) * MS + SLACK

    run(main())


def test_silence_after_octets_that_nobody_asked_for() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        await bus.transact(UNIT, READ, tally)
        await asyncio.sleep(1)
        link.say(b"\x00\x00")
        link.say(b"\x00", 3 * MS)
        await asyncio.sleep(0.002)
        heard = now() + MS
        await bus.transact(UNIT, READ, tally)
        assert heard + SILENCE <= link.sent[-1][0] <= heard + SILENCE + SLACK
        assert tally.discarded_octets == 3

    run(main())


def test_a_line_that_is_never_silent() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        await bus.transact(UNIT, READ, tally)
        babble = asyncio.create_task(_babble(link))
        started = now()
        with pytest.raises(NoAnswer, match="never silent"):
            await bus.transact(UNIT, READ, tally)
        assert LATE <= now() - started <= LATE + 4 * SILENCE
        assert len(link.sent) == 1
        assert tally.requests == 1
        assert tally.discarded_octets > 400
        babble.cancel()
        assert words((await bus.transact(UNIT, READ, tally)).pdu) == (300, 301)

    run(main())


async def _babble(link: FakeLink) -> None:
    while True:
        link.say(b"\x55")
        await asyncio.sleep(0.002)


def test_a_babbling_line_cannot_hold_an_exchange_longer_than_its_late_answer() -> None:
    async def main() -> None:
        link, bus = make()
        tasks = []
        link.on_send = lambda _: tasks.append(asyncio.ensure_future(_babble(link)))
        tally = Tally()
        with pytest.raises(NoAnswer, match="octets 55 55"):
            await bus.transact(UNIT, READ, tally)
        assert now() <= link.sent[0][0] + LATE + SLACK
        assert (tally.timeouts, tally.crc_errors) == (1, 1)
        tasks[0].cancel()

    run(main())


async def learn_that_nothing_echoes(link: FakeLink, bus: Bus) -> None:
    link.on_send = lambda adu: link.say(answer_to(adu), 20 * MS)
    await bus.transact(UNIT, READ, Tally())
    assert bus.echo is Echo.ABSENT


def test_a_damaged_answer_on_a_line_without_echo_ends_the_wait_soon() -> None:
    async def main() -> None:
        link, bus = make()
        await learn_that_nothing_echoes(link, bus)
        damaged = bytearray(answer_to(rtu_frame(UNIT, READ.pdu)))
        damaged[5] ^= 1
        link.on_send = lambda _: link.say(bytes(damaged), 20 * MS)
        tally = Tally()
        with pytest.raises(NoAnswer, match="damaged"):
            await bus.transact(UNIT, READ, tally)
        assert 70 * MS <= now() - link.sent[1][0] <= 70 * MS + SLACK
        assert (tally.timeouts, tally.crc_errors, tally.answers) == (0, 1, 0)
        link.on_send = lambda adu: link.say(answer_to(adu), 20 * MS)
        await bus.transact(UNIT, READ, tally)
        assert link.sent[2][0] - link.sent[1][0] < 100 * MS

    run(main())


def test_noise_like_an_answer_does_not_hide_the_answer_behind_it() -> None:
    async def main() -> None:
        link, bus = make()
        await learn_that_nothing_echoes(link, bus)
        noise = bytearray(answer_to(rtu_frame(UNIT, READ.pdu)))
        noise[5] ^= 1

        def on_send(adu: bytes) -> None:
            link.say(bytes(noise), 20 * MS)
            link.say(answer_to(adu), 50 * MS)

        link.on_send = on_send
        answer = await bus.transact(UNIT, READ, Tally())
        assert answer.pdu == answer_to(rtu_frame(UNIT, READ.pdu))[1:-2]

    run(main())


def test_a_damaged_answer_is_waited_out_and_counted() -> None:
    async def main() -> None:
        link, bus = make()
        damaged = bytearray(answer_to(rtu_frame(UNIT, READ.pdu)))
        damaged[5] ^= 1
        link.on_send = lambda _: link.say(bytes(damaged), 20 * MS)
        tally = Tally()
        with pytest.raises(NoAnswer, match=damaged.hex(" ")):
            await bus.transact(UNIT, READ, tally)
        assert now() >= link.sent[0][0] + LATE
        assert (tally.timeouts, tally.crc_errors, tally.answers) == (1, 1, 0)
        assert tally.discarded_octets == len(damaged)

    run(main())


def test_an_answer_to_something_else_is_told_from_noise() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda _: link.say(rtu_frame(UNIT, b"\x03\x02\x00\x01"), 20 * MS)
        tally = Tally()
        with pytest.raises(WrongAnswer, match="something else"):
            await bus.transact(UNIT, READ, tally)
        assert (tally.wrong_answers, tally.crc_errors) == (1, 0)

    run(main())


def test_a_refusal_behind_noise_that_looks_like_an_answer() -> None:
    async def main() -> None:
        link, bus = make()
        octets = bytes([UNIT, 3, 4]) + rtu_frame(UNIT, exception_pdu(3, 2))[:5]
        link.on_send = lambda _: link.say(octets, 20 * MS)
        tally = Tally()
        with pytest.raises(ExceptionAnswer, match="exception 2"):
            await bus.transact(UNIT, READ, tally)
        assert (tally.late_answers, tally.exceptions) == (1, {2: 1})

    run(main())


def test_a_refusal_ends_the_transaction_at_once() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(rtu_frame(UNIT, exception_pdu(adu[1], 3)), 20 * MS)
        tally = Tally()
        for request in (READ, CLEAR):
            with pytest.raises(ExceptionAnswer):
                await bus.transact(UNIT, request, tally)
        assert now() - START < 100 * MS
        assert tally.exceptions == {3: 2}
        assert (tally.requests, tally.answers, tally.timeouts) == (2, 0, 0)

    run(main())


def test_an_echoing_line() -> None:
    async def main() -> None:
        link, bus = make()

        def on_send(adu: bytes) -> None:
            link.say(adu, 8 * MS)
            if answering:
                link.say(answer_to(adu), 20 * MS)

        link.on_send = on_send
        tally = Tally()
        answering = True
        await bus.transact(UNIT, READ, tally)
        assert bus.echo is Echo.PRESENT
        await bus.transact(UNIT, CLEAR, tally)
        answering = False
        with pytest.raises(NoAnswer):
            await bus.transact(UNIT, CLEAR, tally)
        assert tally.answers == 2
        assert tally.discarded_octets == 0

    run(main())


def test_the_whole_tally() -> None:
    async def main() -> None:
        link, bus = make()
        tally = Tally()
        script = [
            lambda adu: link.say(answer_to(adu), 30 * MS),
            lambda adu: link.say(b"\xff" + answer_to(adu) + b"\x00", 50 * MS),
            lambda _: link.say(rtu_frame(UNIT, b"\x83\x02"), 30 * MS),
            lambda _: link.say(rtu_frame(UNIT, b"\x83\x02"), 30 * MS),
            lambda _: link.say(rtu_frame(UNIT, b"\x83\x0b"), 30 * MS),
            lambda adu: link.say(answer_to(adu), 700 * MS),
            lambda adu: link.say(answer_to(adu)[:-1], 30 * MS),
            lambda _: link.say(rtu_frame(7, b"\x83\x02"), 30 * MS),
            lambda _: None,
            lambda _: link.break_off(),
        ]
        results: list[Answer | Exception] = []
        for link.on_send in script:
            results.append(await outcome(bus.transact(UNIT, READ, tally)))
        assert [type(result) for result in results] == [
            *(Answer, Answer, ExceptionAnswer, ExceptionAnswer, ExceptionAnswer),
            *(Answer, NoAnswer, WrongAnswer, NoAnswer, LinkDown),
        ]
        assert (tally.requests, tally.answers, tally.exceptions) == (10, 3, {2: 2, 11: 1})
        assert (tally.timeouts, tally.late_answers) == (4, 1)
        assert (tally.crc_errors, tally.wrong_answers, tally.link_losses) == (1, 1, 1)
        assert tally.discarded_octets == 2 + 8 + 5
        assert 780 * MS <= tally.round_trip_sum <= 781 * MS
        assert 700 * MS <= tally.round_trip_max <= 701 * MS
        assert 3870 * MS <= tally.busy <= 3871 * MS
        tally.reset()
        assert tally == Tally()

    run(main())

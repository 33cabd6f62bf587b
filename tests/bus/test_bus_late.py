"""Answers that come after their time-out, or after nobody waits for them any more."""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass, replace

import pytest
from bus_fakes import (
    CLEAR,
    LATE,
    MS,
    OTHER,
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
    registers,
    run,
)

from roclog.bus.bus import Answer
from roclog.bus.tally import Tally
from roclog.errors import NoAnswer
from roclog.modbus.request import ReadRegisters, words


def test_a_late_answer_is_used_for_its_own_request() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu), 800 * MS)
        tally = Tally()
        first, second = await asyncio.gather(
            bus.transact(UNIT, READ, tally), bus.transact(UNIT, OTHER, tally)
        )
        assert words(first.pdu) == (300, 301)
        assert words(second.pdu) == (400, 401)
        assert (tally.requests, tally.answers) == (2, 2)
        assert (tally.timeouts, tally.late_answers) == (2, 2)
        assert first.read.monotonic - first.asked.monotonic >= 800 * MS
        gap = link.sent[1][0] - first.read.monotonic
        assert SILENCE <= gap <= SILENCE + SLACK

    run(main())


@pytest.mark.parametrize("late", [600, 1000, 3000])
def test_after_a_time_out_nothing_is_sent_until_the_answer_can_no_longer_come(late: int) -> None:
    async def main() -> None:
        timing = replace(RTU, late_answer=late * MS)
        link, bus = make(timing)
        tally = Tally()
        results = await asyncio.gather(
            outcome(bus.transact(UNIT, READ, tally)), outcome(bus.transact(UNIT, OTHER, tally))
        )
        assert [type(r) for r in results] == [NoAnswer, NoAnswer]
        gap = link.sent[1][0] - link.sent[0][0]
        assert late * MS <= gap <= late * MS + SLACK
        assert (tally.timeouts, tally.late_answers, tally.crc_errors) == (2, 0, 0)
        assert tally.busy >= 2 * late * MS

    run(main())


@dataclass
class SlowServer:
    """Late in a tenth of the cases. A busy one either answers in turn, or hears nothing."""

    link: FakeLink
    deaf: bool
    rng: random.Random
    free_at: int = 0
    late: int = 0

    def __call__(self, adu: bytes) -> None:
        if self.deaf and now() < self.free_at:
            return
        is_late = self.rng.random() < 0.1
        self.late += is_late
        delay = int(self.rng.uniform(80, 250) * MS) if is_late else 10 * MS
        self.free_at = max(self.free_at, now()) + delay
        self.link.say(answer_to(adu), self.free_at - now())


@pytest.mark.parametrize("deaf", [False, True])
def test_no_late_answer_is_taken_for_another(*, deaf: bool) -> None:
    async def main() -> None:
        link, bus = make(replace(RTU, timeout=60 * MS, late_answer=300 * MS, character=0))
        server = link.on_send = SlowServer(link, deaf, random.Random(7))
        tally = Tally()
        requests = [ReadRegisters(3, 64 * index, 27) for index in range(250)]
        results = await asyncio.gather(*(outcome(bus.transact(1, r, tally)) for r in requests))
        wrong = [
            request
            for request, result in zip(requests, results, strict=True)
            if isinstance(result, Answer) and result.pdu != registers(request.pdu)
        ]
        assert wrong == []
        assert [r for r in results if not isinstance(r, Answer)] == []
        assert server.late > 15
        assert tally.late_answers == tally.timeouts == server.late
        assert (tally.requests, tally.answers) == (250, 250)

    run(main())


def test_cancelling_does_not_hand_the_answer_to_the_next() -> None:
    async def main() -> None:
        link, bus = make()
        same_shape = ReadRegisters(3, 500, 2)
        link.on_send = lambda adu: link.say(answer_to(adu), 400 * MS if len(link.sent) == 1 else 0)
        tally = Tally()
        task = asyncio.create_task(bus.transact(UNIT, READ, tally))
        await asyncio.sleep(0.1)
        task.cancel()
        assert words((await bus.transact(UNIT, same_shape, tally)).pdu) == (500, 501)
        assert link.sent[1][0] - link.sent[0][0] >= LATE
        assert tally.discarded_octets == len(answer_to(link.sent[0][1]))

    run(main())


def test_cancelling_before_anything_is_sent_costs_nothing() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        first = asyncio.create_task(bus.transact(UNIT, READ, Tally()))
        waiting = asyncio.create_task(bus.transact(UNIT, CLEAR, Tally()))
        await asyncio.sleep(0)
        waiting.cancel()
        await first
        in_silence = asyncio.create_task(bus.transact(UNIT, CLEAR, Tally()))
        await asyncio.sleep(0.001)
        in_silence.cancel()
        await bus.transact(UNIT, READ, Tally())
        assert [adu[1] for _, adu in link.sent] == [3, 3]
        assert now() - START < 100 * MS

    run(main())

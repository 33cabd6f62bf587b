"""Who speaks when, in virtual time: every instant below is exact."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from bus_fakes import MS, START, FakeLink, VirtualClock, now, run
from wire import exception_pdu, mbap_frame, rtu_frame

from roclog.bus.bus import Answer, Bus, Timing, TooLate
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
from roclog.modbus.rtu import Echo, RtuExchange

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from roclog.modbus.request import Request

UNIT = 138
SILENCE = 5 * MS
LATE = 1000 * MS
RTU = Timing(timeout=500 * MS, late_answer=LATE, silence=SILENCE, character=MS)
TCP = Timing(timeout=500 * MS)
READ = ReadRegisters(3, 300, 2)
OTHER = ReadRegisters(3, 400, 2)
CLEAR = WriteRegister(300, 0)
PERMITTED = frozenset({(UNIT, 300, 0)})
SLACK = 1000
"""Nanoseconds by which the event loop rounds a sleep up."""


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
        timing = Timing(timeout=500 * MS, late_answer=late * MS, silence=SILENCE, character=MS)
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
        link, bus = make(Timing(timeout=60 * MS, late_answer=300 * MS, silence=5 * MS))
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


@pytest.mark.parametrize(
    ("unit", "request_"),
    [
        (UNIT, WriteRegister(300, 1)),
        (UNIT, WriteRegister(301, 0)),
        (UNIT, WriteRegister(1101, 0x55)),
        (UNIT - 1, CLEAR),
        (0, CLEAR),
    ],
)
def test_writes_that_are_not_permitted_never_leave(unit: int, request_: WriteRegister) -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        with pytest.raises(WriteRefused, match=f"writing {request_.value} to register"):
            await bus.transact(unit, request_, tally)
        assert (link.sent, link.opened, tally.requests) == ([], [], 0)

    run(main())


def test_the_permitted_write_leaves() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        await bus.transact(UNIT, READ, Tally())
        await bus.transact(UNIT, CLEAR, Tally())
        assert [adu for _, adu in link.sent] == [rtu_frame(UNIT, r.pdu) for r in (READ, CLEAR)]

    run(main())


@dataclass
class HandMade:
    """A request of any kind, that says of itself what it likes."""

    pdu: bytes
    answer_size: int = 5

    @property
    def head(self) -> bytes:
        return self.pdu[:1]


@pytest.mark.parametrize(
    "pdu",
    [
        "05 01 2C FF 00",
        "06 01 2C 00 00 00",
        "06 01",
        "08 00 01 00 00",
        "0F 00 00 00 08 01 FF",
        "10 01 2C 00 01 02 00 00",
        "16 01 2C 00 00 00 00",
        "17 01 2C 00 01 01 2C 00 01 02 00 00",
        "2B 0E 01 00",
        "5A",
    ],
)
def test_only_reads_leave_without_permission(pdu: str) -> None:
    async def main() -> None:
        link, bus = make()
        with pytest.raises(WriteRefused):
            await bus.transact(UNIT, HandMade(bytes.fromhex(pdu)), Tally())
        assert link.opened == []

    run(main())


def test_not_after() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        await bus.transact(UNIT, READ, tally, not_after=START + SILENCE + SLACK)
        blocking = asyncio.create_task(bus.transact(UNIT, READ, tally))
        await asyncio.sleep(0)
        with pytest.raises(TooLate):
            await bus.transact(UNIT, CLEAR, tally, not_after=now() + 10 * MS)
        await blocking
        await bus.transact(UNIT, READ, tally)
        with pytest.raises(TooLate):  # the silence alone ends after it
            await bus.transact(UNIT, CLEAR, tally, not_after=now() + SILENCE - MS)
        assert [adu[1] for _, adu in link.sent] == [3, 3, 3]
        assert tally.requests == 3

    run(main())


def tcp_answer(adu: bytes) -> bytes:
    return mbap_frame(int.from_bytes(adu[:2]), adu[6], registers(adu[7:]))


def test_tcp_asks_the_next_at_once_and_drops_late_answers_by_their_number() -> None:
    async def main() -> None:
        link, bus = make(TCP)
        link.on_send = lambda adu: link.say(
            tcp_answer(adu), 550 * MS if len(link.sent) == 1 else 100 * MS
        )
        tally = Tally()
        first, second = await asyncio.gather(
            outcome(bus.transact(UNIT, READ, tally)), outcome(bus.transact(UNIT, OTHER, tally))
        )
        assert isinstance(first, NoAnswer)
        assert isinstance(second, Answer)
        assert words(second.pdu) == (400, 401)
        assert link.sent[1][0] == link.sent[0][0] + 500 * MS
        assert (tally.timeouts, tally.late_answers, tally.answers) == (1, 1, 1)

    run(main())


@pytest.mark.parametrize("cut", [1, 6, 7, 9, 12])
@pytest.mark.parametrize("idle", [True, False])
def test_a_late_tcp_answer_may_be_cut_anywhere(cut: int, *, idle: bool) -> None:
    async def main() -> None:
        link, bus = make(TCP)
        tally = Tally()
        with pytest.raises(NoAnswer):
            await bus.transact(UNIT, READ, tally)
        late = tcp_answer(link.sent[0][1])
        link.say(late[:cut])
        link.say(late[cut:], 0 if idle else 20 * MS)
        await asyncio.sleep(0.01)
        link.on_send = lambda adu: link.say(tcp_answer(adu), 20 * MS)
        assert words((await bus.transact(UNIT, OTHER, tally)).pdu) == (400, 401)
        assert (tally.late_answers, tally.link_losses) == (1, 0)

    run(main())


@pytest.mark.parametrize("idle", [True, False])
def test_a_peer_that_does_not_speak_modbus_is_hung_up_on(*, idle: bool) -> None:
    async def main() -> None:
        link, bus = make(TCP)
        tally = Tally()
        link.on_send = lambda adu: link.say(tcp_answer(adu), 20 * MS)
        await bus.transact(UNIT, READ, tally)
        if idle:
            link.say(b"HTTP/1.1 400 Bad Request\r\n")
            await asyncio.sleep(0.01)
        else:
            link.on_send = lambda _: link.say(b"HTTP/1.1 400 Bad Request\r\n", 20 * MS)
            with pytest.raises(LinkDown, match="not a Modbus TCP stream"):
                await bus.transact(UNIT, READ, tally)
        assert not link.is_open
        link.on_send = lambda adu: link.say(tcp_answer(adu), 20 * MS)
        await asyncio.sleep(0.1)
        await bus.transact(UNIT, READ, tally)
        assert (tally.answers, tally.link_losses) == (2, 1)

    run(main())


def test_tcp_answers_of_another_unit_or_another_shape() -> None:
    async def main() -> None:
        link, bus = make(TCP)
        tally = Tally()
        link.on_send = lambda adu: link.say(
            mbap_frame(int.from_bytes(adu[:2]), 7, registers(adu[7:]))
        )
        with pytest.raises(WrongAnswer, match="unit 7 answered"):
            await bus.transact(UNIT, READ, tally)
        link.on_send = lambda adu: link.say(
            mbap_frame(int.from_bytes(adu[:2]), UNIT, b"\x03\x02\0\0")
        )
        with pytest.raises(WrongAnswer, match="4 octets instead of 6"):
            await bus.transact(UNIT, READ, tally)
        assert (tally.wrong_answers, tally.answers) == (2, 0)

    run(main())


def test_transaction_numbers_run_from_1_to_65535_and_over() -> None:
    async def main() -> None:
        link, bus = make(TCP)
        link.on_send = lambda adu: link.say(tcp_answer(adu))
        bus._transaction = 0xFFFE
        for _ in range(3):
            await bus.transact(UNIT, READ, Tally())
        assert [int.from_bytes(adu[:2]) for _, adu in link.sent] == [0xFFFF, 1, 2]

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

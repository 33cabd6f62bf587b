"""The bus over numbered answers, in virtual time."""

from __future__ import annotations

import asyncio

import pytest
from bus_fakes import MS, OTHER, READ, TCP, UNIT, make, outcome, registers, run, tcp_answer
from wire import mbap_frame

from roclog.bus.bus import Answer
from roclog.bus.tally import Tally
from roclog.errors import LinkDown, NoAnswer, WrongAnswer
from roclog.modbus.request import words


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

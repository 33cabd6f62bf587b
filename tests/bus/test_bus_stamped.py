"""Time-stamped inputs over the whole bus: they pass as reads, and their refusals are understood."""

from __future__ import annotations

import pytest
from bus_fakes import LATE, MS, RTU, START, TCP, FakeLink, make, now, outcome, run
from wire import mbap_frame, rtu_frame

from roclog.bus.bus import Answer
from roclog.bus.tally import Tally
from roclog.errors import ExceptionAnswer, WriteRefused, WrongAnswer
from roclog.modbus.request import Mei, ReadStamped

UNIT = 1
READ = ReadStamped(Mei.REGISTERS_4, 8, 2)
ANSWER = bytes.fromhex("2B 94 0C 00 0A DD EE 3A 0F 00 0E CC EE 3A 0F")


@pytest.mark.parametrize("echoes", [False, True])
def test_an_answer_octet_by_octet(*, echoes: bool) -> None:
    async def main() -> None:
        link, bus = make(RTU)

        def on_send(adu: bytes) -> None:
            frame = (adu if echoes else b"") + rtu_frame(UNIT, ANSWER)
            link.say_one_by_one(b"\x01\x2b" + frame, MS)

        link.on_send = on_send
        for _ in range(2):
            answer = await bus.transact(UNIT, READ, tally := Tally())
            assert answer.pdu == ANSWER
            assert (tally.answers, tally.discarded_octets) == (1, 2)
        assert [adu for _, adu in link.sent] == [rtu_frame(UNIT, READ.pdu)] * 2

    run(main())


@pytest.mark.parametrize("pdu", ["AB 94 02", "AB 02"])
@pytest.mark.parametrize("timing", [RTU, TCP])
def test_both_exceptions_end_the_wait_at_once(pdu: str, timing: object) -> None:
    async def main() -> None:
        link, bus = make(RTU if timing is RTU else TCP)

        def on_send(adu: bytes) -> None:
            octets = bytes.fromhex(pdu)
            number = int.from_bytes(adu[:2])
            serial = timing is RTU
            link.say(rtu_frame(UNIT, octets) if serial else mbap_frame(number, UNIT, octets), MS)

        link.on_send = on_send
        refusal = await outcome(bus.transact(UNIT, READ, tally := Tally()))
        assert isinstance(refusal, ExceptionAnswer)
        assert (refusal.code, tally.exceptions) == (2, {2: 1})
        assert now() - START < 30 * MS

    run(main())


def test_a_code_that_may_be_the_mei_type_is_believed_after_the_wait() -> None:
    async def main() -> None:
        link, bus = make(RTU)
        link.on_send = lambda adu: link.say(rtu_frame(UNIT, b"\xab\x94"), MS)
        refusal = await outcome(bus.transact(UNIT, READ, tally := Tally()))
        assert isinstance(refusal, ExceptionAnswer)
        assert (refusal.code, tally.timeouts) == (0x94, 1)
        assert now() - START >= LATE

    run(main())


def test_the_misprinted_answer_is_a_wrong_one_with_its_octets() -> None:
    asked = ReadStamped(Mei.DISCRETE_4, 196, 22)
    printed = bytes.fromhex("2B 82 98 03 AC DB 35 94") + bytes(88)

    async def main() -> None:
        link, bus = make(RTU)
        link.on_send = lambda adu: link.say(rtu_frame(UNIT, printed), MS)
        wrong = await outcome(bus.transact(UNIT, asked, tally := Tally()))
        assert isinstance(wrong, WrongAnswer)
        assert wrong.raw == rtu_frame(UNIT, printed)
        assert tally.wrong_answers == 1

    run(main())


@pytest.mark.parametrize("pdu", ["2B 0E 05 00", "2B 82 00 08 00 02 00", "2B 86 00 08 00 02"])
def test_no_other_request_of_function_43_leaves(pdu: str) -> None:
    class Other(ReadStamped):
        @property
        def pdu(self) -> bytes:
            return bytes.fromhex(pdu)

    async def main() -> None:
        link, bus = make(RTU)
        with pytest.raises(WriteRefused):
            await bus.transact(UNIT, Other(Mei.REGISTERS_4, 8, 2), Tally())
        assert isinstance(link, FakeLink)
        assert link.sent == []

    run(main())


def test_an_answer_is_an_answer() -> None:
    """The instants belong to the transaction as with any other request."""

    async def main() -> None:
        link, bus = make(TCP)
        link.on_send = lambda adu: link.say(
            mbap_frame(int.from_bytes(adu[:2]), UNIT, ANSWER), 20 * MS
        )
        answer = await bus.transact(UNIT, READ, Tally())
        assert isinstance(answer, Answer)
        assert answer.read.monotonic - answer.asked.monotonic == pytest.approx(20 * MS, rel=0.01)

    run(main())

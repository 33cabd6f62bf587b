"""Time-stamped inputs on a serial line: octet by octet, with echo, noise and both exceptions."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire import crc16, rtu_frame

from roclog.errors import ExceptionAnswer
from roclog.modbus.request import Mei, ReadStamped, check_answer
from roclog.modbus.rtu import Echo, RtuExchange

if TYPE_CHECKING:
    from collections.abc import Iterable

UNIT = 1
READ = ReadStamped(Mei.REGISTERS_7, 8, 2)
ANSWER = bytes.fromhex("2B 84 12 00 0A DD EE 3A 0F B4 03 03 00 0E CC EE 3A 0F B4 03 03")
PROPERTY = settings(derandomize=True, deadline=None, max_examples=300)


def heard(pending: RtuExchange, octets: bytes) -> list[bytes | None]:
    """What each octet makes of it, up to the answer."""
    found: list[bytes | None] = []
    for octet in octets:
        found.append(pending.feed(bytes([octet])))
        if found[-1] is not None:
            break
    return found


def result(pending: RtuExchange, octets: bytes) -> bytes | None:
    found = heard(pending, octets)
    return found[-1] if found and found[-1] is not None else pending.conclude()


def candidates(octets: bytes, unit: int, request: ReadStamped) -> list[bytes]:
    """By brute force: the PDU of everything in there that answers the request."""
    found = []
    for start in range(len(octets)):
        for size in (5, 6, 3 + request.answer_size):
            frame = octets[start : start + size]
            if len(frame) < size or crc16(frame[:-2]).to_bytes(2, "little") != frame[-2:]:
                continue
            head = bytes([unit, 0xAB]) + (request.pdu[1:2] if size == 6 else b"")
            if size > 6:
                head = bytes([unit]) + request.head
            if frame.startswith(head):
                found.append(frame[1:-2])
    return found


@pytest.mark.parametrize("echo", Echo)
def test_answered(echo: Echo) -> None:
    pending = RtuExchange(UNIT, READ, echo)
    assert pending.adu == bytes.fromhex("01 2B 84 00 08 00 02 FD C6")
    frame = bytes.fromhex("01") + ANSWER + bytes.fromhex("B7 9F")
    assert heard(pending, frame) == [None] * (len(frame) - 1) + [ANSWER]
    assert pending.echo is Echo.ABSENT
    assert pending.leftover == b""


@pytest.mark.parametrize("echo", Echo)
def test_answered_behind_an_echo_and_noise(echo: Echo) -> None:
    pending = RtuExchange(UNIT, READ, echo)
    line = b"\x01\x2b\xff" + pending.adu + b"\x00\x01" + rtu_frame(UNIT, ANSWER)
    assert result(pending, line) == ANSWER
    assert pending.echo is Echo.PRESENT
    assert pending.leftover == b"\x01\x2b\xff\x00\x01"


@pytest.mark.parametrize("pdu", ["AB 84 02", "AB 02"])
@pytest.mark.parametrize("echo", Echo)
@pytest.mark.parametrize("noise", ["", "00", "01", "01 AB", "01 AB 84"])
def test_both_exceptions(pdu: str, echo: Echo, noise: str) -> None:
    octets = bytes.fromhex(pdu)
    for before in (b"", rtu_frame(UNIT, READ.pdu)):
        pending = RtuExchange(UNIT, READ, echo)
        line = bytes.fromhex(noise) + before + rtu_frame(UNIT, octets)
        assert result(pending, line) == octets
        with pytest.raises(ExceptionAnswer, match="exception 2 "):
            check_answer(READ, octets)


def test_an_exception_that_begins_with_a_whole_shorter_one() -> None:
    """For each unit and MEI type there is one code; none of the standard ones among them."""
    traps = 0
    for unit in range(1, 248):
        for mei in Mei:
            code = crc16(bytes([unit, 0xAB, mei])) & 0xFF
            frame = rtu_frame(unit, bytes([0xAB, mei, code]))
            assert crc16(frame[:3]).to_bytes(2, "little") == frame[3:5]
            pending = RtuExchange(unit, ReadStamped(mei, 8, 2), Echo.ABSENT)
            assert heard(pending, frame) == [None] * 5 + [frame[1:4]]
            assert pending.leftover == b""
            traps += code > 11
    assert traps == 247 * 4


@pytest.mark.parametrize("mei", Mei)
def test_the_mei_type_as_a_code_is_understood_once_nothing_follows(mei: Mei) -> None:
    request = ReadStamped(mei, 8, 2)
    pending = RtuExchange(UNIT, request, Echo.ABSENT)
    pdu = bytes([0xAB, mei])
    assert heard(pending, rtu_frame(UNIT, pdu)) == [None] * 5
    assert pending.conclude() == pdu
    with pytest.raises(ExceptionAnswer, match="not a standard code") as caught:
        check_answer(request, pdu)
    assert caught.value.code == mei


@pytest.mark.parametrize(
    "pdu",
    [
        pytest.param("AB 94 02", id="exception of another MEI type"),
        pytest.param("84 02", id="exception of another function"),
        pytest.param("2B 94 0C" + "00" * 12, id="another MEI type"),
        pytest.param("2B 84 13" + "00" * 18, id="another byte count"),
    ],
)
def test_strangers(pdu: str) -> None:
    pending = RtuExchange(UNIT, READ, Echo.ABSENT)
    assert result(pending, rtu_frame(UNIT, bytes.fromhex(pdu))) is None
    assert pending.intact_stranger


def test_no_echo_passes_for_an_answer() -> None:
    """The address stands where the answer has its byte counts; no answer is as short as that."""
    for mei in Mei:
        for count in (1, mei.most):
            head = ReadStamped(mei, 0, count).head
            address = int.from_bytes((head + b"\0")[2:4])
            for low in range(256) if not mei.is_discrete else [address & 0xFF]:
                request = ReadStamped(mei, address & 0xFF00 | low, count)
                pending = RtuExchange(UNIT, request, Echo.UNKNOWN)
                assert result(pending, pending.adu) is None
                assert pending.echo is Echo.PRESENT
                assert request.answer_size > len(request.pdu)


@st.composite
def conversations(draw: st.DrawFn) -> tuple[int, ReadStamped, bytes]:
    """A unit, a request and the PDU of an answer to it."""
    mei = draw(st.sampled_from(Mei))
    count = draw(st.integers(1, mei.most))
    request = ReadStamped(mei, draw(st.integers(0, 0xFF00)), count)
    code = draw(st.integers(0, 255))
    rest = request.answer_size - len(request.head)
    answer = draw(
        st.one_of(
            st.just(bytes([0xAB, mei, code])),
            st.just(bytes([0xAB, code])),
            st.binary(min_size=rest, max_size=rest).map(lambda octets: request.head + octets),
        )
    )
    return draw(st.integers(1, 247)), request, answer


@st.composite
def lines(draw: st.DrawFn) -> tuple[int, ReadStamped, bytes]:
    """Octets made of pieces of the request and its answer, whole, cut and bent, and of noise."""
    unit, request, pdu = draw(conversations())
    whole = [rtu_frame(unit, request.pdu), rtu_frame(unit, pdu), rtu_frame(unit, request.head)]
    pieces = [
        piece[draw(st.integers(0, 4)) : len(piece) - draw(st.integers(0, 4))]
        for piece in draw(st.lists(st.sampled_from(whole), max_size=4))
    ]
    pieces += draw(st.lists(st.one_of(st.sampled_from(whole), st.binary(max_size=12)), max_size=3))
    return unit, request, b"".join(draw(st.permutations(pieces)))


def cut(octets: bytes, cuts: Iterable[int]) -> list[bytes]:
    edges = [0, *sorted(at % (len(octets) + 1) for at in cuts), len(octets)]
    return [octets[a:b] for a, b in pairwise(edges)]


@PROPERTY
@given(lines(), st.sampled_from(Echo), st.lists(st.integers(0, 2000), max_size=12))
def test_any_cut_gives_the_same_result_and_it_answers_the_request(
    line: tuple[int, ReadStamped, bytes], echo: Echo, cuts: list[int]
) -> None:
    unit, request, octets = line
    expected = result(RtuExchange(unit, request, echo), octets)
    pending = RtuExchange(unit, request, echo)
    found = None
    for piece in cut(octets, cuts):
        found = pending.feed(piece)
        if found is not None:
            break
    assert (pending.conclude() if found is None else found) == expected
    assert expected is None or expected in candidates(octets, unit, request)


@PROPERTY
@given(conversations(), st.binary(max_size=40), st.booleans())
def test_garbage_before_an_answer_does_not_hide_it(
    conversation: tuple[int, ReadStamped, bytes], before: bytes, echoing: bool
) -> None:
    unit, request, pdu = conversation
    echo = rtu_frame(unit, request.pdu) if echoing else b""
    octets = before + echo + rtu_frame(unit, pdu)
    found = result(RtuExchange(unit, request, Echo.UNKNOWN), octets)
    assert found == pdu or len(candidates(octets, unit, request)) > 1

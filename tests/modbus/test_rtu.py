"""The hunt for one answer on a line that carries other things as well.

Promises: any cutting of the octets gives the same result; garbage before an answer does not hide
it; what is returned always answers the request; an echo never passes for an answer.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from wire import crc16, rtu_frame

from roclog.modbus import rtu
from roclog.modbus.request import ReadRegisters, Request, WriteRegister
from roclog.modbus.rtu import Echo, RtuExchange

if TYPE_CHECKING:
    from collections.abc import Iterable

UNIT = 138
READ = ReadRegisters(3, 300, 27)
ANSWER = bytes([3, 54]) + bytes(range(54))
WRITE = WriteRegister(300, 0)
PROPERTY = settings(derandomize=True, deadline=None, max_examples=300)


def result(pending: RtuExchange, octets: bytes, cuts: Iterable[int] = ()) -> bytes | None:
    """What the exchange makes of the octets, cut as told, and of the silence after them."""
    edges = [0, *sorted(cut % (len(octets) + 1) for cut in cuts), len(octets)]
    for start, end in pairwise(edges):
        pdu = pending.feed(octets[start:end])
        if pdu is not None:
            return pdu
    return pending.conclude()


def one_by_one(pending: RtuExchange, octets: bytes) -> bytes | None:
    return result(pending, octets, range(len(octets)))


def frames_in(octets: bytes, unit: int, request: Request) -> list[bytes]:
    """By brute force: the PDU of everything in there that answers the request."""
    function = request.pdu[0]
    found = []
    for start in range(len(octets)):
        for size in (5, 3 + request.answer_size):
            frame = octets[start : start + size]
            if len(frame) < size or crc16(frame[:-2]).to_bytes(2, "little") != frame[-2:]:
                continue
            refusal = size == 5 and frame.startswith(bytes([unit, function | 0x80]))
            if refusal or frame.startswith(bytes([unit]) + request.head):
                found.append(frame[1:-2])
    return found


@pytest.mark.parametrize("echo", Echo)
def test_read_answered(echo: Echo) -> None:
    pending = RtuExchange(UNIT, READ, echo)
    assert pending.adu == bytes.fromhex("8A 03 01 2C 00 1B DB 4F")
    assert pending.feed(rtu_frame(UNIT, ANSWER)) == ANSWER
    assert pending.leftover == b""
    assert pending.echo is Echo.ABSENT


@pytest.mark.parametrize("request_", [READ, WRITE])
def test_refused(request_: Request) -> None:
    pdu = bytes([request_.pdu[0] | 0x80, 2])
    pending = RtuExchange(UNIT, request_, Echo.ABSENT)
    assert one_by_one(pending, rtu_frame(UNIT, pdu)) == pdu


def test_write_answered_on_a_line_without_echo() -> None:
    pending = RtuExchange(UNIT, WRITE, Echo.ABSENT)
    assert pending.feed(pending.adu) == WRITE.pdu


@pytest.mark.parametrize("echo", [Echo.PRESENT, Echo.UNKNOWN])
def test_only_the_second_copy_answers_a_write_unless_the_line_is_known_not_to_echo(
    echo: Echo,
) -> None:
    pending = RtuExchange(UNIT, WRITE, echo)
    assert one_by_one(pending, pending.adu) is None
    assert pending.feed(pending.adu) == WRITE.pdu
    assert pending.echo is Echo.PRESENT
    assert pending.leftover == b""


def test_a_write_refused_behind_its_echo() -> None:
    pending = RtuExchange(UNIT, WRITE, Echo.PRESENT)
    assert one_by_one(pending, pending.adu + rtu_frame(UNIT, b"\x86\x03")) == b"\x86\x03"


@pytest.mark.parametrize("echo", Echo)
def test_a_read_behind_its_echo(echo: Echo) -> None:
    pending = RtuExchange(UNIT, READ, echo)
    assert one_by_one(pending, pending.adu + rtu_frame(UNIT, ANSWER)) == ANSWER
    assert pending.echo is Echo.PRESENT
    assert pending.leftover == b""


def test_the_echo_is_learnt_even_if_the_device_is_dead() -> None:
    pending = RtuExchange(UNIT, READ, Echo.UNKNOWN)
    assert one_by_one(pending, pending.adu) is None
    assert pending.echo is Echo.PRESENT
    assert pending.leftover == b""


def test_a_line_that_stopped_echoing_is_noticed() -> None:
    pending = RtuExchange(UNIT, READ, Echo.PRESENT)
    assert pending.feed(rtu_frame(UNIT, ANSWER)) == ANSWER
    assert pending.echo is Echo.ABSENT


def test_a_glitch_before_the_answer_is_not_an_echo() -> None:
    pending = RtuExchange(UNIT, READ, Echo.UNKNOWN)
    assert pending.feed(b"\x00\xff\x00" + rtu_frame(UNIT, ANSWER)) == ANSWER
    assert pending.echo is Echo.ABSENT


def test_a_damaged_echo_teaches_nothing() -> None:
    pending = RtuExchange(UNIT, READ, Echo.UNKNOWN)
    echo = bytearray(pending.adu)
    echo[3] ^= 4
    assert pending.feed(bytes(echo) + rtu_frame(UNIT, ANSWER)) == ANSWER
    assert pending.echo is Echo.UNKNOWN


@pytest.mark.parametrize("function", [3, 4])
def test_no_echo_passes_for_an_answer(function: int) -> None:
    # The high octet of the address stands where an answer has its byte count. With 2 there and one
    # register asked, the first seven octets of some requests are a whole answer, checksum included.
    traps = 0
    for address in range(512, 1024):
        for unit in range(1, 248):
            body = bytes([unit, function, address >> 8, address & 0xFF, 0])
            if crc16(body) & 0xFF != 1:
                continue
            pending = RtuExchange(unit, ReadRegisters(function, address, 1), Echo.UNKNOWN)
            traps += bool(frames_in(pending.adu, unit, ReadRegisters(function, address, 1)))
            assert [pending.feed(bytes([octet])) for octet in pending.adu] == [None] * 8
            assert pending.conclude() is None
            assert pending.echo is Echo.PRESENT
    assert traps > 200


@pytest.mark.parametrize("count", [1, 2, 3, 27])
def test_no_echo_of_an_address_that_looks_like_a_byte_count(count: int) -> None:
    for address in range(256 * 2 * count, 256 * 2 * count + 256):
        request = ReadRegisters(3, address, count)
        for echo in Echo:
            pending = RtuExchange(UNIT, request, echo)
            assert one_by_one(pending, pending.adu) is None


def test_an_answer_that_could_be_the_beginning_of_the_echo_counts_once_nothing_follows() -> None:
    for unit in range(1, 248):
        request = ReadRegisters(3, 512, 1)
        pending = RtuExchange(unit, request, Echo.UNKNOWN)
        answer = rtu_frame(unit, bytes.fromhex("03 02 00 00"))
        if not pending.adu.startswith(answer):
            continue
        assert [pending.feed(bytes([octet])) for octet in answer] == [None] * 7
        assert pending.conclude() == answer[1:-2]
        return
    pytest.fail("there is such a unit")


def test_strangers_are_told_from_noise() -> None:
    other_unit = rtu_frame(7, ANSWER)
    other_count = rtu_frame(UNIT, b"\x03\x04\x12\x34\x56\x78")
    other_function = rtu_frame(UNIT, b"\x84\x02")
    for frame in (other_unit, other_count, other_function):
        pending = RtuExchange(UNIT, READ, Echo.ABSENT)
        assert one_by_one(pending, frame) is None
        assert pending.intact_stranger
        assert pending.leftover == frame
    noise = RtuExchange(UNIT, READ, Echo.ABSENT)
    assert one_by_one(noise, other_unit[:-1]) is None
    assert not noise.intact_stranger


def test_a_write_to_another_address_or_value_is_no_answer() -> None:
    for pdu in (WriteRegister(301, 0).pdu, WriteRegister(300, 1).pdu):
        pending = RtuExchange(UNIT, WRITE, Echo.ABSENT)
        assert one_by_one(pending, rtu_frame(UNIT, pdu)) is None
        assert pending.intact_stranger


def test_a_damaged_answer_does_not_end_the_wait() -> None:
    # A damaged echo of this request has the head and the length of its answer. To give up on it
    # would let the answer that still comes pass for the answer to the next request.
    request = ReadRegisters(3, 0x0201, 1)
    pending = RtuExchange(UNIT, request, Echo.UNKNOWN)
    echo = bytearray(pending.adu)
    echo[-1] ^= 1
    assert pending.feed(bytes(echo)) is None
    answer = rtu_frame(UNIT, bytes.fromhex("03 02 12 34"))
    assert pending.feed(answer) == answer[1:-2]


def test_noise_that_looks_like_a_head_does_not_hide_the_answer() -> None:
    pending = RtuExchange(UNIT, READ, Echo.ABSENT)
    head = bytes([UNIT, 3, 54])
    assert one_by_one(pending, head * 5 + rtu_frame(UNIT, ANSWER)) == ANSWER
    assert pending.leftover == head * 5


def test_a_refusal_inside_an_answer_is_data() -> None:
    data = rtu_frame(UNIT, b"\x83\x02")
    answer = bytes([3, 54]) + data + bytes(54 - len(data))
    assert one_by_one(RtuExchange(UNIT, READ, Echo.ABSENT), rtu_frame(UNIT, answer)) == answer


def test_a_refusal_behind_a_false_head_is_found_once_nothing_follows() -> None:
    pending = RtuExchange(UNIT, READ, Echo.ABSENT)
    octets = bytes([UNIT, 3, 54]) + rtu_frame(UNIT, b"\x83\x02")
    assert pending.feed(octets) is None
    assert pending.conclude() == b"\x83\x02"


requests = st.one_of(
    st.builds(ReadRegisters, st.sampled_from([3, 4]), st.integers(0, 0xFF00), st.integers(1, 125)),
    st.builds(WriteRegister, st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)),
)


@st.composite
def conversations(draw: st.DrawFn) -> tuple[int, Request, bytes]:
    """A unit, a request, and the PDU of an answer to it."""
    unit = draw(st.integers(1, 247))
    request = draw(requests)
    if draw(st.booleans()):
        return unit, request, bytes([request.pdu[0] | 0x80, draw(st.integers(0, 255))])
    rest = request.answer_size - len(request.head)
    return unit, request, request.head + draw(st.binary(min_size=rest, max_size=rest))


@st.composite
def lines(draw: st.DrawFn) -> tuple[int, Request, bytes]:
    """Octets made of pieces of the request and its answer, whole, cut and bent, and of noise."""
    unit, request, pdu = draw(conversations())
    whole = [rtu_frame(unit, request.pdu), rtu_frame(unit, pdu), rtu_frame(unit, request.head)]
    pieces = [
        piece[draw(st.integers(0, 4)) : len(piece) - draw(st.integers(0, 4))]
        for piece in draw(st.lists(st.sampled_from(whole), max_size=4))
    ]
    pieces += draw(st.lists(st.one_of(st.sampled_from(whole), st.binary(max_size=12)), max_size=3))
    return unit, request, b"".join(draw(st.permutations(pieces)))


@PROPERTY
@given(lines(), st.sampled_from(Echo), st.lists(st.integers(0, 2000), max_size=12))
def test_any_cut_gives_the_same_result(
    line: tuple[int, Request, bytes], echo: Echo, cuts: list[int]
) -> None:
    unit, request, octets = line
    at_once = RtuExchange(unit, request, echo)
    expected = result(at_once, octets)
    cut, single = RtuExchange(unit, request, echo), RtuExchange(unit, request, echo)
    assert result(cut, octets, cuts) == expected
    assert one_by_one(single, octets) == expected
    assert at_once.echo is cut.echo is single.echo


@PROPERTY
@given(lines(), st.sampled_from(Echo))
def test_what_is_returned_answers_the_request(line: tuple[int, Request, bytes], echo: Echo) -> None:
    unit, request, octets = line
    found = one_by_one(RtuExchange(unit, request, echo), octets)
    assert found is None or found in frames_in(octets, unit, request)


@PROPERTY
@given(conversations(), st.binary(max_size=80), st.binary(max_size=20), st.booleans())
@example((UNIT, READ, ANSWER), bytes([UNIT, 3, 54]), b"", True)
@example((UNIT, READ, ANSWER), bytes([UNIT, 0x83, 2]), b"", True)
@example((UNIT, READ, b"\x83\x02"), bytes([UNIT, 3, 54]), b"", False)
@example((UNIT, WRITE, WRITE.pdu), bytes([UNIT, 6, 1]), b"", False)
def test_garbage_before_an_answer_does_not_hide_it(
    conversation: tuple[int, Request, bytes],
    before: bytes,
    after: bytes,
    echoing: bool,
) -> None:
    unit, request, pdu = conversation
    echo = rtu_frame(unit, request.pdu) if echoing else b""
    octets = before + echo + rtu_frame(unit, pdu) + after
    copies = (
        2
        if echoing and pdu == request.pdu
        else 1 + (echoing and isinstance(request, WriteRegister))
    )
    assume(len(frames_in(octets, unit, request)) == copies)
    pending = RtuExchange(unit, request, Echo.PRESENT if echoing else Echo.ABSENT)
    assert one_by_one(pending, octets) == pdu


def test_the_checksum_is_computed_once_for_each_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def counting(octets: bytes) -> bytes:
        calls.append(octets)
        return crc16(octets).to_bytes(2, "little")

    monkeypatch.setattr(rtu, "crc", counting)
    pending = RtuExchange(UNIT, READ, Echo.ABSENT)
    calls.clear()
    assert one_by_one(pending, bytes([UNIT]) * 50 + rtu_frame(UNIT, ANSWER)) == ANSWER
    assert len(calls) == 1
    pending = RtuExchange(UNIT, READ, Echo.ABSENT)
    calls.clear()
    assert one_by_one(pending, bytes([UNIT, 3, 54]) * 1000) is None
    assert len(calls) <= 1000

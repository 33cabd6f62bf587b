"""Frames of a TCP connection, however the network cuts and joins them."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire import mbap_frame

from roclog.errors import LinkDown, WrongAnswer
from roclog.modbus.mbap import DatagramExchange, MbapExchange, MbapStream, whole_frame
from roclog.modbus.request import ReadRegisters

READ = ReadRegisters(3, 300, 2)
ANSWER = bytes.fromhex("03 04 12 34 56 78")


def exchange(transaction: int = 7, unit: int = 1, stream: MbapStream | None = None) -> MbapExchange:
    return MbapExchange(unit, READ, transaction, stream or MbapStream())


def feed_all(pending: MbapExchange, octets: bytes, cuts: list[int]) -> bytes | None:
    edges = [0, *sorted(cut % (len(octets) + 1) for cut in cuts), len(octets)]
    for start, end in pairwise(edges):
        pdu = pending.feed(octets[start:end])
        if pdu is not None:
            return pdu
    return None


@pytest.mark.parametrize("transaction", [1, 0x1234, 0xFFFF])
@pytest.mark.parametrize("unit", [0, 1, 138, 255])
def test_requests(transaction: int, unit: int) -> None:
    assert exchange(transaction, unit).adu == mbap_frame(transaction, unit, READ.pdu)


def test_one_octet_in_a_segment() -> None:
    pending = exchange()
    frame = mbap_frame(7, 1, ANSWER)
    assert [pending.feed(bytes([octet])) for octet in frame] == [None] * (len(frame) - 1) + [ANSWER]


def test_late_answers_are_skipped_and_counted() -> None:
    pending = exchange()
    late = mbap_frame(5, 1, bytes.fromhex("03 04 00 00 00 00")) + mbap_frame(6, 2, b"\x83\x02")
    assert pending.feed(late + mbap_frame(7, 1, ANSWER)) == ANSWER
    assert pending.stale == 2


def test_two_answers_in_one_segment_leave_the_second_in_the_stream() -> None:
    stream = MbapStream()
    second = bytes.fromhex("03 04 AA AA BB BB")
    both = mbap_frame(7, 1, ANSWER) + mbap_frame(8, 1, second)
    assert exchange(7, stream=stream).feed(both) == ANSWER
    assert exchange(8, stream=stream).feed(b"") == second


@pytest.mark.parametrize("cut", range(1, 13))
def test_a_late_answer_may_end_in_the_next_exchange(cut: int) -> None:
    stream = MbapStream()
    late = mbap_frame(6, 1, bytes.fromhex("03 04 00 00 00 00"))
    assert exchange(7, stream=stream).feed(mbap_frame(7, 1, ANSWER) + late[:cut]) == ANSWER
    following = exchange(8, stream=stream)
    assert following.feed(late[cut:]) is None
    assert following.feed(mbap_frame(8, 1, ANSWER)) == ANSWER
    assert following.stale == 1


def test_another_unit_is_a_wrong_answer() -> None:
    with pytest.raises(WrongAnswer, match="asked unit 1, unit 2 answered"):
        exchange().feed(mbap_frame(7, 2, ANSWER))


def test_broken_is_not_the_same_as_more_to_come() -> None:
    frame = bytearray(mbap_frame(7, 1, ANSWER))
    assert exchange().feed(bytes(frame[:-1])) is None
    frame[2] = 1
    with pytest.raises(LinkDown, match="not a Modbus TCP stream"):
        exchange().feed(bytes(frame))


@pytest.mark.parametrize(("length", "sane"), [(0, 0), (1, 0), (2, 0), (3, 1), (254, 1), (255, 0)])
def test_lengths(length: int, *, sane: bool) -> None:
    pending = exchange()
    header = bytes.fromhex("00 06 00 00") + length.to_bytes(2) + b"\x01"
    if sane:
        assert pending.feed(header + bytes(length - 1)) is None
        assert pending.stale == 1
    else:
        with pytest.raises(LinkDown):
            pending.feed(header)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    st.lists(
        st.tuples(st.integers(0, 0xFFFF), st.integers(0, 255), st.binary(min_size=2, max_size=253)),
        max_size=4,
    ),
    st.lists(st.integers(0, 10_000), max_size=8),
)
def test_any_cut_gives_the_same_answer(
    others: list[tuple[int, int, bytes]], cuts: list[int]
) -> None:
    before = [mbap_frame(*other) for other in others if other[0] != 7]
    pending = exchange()
    assert feed_all(pending, b"".join(before) + mbap_frame(7, 1, ANSWER), cuts) == ANSWER
    assert pending.stale == len(before)


@settings(derandomize=True, deadline=None, max_examples=500)
@given(st.binary(max_size=300), st.lists(st.integers(0, 300), max_size=4))
def test_garbage_ends_in_a_documented_error_or_waits(octets: bytes, cuts: list[int]) -> None:
    with suppress(LinkDown, WrongAnswer):
        feed_all(exchange(), octets, cuts)


def test_a_datagram_is_one_answer_or_wrong() -> None:
    whole = mbap_frame(7, 1, ANSWER)
    request = ReadRegisters(3, 300, 2)
    assert DatagramExchange(1, request, 7).adu == MbapExchange(1, request, 7, MbapStream()).adu
    assert DatagramExchange(1, request, 7).feed(whole) == ANSWER
    for octets in (b"", whole[:1], whole[:-1], whole + b"\0", whole + whole):
        assert whole_frame(octets) is None
        with pytest.raises(WrongAnswer, match="not one answer"):
            DatagramExchange(1, request, 7).feed(octets)
    with pytest.raises(WrongAnswer, match="unit 2 answered"):
        DatagramExchange(1, request, 7).feed(mbap_frame(7, 2, ANSWER))


def test_datagrams_of_another_number_are_dropped_whole_or_not() -> None:
    pending = DatagramExchange(1, ReadRegisters(3, 300, 2), 7)
    for octets in (mbap_frame(6, 1, ANSWER), mbap_frame(6, 1, ANSWER)[:-2], b"\0\6"):
        assert pending.feed(octets) is None
    assert pending.stale == 3
    assert pending.feed(mbap_frame(7, 1, ANSWER)) == ANSWER


@settings(derandomize=True, deadline=None, max_examples=500)
@given(st.lists(st.binary(max_size=300), max_size=4))
def test_any_datagrams_end_in_a_wrong_answer_or_wait(datagrams: list[bytes]) -> None:
    pending = DatagramExchange(1, ReadRegisters(3, 300, 2), 7)
    with suppress(WrongAnswer):
        for octets in datagrams:
            pending.feed(octets)

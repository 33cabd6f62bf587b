"""Functions 1 and 2 against the examples of V1.1b3 sections 6.1 and 6.2."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadDiscreteInputsRequest

from roclog.errors import ExceptionAnswer, WrongAnswer
from roclog.modbus.bits import ReadBits, pack_bits, unpack_bits
from roclog.modbus.request import check_answer


@pytest.mark.parametrize(
    ("request_", "pdu", "answer", "on"),
    [
        # 6.1: coils 20 to 38
        (
            ReadBits(1, 19, 19),
            "01 00 13 00 13",
            "01 03 CD 6B 05",
            [20, 22, 23, 26, 27, 28, 29, 31, 33, 34, 36, 38],
        ),
        # 6.2: inputs 197 to 218
        (
            ReadBits(2, 196, 22),
            "02 00 C4 00 16",
            "02 03 AC DB 35",
            [199, 200, 202, 204, 205, 206, 208, 209, 211, 212, 213, 215, 217, 218],
        ),
    ],
)
def test_the_examples_of_the_specification(
    request_: ReadBits, pdu: str, answer: str, on: list[int]
) -> None:
    octets = bytes.fromhex(answer)
    assert request_.pdu == bytes.fromhex(pdu)
    check_answer(request_, octets)
    bits = unpack_bits(octets[2:], request_.count)
    assert [request_.address + 1 + n for n, bit in enumerate(bits) if bit] == on
    assert pack_bits(bits) == octets[2:]


@given(st.integers(1, 2000), st.integers(0, 0xFFFF))
def test_another_encoder_says_the_same(count: int, address: int) -> None:
    address = min(address, 0x10000 - count)
    for function, kind in ((1, ReadCoilsRequest), (2, ReadDiscreteInputsRequest)):
        encoded = kind(address=address, count=count).encode()
        assert ReadBits(function, address, count).pdu == bytes([function]) + encoded


@pytest.mark.parametrize(
    ("function", "address", "count"),
    [(3, 0, 1), (0, 0, 1), (1, 0, 0), (1, 0, 2001), (2, -1, 1), (1, 65535, 2)],
)
def test_what_cannot_be_asked(function: int, address: int, count: int) -> None:
    with pytest.raises(ValueError):
        ReadBits(function, address, count)


def test_answers_that_do_not_fit() -> None:
    request = ReadBits(1, 0, 9)
    for answer in ("01 01 FF", "01 03 FF 01 00", "02 02 FF 01", "01 02 FF", "01 01 FF 01"):
        with pytest.raises(WrongAnswer):
            check_answer(request, bytes.fromhex(answer))
    with pytest.raises(ExceptionAnswer):
        check_answer(request, bytes.fromhex("81 02"))


def test_spare_bits_say_nothing() -> None:
    assert unpack_bits(b"\x01\xfe", 9) == (1, 0, 0, 0, 0, 0, 0, 0, 0)
    for octets in (b"\x01", b"\x01\0\0"):
        with pytest.raises(ValueError, match="9 bits are not in"):
            unpack_bits(octets, 9)


@given(st.lists(st.integers(0, 1), max_size=50))
def test_packing_is_undone(bits: list[int]) -> None:
    assert unpack_bits(pack_bits(bits), len(bits)) == tuple(bits)

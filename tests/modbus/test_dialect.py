"""The MSX-E's octets: both byte orders, both sizes of the byte count, and what is no answer."""

from __future__ import annotations

import tomllib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.errors import ExceptionAnswer, LinkDown, WrongAnswer
from roclog.modbus.dialect import MSX_E, STANDARD, Dialect
from roclog.modbus.functions import (
    STATUS_REGISTER,
    CommandStatus,
    ReadFunction,
    ReadWriteFunction,
    WriteFunction,
    command_status,
    status_request,
)
from roclog.modbus.mbap import DatagramExchange, MbapExchange, MbapStream, whole_frame
from roclog.modbus.request import ReadRegisters, Request, check_answer

FOLDER = Path(__file__).parents[1] / "vectors/msx"
FUNCTIONS = tomllib.loads((FOLDER / "functions.toml").read_text(encoding="utf-8"))["function"]
FRAMES = tomllib.loads((FOLDER / "frames.toml").read_text(encoding="utf-8"))
DIALECTS = {"big": MSX_E, "little": replace(MSX_E, order="little")}

both_orders = pytest.mark.parametrize("order", DIALECTS)
every_function = pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f["name"])


def frames(kind: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        "vector", FRAMES[kind], ids=lambda v: f"{v['order']}-{v['source'][:50]}"
    )


def octets(vector: dict[str, Any], key: str) -> bytes:
    return bytes.fromhex(vector[key])


def exchange(request: Request, dialect: Dialect, unit: int, number: int = 0) -> MbapExchange:
    return MbapExchange(unit, request, number, MbapStream(dialect))


def datagram(request: Request, dialect: Dialect, unit: int, number: int = 0) -> DatagramExchange:
    return DatagramExchange(unit, request, number, dialect)


both_exchanges = pytest.mark.parametrize("make", [exchange, datagram], ids=["stream", "datagram"])


@every_function
@both_orders
@both_exchanges
def test_every_function_of_the_document(function: dict[str, Any], order: str, make: Any) -> None:
    dialect = DIALECTS[order]
    request = ReadFunction(function["register"], function["words"], dialect=dialect)
    pending = make(request, dialect, 1)
    assert pending.adu == bytes.fromhex(function["query"][order])
    payload = bytes(k % 251 + 1 for k in range(function["count"]))
    frame = bytes.fromhex(function["answer"][order]) + payload
    assert len(frame) == 6 + function["length"]
    pdu = pending.feed(frame)
    assert pdu is not None
    check_answer(request, pdu)
    assert request.payload(pdu) == payload


@every_function
@both_orders
@both_exchanges
@pytest.mark.parametrize("code", [1, 2, 3, 4, 6, 7, 9])
def test_every_function_refused(function: dict[str, Any], order: str, make: Any, code: int) -> None:
    dialect = DIALECTS[order]
    request = ReadFunction(function["register"], function["words"], dialect=dialect)
    frame = bytes.fromhex(function["refusal"][order]) + bytes([code])
    pdu = make(request, dialect, 1).feed(frame)
    assert pdu is not None
    with pytest.raises(ExceptionAnswer) as refused:
        check_answer(request, pdu)
    assert (refused.value.function, refused.value.code) == (3, code)


@frames("read")
@both_exchanges
def test_reads(vector: dict[str, Any], make: Any) -> None:
    dialect = DIALECTS[vector["order"]]
    size = vector.get("payload_octets")
    request = ReadFunction(vector["register"], vector["words"], size, dialect)
    pending = make(request, dialect, 0)
    assert pending.adu == octets(vector, "query")
    pdu = pending.feed(octets(vector, "answer"))
    assert pdu is not None
    check_answer(request, pdu)
    assert request.payload(pdu) == octets(vector, "payload")


def test_an_odd_payload_is_accepted_where_it_is_declared() -> None:
    vector = next(vector for vector in FRAMES["read"] if "payload_octets" in vector)
    undeclared = ReadFunction(vector["register"], vector["words"])
    pdu = exchange(undeclared, MSX_E, 0).feed(octets(vector, "answer"))
    assert pdu is not None
    with pytest.raises(WrongAnswer, match="135 octets instead of 134"):
        check_answer(undeclared, pdu)


@frames("write")
def test_writes(vector: dict[str, Any]) -> None:
    dialect = DIALECTS[vector["order"]]
    request = WriteFunction(vector["register"], octets(vector, "parameters"), dialect)
    assert request.pdu == octets(vector, "query")
    answer = octets(vector, "answer")
    check_answer(request, answer)
    for index in range(1, len(answer)):
        bent = bytearray(answer)
        bent[index] ^= 1
        with pytest.raises(WrongAnswer):
            check_answer(request, bytes(bent))


@frames("read_write")
def test_reads_with_parameters(vector: dict[str, Any]) -> None:
    dialect = DIALECTS[vector["order"]]
    request = ReadWriteFunction(
        vector["register"],
        vector["words"],
        vector["write_register"],
        octets(vector, "parameters"),
        dialect,
    )
    assert request.pdu == octets(vector, "query")
    check_answer(request, octets(vector, "answer"))
    assert request.payload(octets(vector, "answer")) == octets(vector, "payload")
    half = len(request.head) + vector["words"]
    with pytest.raises(WrongAnswer):
        check_answer(request, octets(vector, "answer")[:half])


@frames("wrong")
@both_exchanges
def test_intact_frames_that_are_no_answer(vector: dict[str, Any], make: Any) -> None:
    dialect = DIALECTS[vector["order"]]
    request = ReadFunction(vector["register"], 4, dialect=dialect)

    def ask() -> None:
        pdu = make(request, dialect, 0).feed(octets(vector, "answer"))
        assert pdu is not None
        check_answer(request, pdu)

    with pytest.raises(WrongAnswer) as wrong:
        ask()
    assert vector["says"] in str(wrong.value)
    assert wrong.value.raw == octets(vector, "answer")[7:]


@both_orders
@pytest.mark.parametrize(("register", "other"), [(2, 10500), (999, 1000)])
@pytest.mark.parametrize("words", [1, 2, 64, 125])
def test_the_other_size_is_told_for_any_length(
    order: str, register: int, other: int, words: int
) -> None:
    dialect = DIALECTS[order]
    for asked, answered in ((register, other), (other, register)):
        request = ReadFunction(asked, words, dialect=dialect)
        answer = ReadFunction(answered, words, dialect=dialect).head + bytes(2 * words)
        with pytest.raises(WrongAnswer, match=f"register {asked} of this device has"):
            dialect.check_count_size(request.pdu, answer)
        dialect.check_count_size(request.pdu, request.head + bytes(2 * words))
        dialect.check_count_size(request.pdu, b"\x83\x09")


def test_a_standard_read_of_a_new_function_is_the_same() -> None:
    for function in FUNCTIONS:
        if function["register"] >= 1000:
            same = ReadRegisters(3, function["register"], function["words"])
            request = ReadFunction(function["register"], function["words"])
            assert (same.pdu, same.head, same.answer_size) == (
                request.pdu,
                request.head,
                request.answer_size,
            )


@frames("status")
def test_statuses(vector: dict[str, Any]) -> None:
    payload = octets(vector, "payload").ljust(108, b"\0")
    status = command_status(payload, DIALECTS[vector["order"]])
    assert status == CommandStatus(vector["return_value"], vector["errno"], vector["text"])


def test_a_status_is_asked_and_told() -> None:
    assert (status_request().register, status_request().words) == (STATUS_REGISTER, 54)
    assert str(CommandStatus(-100, 22, "Invalid argument")) == (
        "returned -100, errno 22: Invalid argument"
    )
    assert str(CommandStatus(3, 0, "")) == "returned 3"
    assert command_status(bytes(8) + b"x" * 100).text == "x" * 100
    with pytest.raises(ValueError, match="108 octets, not 107"):
        command_status(bytes(107))


@pytest.mark.parametrize(
    ("register", "words", "size"),
    [(-1, 1, None), (0x10000, 1, None), (0, 0, None), (0, 126, None), (9, 66, 131), (9, 66, 134)],
)
def test_functions_that_cannot_be_called(register: int, words: int, size: int | None) -> None:
    with pytest.raises(ValueError):
        ReadFunction(register, words, size)


@pytest.mark.parametrize(
    ("register", "parameters"), [(0x10000, b"\0\0"), (1, b""), (1, b"\0\0\0"), (1, bytes(202))]
)
def test_parameters_that_cannot_be_sent(register: int, parameters: bytes) -> None:
    with pytest.raises(ValueError):
        WriteFunction(register, parameters)
    with pytest.raises(ValueError):
        ReadWriteFunction(10500, 4, register, parameters)


@pytest.mark.parametrize("order", DIALECTS)
def test_the_longest_calls_fit(order: str) -> None:
    dialect = DIALECTS[order]
    assert len(WriteFunction(999, bytes(200), dialect).pdu) == 207
    assert len(ReadWriteFunction(1, 1, 999, bytes(200), dialect).pdu) == 211
    longest = ReadFunction(999, 125, 251, dialect)
    assert longest.answer_size == 254 <= dialect.max_pdu


@pytest.mark.parametrize(("length", "sane"), [(2, 0), (3, 1), (254, 1), (259, 1), (260, 0)])
@both_orders
def test_lengths(order: str, length: int, *, sane: bool) -> None:
    stream = MbapStream(DIALECTS[order])
    stream.receive(bytes(4) + length.to_bytes(2, DIALECTS[order].order) + b"\0" + bytes(length - 1))
    if sane:
        frame = stream.next_frame()
        assert frame is not None
        assert len(frame.pdu) == length - 1
    else:
        with pytest.raises(LinkDown):
            stream.next_frame()


@both_orders
def test_numbers_of_other_requests_are_skipped(order: str) -> None:
    dialect = DIALECTS[order]
    request = ReadFunction(10500, 4, dialect=dialect)
    answer = request.head + bytes(8)

    def frame(number: int) -> bytes:
        fields = (number.to_bytes(2, dialect.order), bytes(2), (11).to_bytes(2, dialect.order))
        return b"".join(fields) + b"\1" + answer

    for make in (exchange, datagram):
        pending = make(request, dialect, 1, 0x1234)
        assert pending.adu[:2] == (0x1234).to_bytes(2, dialect.order)
        assert pending.feed(frame(0x3412)) is None
        assert pending.stale == 1
        assert pending.feed(frame(0x1234)) == answer
    with pytest.raises(WrongAnswer, match="asked unit 0, unit 1 answered"):
        datagram(request, dialect, 0, 5).feed(frame(5))


@pytest.mark.parametrize(
    ("mine", "theirs"), [(MSX_E, "little"), (STANDARD, "little"), (DIALECTS["little"], "big")]
)
def test_the_other_byte_order_is_named(mine: Dialect, theirs: str) -> None:
    function = next(f for f in FUNCTIONS if f["register"] == 10500)
    frame = bytes.fromhex(function["answer"][theirs]) + bytes(8)
    request = ReadFunction(10500, 4, dialect=mine)
    with pytest.raises(LinkDown, match=f"its header is {theirs} endian"):
        exchange(request, mine, 1).feed(frame)
    assert whole_frame(frame, mine) is None
    with pytest.raises(WrongAnswer, match=f"not one answer, its header is {theirs} endian"):
        datagram(request, mine, 1).feed(frame)


def test_a_cut_datagram_is_not_called_the_other_order() -> None:
    cut = bytes.fromhex("00 00 00 00 01 01 00 03")
    with pytest.raises(WrongAnswer, match=r"not one answer \(octets"):
        datagram(ReadFunction(2, 4), MSX_E, 0).feed(cut)


@settings(derandomize=True, deadline=None, max_examples=500)
@given(st.sampled_from(sorted(DIALECTS)), st.sampled_from([2, 10500]), st.binary(max_size=280))
def test_any_octets_are_the_answer_or_a_documented_error(
    order: str, register: int, noise: bytes
) -> None:
    dialect = DIALECTS[order]
    request = ReadFunction(register, 4, dialect=dialect)
    header = bytes(4) + (len(noise) + 1).to_bytes(2, dialect.order) + b"\0"
    for make in (exchange, datagram):
        with suppress(LinkDown, WrongAnswer, ExceptionAnswer):
            pdu = make(request, dialect, 0).feed(header + noise)
            assert pdu == (noise if len(noise) >= 2 else None)
            check_answer(request, noise)
            assert noise == request.head + request.payload(noise)
            assert len(request.payload(noise)) == 8

"""Every way in which an answer can differ from what its request asks."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.errors import ExceptionAnswer, WrongAnswer
from roclog.modbus.request import ReadRegisters, Request, WriteRegister, check_answer, words

VECTORS = tomllib.loads(
    (Path(__file__).parents[1] / "vectors/modbus/frames.toml").read_text(encoding="utf-8")
)
READ = ReadRegisters(3, 300, 2)
READ_ANSWER = bytes.fromhex("03 04 12 34 56 78")
WRITE = WriteRegister(300, 0)
WRITE_ANSWER = bytes.fromhex("06 01 2C 00 00")


@pytest.mark.parametrize("vector", VECTORS["read"], ids=lambda vector: vector["request"])
def test_printed_reads(vector: dict[str, object]) -> None:
    request = ReadRegisters(*(int(str(vector[key])) for key in ("function", "address", "count")))
    answer = bytes.fromhex(str(vector["answer"]))
    assert request.pdu == bytes.fromhex(str(vector["request"]))
    assert len(answer) == request.answer_size
    check_answer(request, answer)
    assert list(words(answer)) == vector["words"]


@pytest.mark.parametrize("vector", VECTORS["write"], ids=lambda vector: vector["request"])
def test_printed_writes(vector: dict[str, object]) -> None:
    request = WriteRegister(int(str(vector["address"])), int(str(vector["value"])))
    assert request.pdu == bytes.fromhex(str(vector["request"]))
    check_answer(request, request.pdu)


@pytest.mark.parametrize(
    ("function", "address", "count"), [(3, 0, 1), (3, 0xFFFF, 1), (4, 0, 125), (4, 65411, 125)]
)
def test_limits_of_a_read(function: int, address: int, count: int) -> None:
    request = ReadRegisters(function, address, count)
    check_answer(request, bytes([function, 2 * count]) + bytes(2 * count))


@pytest.mark.parametrize(
    ("function", "address", "count"),
    [(3, 0, 0), (3, 0, 126), (3, -1, 1), (3, 65535, 2), (4, 65412, 125), (6, 0, 1), (0x83, 0, 1)],
)
def test_reads_that_cannot_be_asked(function: int, address: int, count: int) -> None:
    with pytest.raises(ValueError):
        ReadRegisters(function, address, count)


@pytest.mark.parametrize(("address", "value"), [(-1, 0), (0x10000, 0), (0, -1), (0, 0x10000)])
def test_writes_that_cannot_be_asked(address: int, value: int) -> None:
    with pytest.raises(ValueError):
        WriteRegister(address, value)


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        pytest.param(READ, "", id="nothing"),
        pytest.param(READ, "03", id="function only"),
        pytest.param(READ, "03 04 12 34 56", id="short"),
        pytest.param(READ, "03 04 12 34 56 78 9A", id="long"),
        pytest.param(READ, "03 05 12 34 56 78", id="odd byte count"),
        pytest.param(READ, "03 03 12 34 56", id="odd byte count that fits the length"),
        pytest.param(READ, "03 02 12 34", id="fewer registers"),
        pytest.param(READ, "03 06 12 34 56 78 9A BC", id="more registers"),
        pytest.param(READ, "03 00 04 12 34 56 78", id="16-bit byte count"),
        pytest.param(READ, "04 04 12 34 56 78", id="another function"),
        pytest.param(READ, "06 01 2C 00 00", id="answer to a write"),
        pytest.param(READ, "84 02", id="exception of another function"),
        pytest.param(READ, "83", id="exception without code"),
        pytest.param(READ, "83 02 00", id="exception with too much"),
        pytest.param(READ, "03 01 2C 00 02", id="echo of the request"),
        pytest.param(WRITE, "06 01 2D 00 00", id="another address"),
        pytest.param(WRITE, "06 01 2C 00 01", id="another value"),
        pytest.param(WRITE, "06 01 2C 00", id="short echo"),
        pytest.param(WRITE, "06 01 2C 00 00 00", id="long echo"),
        pytest.param(WRITE, "10 01 2C 00 01", id="answer to a multiple write"),
        pytest.param(WRITE, "83 02", id="exception of a read"),
    ],
)
def test_wrong_answers(request_: Request, answer: str) -> None:
    with pytest.raises(WrongAnswer) as caught:
        check_answer(request_, bytes.fromhex(answer))
    assert caught.value.raw == bytes.fromhex(answer)


@pytest.mark.parametrize("code", [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 255])
@pytest.mark.parametrize(("request_", "octet"), [(READ, 0x83), (WRITE, 0x86)])
def test_refusals(request_: Request, octet: int, code: int) -> None:
    with pytest.raises(ExceptionAnswer, match=f"exception {code} ") as caught:
        check_answer(request_, bytes([octet, code]))
    assert (caught.value.function, caught.value.code) == (octet & 0x7F, code)


@settings(derandomize=True, deadline=None)
@given(st.binary(max_size=12))
def test_only_the_one_right_form_passes(answer: bytes) -> None:
    try:
        check_answer(READ, answer)
    except (WrongAnswer, ExceptionAnswer):
        assert not (len(answer) == 6 and answer.startswith(b"\x03\x04"))
    else:
        assert len(answer) == 6
        assert answer.startswith(b"\x03\x04")

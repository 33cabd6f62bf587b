"""Who are you: function 17, and function 43 with MEI type 14.

Layout of the frames: V1.1b3 sections 6.13 and 6.21. The texts are those of a power meter's answers
that the documentation of nmap's modbus-discover script prints.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire import rtu_frame

from roclog.errors import ExceptionAnswer, WrongAnswer
from roclog.modbus.identification import (
    ReadDeviceIdentification,
    ReportServerId,
    objects,
    server_id,
    server_text,
)
from roclog.modbus.request import check_answer, is_read
from roclog.modbus.rtu import Echo, RtuExchange

UNIT = 100
SERVER_ID = b"\x11\x11\xfa\xffPM710PowerMeter"
OBJECTS = b"\x00\x12Schneider Electric\x01\x05PM710\x02\x07v03.110"
IDENTIFICATION = b"\x2b\x0e\x01\x01\x00\x00\x03" + OBJECTS
ANSWERS = [(ReportServerId(), SERVER_ID), (ReadDeviceIdentification(), IDENTIFICATION)]


def test_requests() -> None:
    assert ReportServerId().pdu == b"\x11"
    assert ReadDeviceIdentification().pdu == b"\x2b\x0e\x01\x00"
    assert ReadDeviceIdentification(2).pdu == b"\x2b\x0e\x01\x02"
    with pytest.raises(ValueError, match="object 3 is not basic"):
        ReadDeviceIdentification(3)


@pytest.mark.parametrize(
    ("pdu", "read"),
    [
        ("11", True),
        ("1100", False),
        ("2b0e0100", True),
        ("2b0e0402", True),
        ("2b0e0500", False),
        ("2b0e0000", False),
        ("2b0e01", False),
        ("2b0e010000", False),
        ("2b0d0100", False),
        ("2b0e01000001", False),
        ("080000a537", False),
        ("", False),
    ],
)
def test_what_the_bus_lets_pass_as_a_read(pdu: str, read: bool) -> None:
    assert is_read(bytes.fromhex(pdu)) is read


@pytest.mark.parametrize(("request_", "pdu"), ANSWERS)
@pytest.mark.parametrize("echo", list(Echo))
@pytest.mark.parametrize("noise", [b"", b"\x00", bytes([UNIT]), bytes([UNIT, 0x11])])
def test_an_answer_says_how_long_it_is(
    request_: ReportServerId | ReadDeviceIdentification, pdu: bytes, echo: Echo, noise: bytes
) -> None:
    """However its octets are cut; with a copy of the request before it, where adapters give one."""
    for copies in (0, 1) if echo is not Echo.ABSENT else (0,):
        for step in (1, 2, 7, 99):
            exchange = RtuExchange(UNIT, request_, echo)
            octets = exchange.adu * copies + noise + rtu_frame(UNIT, pdu)
            found = [exchange.feed(octets[at : at + step]) for at in range(0, len(octets), step)]
            heard = next((answer for answer in found if answer), None) or exchange.conclude()
            assert heard == pdu
            check_answer(request_, pdu)


@pytest.mark.parametrize(("request_", "pdu"), ANSWERS)
def test_an_answer_that_contradicts_itself(
    request_: ReportServerId | ReadDeviceIdentification, pdu: bytes
) -> None:
    for size in range(1, len(pdu)):
        with pytest.raises(WrongAnswer, match="octets instead of"):
            check_answer(request_, pdu[:size])
        exchange = RtuExchange(UNIT, request_, Echo.UNKNOWN)
        assert exchange.feed(rtu_frame(UNIT, pdu[:size])) is None
        assert exchange.conclude() is None
    with pytest.raises(WrongAnswer, match="octets instead of"):
        check_answer(request_, pdu + b"\x00")


@pytest.mark.parametrize("refused", [b"\x91\x01", b"\xab\x01", b"\xab\x0e\x01"])
def test_refusals(refused: bytes) -> None:
    request_ = ReportServerId() if refused[0] == 0x91 else ReadDeviceIdentification()
    exchange = RtuExchange(UNIT, request_, Echo.UNKNOWN)
    assert (exchange.feed(rtu_frame(UNIT, refused)) or exchange.conclude()) == refused
    with pytest.raises(ExceptionAnswer, match="exception 1"):
        check_answer(request_, refused)


def test_a_damaged_answer_is_known_by_its_own_length() -> None:
    exchange = RtuExchange(UNIT, ReportServerId(), Echo.ABSENT)
    damaged = bytearray(rtu_frame(UNIT, SERVER_ID))
    damaged[5] ^= 1
    for octet in damaged[:-1]:
        assert exchange.feed(bytes([octet])) is None
        assert not exchange.spoiled
    exchange.feed(bytes(damaged[-1:]))
    assert exchange.spoiled


def test_texts() -> None:
    assert server_text(server_id(SERVER_ID)) == "PM710PowerMeter"
    assert server_text(b"\x07\xff") == "07 ff"
    assert server_text(b"") == ""
    assert server_text(b"\x42\xff\x1b[31mMETER\x07\n") == "\\x1b[31mMETER\\x07"
    found, following = objects(IDENTIFICATION)
    assert found == {0: "Schneider Electric", 1: "PM710", 2: "v03.110"}
    assert following is None


def test_more_follows() -> None:
    first = b"\x2b\x0e\x01\x01\xff\x01\x01\x00\x12Schneider Electric"
    check_answer(ReadDeviceIdentification(), first)
    assert objects(first) == ({0: "Schneider Electric"}, 1)


@given(st.sampled_from([b"", b"\x11", b"\x91", b"\x2b\x0e\x01", b"\xab"]), st.binary(max_size=260))
def test_any_octets_are_an_answer_or_a_documented_error(start: bytes, rest: bytes) -> None:
    pdu = start + rest
    for request_ in (ReportServerId(), ReadDeviceIdentification()):
        try:
            check_answer(request_, pdu)
        except (WrongAnswer, ExceptionAnswer):
            continue
        if isinstance(request_, ReportServerId):
            assert server_id(pdu) == pdu[2:]
            assert server_text(server_id(pdu)).isprintable()
        else:
            found, following = objects(pdu)
            assert sum(len(text) for text in found.values()) <= len(pdu) - 7
            assert following in (None, 0, 1, 2)

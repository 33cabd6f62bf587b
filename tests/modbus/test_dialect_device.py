"""Requests and exchanges against an independent MSX-E3317 over real sockets."""

from __future__ import annotations

import socket
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from msx import MsxDevice
from msx_options import Options

from roclog.errors import ExceptionAnswer, LinkDown, WrongAnswer
from roclog.modbus.dialect import MSX_E, Dialect
from roclog.modbus.functions import (
    REMOTE_EXECUTION_ERROR,
    CommandStatus,
    ReadFunction,
    ReadWriteFunction,
    WriteFunction,
    command_status,
    status_request,
)
from roclog.modbus.mbap import DatagramExchange, MbapExchange, MbapStream
from roclog.modbus.request import check_answer

if TYPE_CHECKING:
    from roclog.modbus.request import Request

LITTLE = replace(MSX_E, order="little")
TIME, TIME_EX = 2, 10500

both_orders = pytest.mark.parametrize("dialect", [MSX_E, LITTLE], ids=["big", "little"])
both_ways = pytest.mark.parametrize("way", ["tcp", "udp"])


class Client:
    """A blocking client, as simple as can be: a request, then octets until the exchange ends."""

    def __init__(self, device: MsxDevice, way: str, dialect: Dialect, unit: int = 1) -> None:
        kind = socket.SOCK_STREAM if way == "tcp" else socket.SOCK_DGRAM
        self.socket = socket.socket(socket.AF_INET, kind)
        self.socket.settimeout(5)
        self.socket.connect(("127.0.0.1", device.ports[way]))
        self._way, self._unit = way, unit
        self._stream = MbapStream(dialect)
        self._number = 0x00FF
        self.stale = 0

    def call(self, request: Request) -> bytes:
        self._number += 1
        exchange: MbapExchange
        if self._way == "udp":
            dialect = self._stream.dialect
            exchange = DatagramExchange(self._unit, request, self._number, dialect)
        else:
            exchange = MbapExchange(self._unit, request, self._number, self._stream)
        self.socket.send(exchange.adu)
        pdu = None
        while pdu is None:
            octets = self.socket.recv(600)
            assert octets, "closed"
            pdu = exchange.feed(octets)
        self.stale += exchange.stale
        check_answer(request, pdu)
        return pdu

    def close(self) -> None:
        self.socket.close()


def device(dialect: Dialect, **options: Any) -> MsxDevice:
    anywhere = "127.0.0.1:0"
    return MsxDevice(Options(tcp=anywhere, udp=anywhere, order=dialect.order, **options))


@both_orders
@both_ways
def test_old_and_new_functions_tell_the_same(dialect: Dialect, way: str) -> None:
    with device(dialect) as msx, closing(Client(msx, way, dialect)) as client:
        for old, new, words in ((0, 10000, 54), (1, 10200, 100), (3, 10550, 16)):
            requests = [ReadFunction(register, words, dialect=dialect) for register in (old, new)]
            payloads = [request.payload(client.call(request)) for request in requests]
            assert payloads[0] == payloads[1]
            assert len(payloads[0]) == 2 * words
        name = ReadFunction(10200, 100, dialect=dialect)
        assert name.payload(client.call(name)).rstrip(b"\0") == b"MSX-E3317-8"


@both_orders
@both_ways
@pytest.mark.parametrize("register", [TIME, TIME_EX])
def test_the_clock_as_the_device_told_it(dialect: Dialect, way: str, register: int) -> None:
    with device(dialect, clock_offset=1e6) as msx, closing(Client(msx, way, dialect)) as client:
        request = ReadFunction(register, 4, dialect=dialect)
        payload = request.payload(client.call(request))
        seconds, microseconds = (int.from_bytes(payload[k : k + 4], dialect.order) for k in (0, 4))
        told = msx.truth.lines[-1]
        assert (told["seconds"], told["microseconds"]) == (seconds, microseconds)


@both_orders
@both_ways
def test_a_refusal_and_its_reason(dialect: Dialect, way: str) -> None:
    fail = f"{TIME_EX}:-100:5:Input/output error"
    with device(dialect, fail=fail) as msx, closing(Client(msx, way, dialect)) as client:
        with pytest.raises(ExceptionAnswer) as refused:
            client.call(ReadFunction(TIME_EX, 4, dialect=dialect))
        assert refused.value.code == REMOTE_EXECUTION_ERROR
        request = status_request(dialect)
        status = command_status(request.payload(client.call(request)), dialect)
        assert status == CommandStatus(-100, 5, "Input/output error")


@both_orders
@both_ways
@pytest.mark.parametrize("register", [100, 11000])
def test_calls_with_parameters(dialect: Dialect, way: str, register: int) -> None:
    parameters = (4).to_bytes(4, dialect.order) + bytes(4)
    with device(dialect, channels=5) as msx, closing(Client(msx, way, dialect)) as client:
        client.call(WriteFunction(register, parameters, dialect))
        for read, words in ((1, 100), (21000, 2)):
            request = ReadWriteFunction(read, words, register, parameters, dialect)
            payload = request.payload(client.call(request))
        assert int.from_bytes(payload, dialect.order) == 5
        assert [call["written"] for call in msx.calls()] == [register] * 3
        assert {call["parameters"] for call in msx.calls()} == {parameters.hex()}


@both_orders
@both_ways
@pytest.mark.parametrize("register", [TIME, TIME_EX])
def test_answers_that_are_none(dialect: Dialect, way: str, register: int) -> None:
    request = ReadFunction(register, 4, dialect=dialect)
    faults = {
        "short": r"octets instead of 1[01]",
        "other_count": f"byte count of the answer has .* register {register} of this device has",
        "other_unit": "asked unit 1, unit 0 answered",
    }
    for fault, says in faults.items():
        with (
            device(dialect, **{fault: 1.0}) as msx,
            closing(Client(msx, way, dialect)) as client,
            pytest.raises(WrongAnswer, match=says),
        ):
            client.call(request)


@both_orders
def test_copies_belong_to_no_later_request(dialect: Dialect) -> None:
    """Every answer comes twice: each call takes its own, however many copies lie before it."""
    calls = 20
    with (
        device(dialect, duplicate=1.0) as msx,
        closing(Client(msx, "udp", dialect)) as client,
    ):
        for _ in range(calls):
            request = ReadFunction(TIME_EX, 4, dialect=dialect)
            payload = request.payload(client.call(request))
            told = [line for line in msx.truth.lines if line["event"] == "answer"][-1]
            assert int.from_bytes(payload[4:], dialect.order) == told["microseconds"]
        assert client.stale == calls - 1
        assert len(msx.calls()) == calls


def test_a_module_set_to_the_other_order() -> None:
    """It hears noise; what it would say is told from garbage."""
    with device(LITTLE) as msx, closing(Client(msx, "tcp", MSX_E)) as client:
        with pytest.raises((AssertionError, ConnectionResetError)):
            client.call(ReadFunction(TIME_EX, 4))
        assert msx.calls() == []
    with device(LITTLE) as msx, closing(Client(msx, "tcp", LITTLE)) as client:
        client.socket.send(bytes.fromhex("00 00 00 00 06 00 01 03 04 29 04 00"))
        request = ReadFunction(TIME_EX, 4)
        with pytest.raises(LinkDown, match="its header is little endian"):
            MbapExchange(1, request, 0, MbapStream(MSX_E)).feed(client.socket.recv(600))

"""The bus and an MSX-E3317: both byte orders, both ways, and no call that nobody asked for."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from msx import MsxDevice
from msx_options import Options

from roclog.bus.bus import Bus
from roclog.bus.tally import Tally
from roclog.bus.tcp import TcpLink
from roclog.bus.timing import Framing, Timing
from roclog.bus.udp import UdpLink
from roclog.clock import SystemClock
from roclog.errors import DeviceError, WriteRefused
from roclog.modbus.dialect import MSX_E, ByteOrder, Dialect
from roclog.modbus.functions import ReadFunction, ReadWriteFunction, WriteFunction

if TYPE_CHECKING:
    from roclog.bus.link import Link

MS = 1_000_000
REQUESTS = 200
ANYWHERE = "127.0.0.1:0"


def make_bus(device: MsxDevice, way: str, dialect: Dialect) -> Bus:
    framing = Framing.MBAP_STREAM if way == "tcp" else Framing.MBAP_DATAGRAM
    link: Link = (TcpLink if way == "tcp" else UdpLink)("127.0.0.1", device.ports[way])
    timing = Timing(framing=framing, timeout=100 * MS, dialect=dialect)
    return Bus(link, timing, SystemClock(), frozenset())


@pytest.mark.parametrize("way", ["tcp", "udp"])
@pytest.mark.parametrize("order", ["big", "little"])
def test_every_answer_is_its_own_and_no_call_is_repeated(order: ByteOrder, way: str) -> None:
    dialect = replace(MSX_E, order=order)
    options = Options(
        tcp=ANYWHERE,
        udp=ANYWHERE,
        order=dialect.order,
        drop_request=0.03,
        drop=0.03,
        duplicate=0.1,
        reorder=0.05,
        held_for=0.15,
        short=0.05,
        other_count=0.05,
        other_unit=0.05,
    )

    async def ask(device: MsxDevice) -> Counter[str]:
        bus, tally, ends = make_bus(device, way, dialect), Tally(), Counter[str]()
        try:
            for number in range(REQUESTS):
                request = ReadFunction((2, 10500)[number % 2], 4, dialect=dialect)
                try:
                    answer = await bus.transact(1, request, tally)
                except DeviceError as error:
                    ends[type(error).__name__] += 1
                    continue
                payload = request.payload(answer.pdu)
                told = [line for line in device.truth.lines if line["event"] == "answer"][-1]
                assert int.from_bytes(payload[:4], dialect.order) == told["seconds"]
                assert int.from_bytes(payload[4:], dialect.order) == told["microseconds"]
                ends["answered"] += 1
        finally:
            bus.close()
        assert tally.requests == REQUESTS
        assert tally.wrong_answers == ends["WrongAnswer"]
        return ends

    with MsxDevice(options) as device:
        ends = asyncio.run(ask(device))
        fates = Counter(line["fate"] for line in device.truth.lines if line["event"] == "answer")
        calls = device.calls()
    assert len(calls) == REQUESTS - device.truth.counts["ignored"]
    assert len({call["transaction"] for call in calls}) == len(calls)
    assert ends["WrongAnswer"] == fates["short"] + fates["other_count"] + fates["other_unit"]
    assert ends["answered"] + ends["NoAnswer"] + ends["WrongAnswer"] == REQUESTS
    assert ends["answered"] >= fates["ok"] + fates["duplicate"]


def test_calls_with_parameters_never_leave() -> None:
    async def ask(device: MsxDevice) -> None:
        bus = make_bus(device, "udp", MSX_E)
        for request in (WriteFunction(11000, bytes(8)), ReadWriteFunction(2, 4, 11000, bytes(8))):
            with pytest.raises(WriteRefused):
                await bus.transact(1, request, Tally())
        bus.close()

    with MsxDevice(Options(udp=ANYWHERE)) as device:
        asyncio.run(ask(device))
        assert device.truth.counts["call"] == device.truth.counts["noise"] == 0

"""What may leave, and until when."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import pytest
from bus_fakes import CLEAR, MS, READ, SILENCE, SLACK, START, UNIT, device, make, now, run
from wire import rtu_frame

from roclog.bus.bus import TooLate
from roclog.bus.tally import Tally
from roclog.errors import WriteRefused
from roclog.modbus.request import WriteRegister


@pytest.mark.parametrize(
    ("unit", "request_"),
    [
        (UNIT, WriteRegister(300, 1)),
        (UNIT, WriteRegister(301, 0)),
        (UNIT, WriteRegister(1101, 0x55)),
        (UNIT - 1, CLEAR),
        (0, CLEAR),
    ],
)
def test_writes_that_are_not_permitted_never_leave(unit: int, request_: WriteRegister) -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        with pytest.raises(WriteRefused, match=f"writing {request_.value} to register"):
            await bus.transact(unit, request_, tally)
        assert (link.sent, link.opened, tally.requests) == ([], [], 0)

    run(main())


def test_the_permitted_write_leaves() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        await bus.transact(UNIT, READ, Tally())
        await bus.transact(UNIT, CLEAR, Tally())
        assert [adu for _, adu in link.sent] == [rtu_frame(UNIT, r.pdu) for r in (READ, CLEAR)]

    run(main())


@dataclass
class HandMade:
    """A request of any kind, that says of itself what it likes."""

    pdu: bytes
    answer_size: int = 5

    @property
    def head(self) -> bytes:
        return self.pdu[:1]


@pytest.mark.parametrize(
    "pdu",
    [
        "05 01 2C FF 00",
        "06 01 2C 00 00 00",
        "06 01",
        "08 00 01 00 00",
        "0F 00 00 00 08 01 FF",
        "10 01 2C 00 01 02 00 00",
        "16 01 2C 00 00 00 00",
        "17 01 2C 00 01 01 2C 00 01 02 00 00",
        "2B 0E 01 00",
        "5A",
    ],
)
def test_only_reads_leave_without_permission(pdu: str) -> None:
    async def main() -> None:
        link, bus = make()
        with pytest.raises(WriteRefused):
            await bus.transact(UNIT, HandMade(bytes.fromhex(pdu)), Tally())
        assert link.opened == []

    run(main())


def test_not_after() -> None:
    async def main() -> None:
        link, bus = make()
        device(link)
        tally = Tally()
        await bus.transact(UNIT, READ, tally, not_after=START + SILENCE + SLACK)
        blocking = asyncio.create_task(bus.transact(UNIT, READ, tally))
        await asyncio.sleep(0)
        with pytest.raises(TooLate):
            await bus.transact(UNIT, CLEAR, tally, not_after=now() + 10 * MS)
        await blocking
        await bus.transact(UNIT, READ, tally)
        with pytest.raises(TooLate):  # the silence alone ends after it
            await bus.transact(UNIT, CLEAR, tally, not_after=now() + SILENCE - MS)
        assert [adu[1] for _, adu in link.sent] == [3, 3, 3]
        assert tally.requests == 3

    run(main())

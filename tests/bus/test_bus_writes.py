"""What may leave, and until when."""

from __future__ import annotations

import ast
import asyncio
from dataclasses import dataclass
from pathlib import Path

import pytest
from bus_fakes import CLEAR, MS, READ, SILENCE, SLACK, START, UNIT, device, make, now, run
from wire import rtu_frame

import roclog
from roclog.bus.bus import TooLate
from roclog.bus.tally import Tally
from roclog.clock import SystemClock
from roclog.config.settings import Connection
from roclog.connect import make_bus
from roclog.errors import LinkDown, WriteRefused
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
        "11 00",
        "2B 0D 01 00",
        "2B 0E 05 00",
        "2B 0E 01 00 00",
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


def test_what_a_person_asked_for_leaves_and_nothing_like_it() -> None:
    """Nobody is at home at port 1: what may leave is what the link is opened for."""
    connection = Connection(
        name="net",
        transport="tcp",
        port=1,
        host="127.0.0.1",
        baudrate=0,
        bytesize=0,
        parity="",
        stopbits=0,
        timeout=100 * MS,
        late_answer=None,
        silence=0,
        character=0,
    )
    asked_for = frozenset({(UNIT, 1102, 0x5A)})

    async def main() -> None:
        bus = make_bus(connection, [], SystemClock(), asked_for)
        with pytest.raises(LinkDown):
            await bus.transact(UNIT, WriteRegister(1102, 0x5A), Tally())
        for unit, address, value in (
            (UNIT, 1101, 0x55),
            (UNIT, 1102, 0x5B),
            (UNIT, 300, 0),
            (1, 1102, 0x5A),
        ):
            bus = make_bus(connection, [], SystemClock(), asked_for)
            with pytest.raises(WriteRefused):
                await bus.transact(unit, WriteRegister(address, value), Tally())
        bus = make_bus(connection, [], SystemClock())
        with pytest.raises(WriteRefused):
            await bus.transact(UNIT, WriteRegister(1102, 0x5A), Tally())

    asyncio.run(main())


def test_only_commands_to_a_device_ask_for_writes() -> None:
    """Recording, probing and scanning have no way to name one."""
    asking = set()
    for path in sorted(Path(roclog.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "make_bus":
                assert not any(isinstance(each, ast.Starred) for each in node.args)
                if len(node.args) > 3 or node.keywords:
                    asking.add(path.name)
    assert asking == {"talk.py"}


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

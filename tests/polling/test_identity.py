"""Another device at the same address, on a serial line that tells nobody that it was unplugged."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

import pytest
from bus_fakes import MS, UNIT, FakeLink, VirtualClock, make, run
from wire import rtu_frame

from roclog.config.settings import Device
from roclog.devices.hiac_roc import REGISTER_MAP as ROC
from roclog.outbox import CommitGroup
from roclog.polling.assembly import Assembly
from roclog.polling.identity import difference, identity
from roclog.register_map import (
    Block,
    Point,
    RegisterMap,
    SerialDefaults,
    StampedInputs,
    Table,
    WordOrder,
    WordType,
)
from roclog.schema import GAP, Reason, read_signature

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.recording.entries import Entry
    from roclog.recording.writer import Writer

WHO = Block(
    name="who",
    table=Table.HOLDING_REGISTERS,
    address=10,
    count=1,
    points=(Point(name="number", offset=0, type=WordType.U16),),
)
FLOW = Block(
    name="flow",
    table=Table.HOLDING_REGISTERS,
    address=100,
    count=1,
    points=(Point(name="rate", offset=0, type=WordType.U16),),
)
METER = RegisterMap(
    name="meter",
    title="",
    source="",
    unit=UNIT,
    serial=SerialDefaults(baudrate=9600),
    answer_limit=10**9,
    facts=(WHO,),
    samples=(FLOW,),
    stamped=(StampedInputs(table=Table.INPUT_REGISTERS, stamp=7, address=8, count=1),),
    identity=(("who", "number"),),
)
OCTETS = bytes.fromhex("10 27 1e 0a 17 0b 1a")
"""2026-11-23 10:30:10, as CP56Time2a."""


@dataclass
class Disk:
    """A writer that keeps what it is given in memory."""

    entries: list[Entry] = field(default_factory=list)
    carried: dict[str, Mapping[str, object]] = field(default_factory=dict)
    begun: list[tuple[int, Mapping[str, object]]] = field(default_factory=list)

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        self.entries += entries
        for entry in entries:
            if entry.carry is not None:
                self.carried[entry.topic] = dict(entry.carry)
        return done()

    note = commit

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]:
        self.carried[topic] = dict(values)
        return done()

    def describe(self, name: str, values: Mapping[str, str]) -> Future[None]:
        return done()

    def begin(
        self, name: str, values: Mapping[str, str], carry: Mapping[str, Mapping[str, object] | None]
    ) -> Future[None]:
        self.begun.append((len(self.entries), carry))
        for topic, kept in carry.items():
            self.carried.pop(topic, None)
            if kept is not None:
                self.carried[topic] = kept
        return done()

    def samples(self, topic: str) -> list[tuple[bytes, int]]:
        """(epoch, seq) in the order of the disk."""
        signatures = [read_signature(e.data) for e in self.entries if e.topic == topic]
        return [(s["epoch"], s["seq"]) for s in signatures if s is not None]

    def replaced(self) -> list[tuple[int, int]]:
        found = [GAP.unpack(e.data) for e in self.entries if e.topic.endswith("/gap")]
        gaps = [gap for gap in found if gap is not None and gap["reason"] == Reason.REPLACED]
        return [(gap["from"], gap["to"]) for gap in gaps]

    def told(self) -> list[bytes]:
        return [e.data for e in self.entries if e.topic == "/log" and b"meter1.identity" in e.data]


def done() -> Future[None]:
    future: Future[None] = Future()
    future.set_result(None)
    return future


@dataclass
class Meter:
    """What answers on the line; ``number`` 0 is a device that does not know who it is yet."""

    link: FakeLink
    number: int
    is_there: bool = True

    def __post_init__(self) -> None:
        self.link.on_send = self._hear

    def _hear(self, adu: bytes) -> None:
        if not self.is_there:
            return
        pdu = adu[1:-2]
        if pdu[0] == 43:
            told = bytes([0x2B, 0x84, 9, 0, 7]) + OCTETS
        else:
            value = self.number if pdu[1:3] == b"\0\x0a" else 7
            told = b"\x03\x02" + value.to_bytes(2)
        self.link.say(rtu_frame(adu[0], told), 20 * MS)


def settings() -> Device:
    return Device(
        name="meter1",
        profile=METER,
        connection="line",
        unit=UNIT,
        poll=1000 * MS,
        word_order=WordOrder.ABCD,
        acknowledge=False,
        cycle=None,
    )


async def record(disk: Disk, steps: Sequence[tuple[float, int | None]]) -> None:
    """One run: for so many seconds the meter has that number; None: nobody is there."""
    link, bus = make()
    meter = Meter(link, 0)
    group = CommitGroup(disk)
    assembly = Assembly(cast("Writer", disk), group, VirtualClock(), dict(disk.carried))
    device = assembly.device(settings(), bus, 0)
    polling = asyncio.create_task(device.run())
    for seconds, number in steps:
        meter.is_there = number is not None
        meter.number = number or 0
        await asyncio.sleep(seconds)
    device.stop()
    await polling
    device.close()
    await group.finish()


def numbered(found: list[tuple[bytes, int]]) -> list[list[int]]:
    """Sequence numbers by epoch."""
    epochs = list(dict.fromkeys(epoch for epoch, _ in found))
    return [[seq for epoch, seq in found if epoch == wanted] for wanted in epochs]


def test_another_number_after_a_silence_begins_everything_anew() -> None:
    disk = Disk()
    run(record(disk, [(10, 1), (20, None), (10, 2)]))
    first, second = numbered(disk.samples("/meter1/flow"))
    assert first == list(range(1, len(first) + 1))
    assert second == list(range(1, len(second) + 1))
    assert len(first) >= 9
    assert len(second) >= 6
    # The stamped input of the next one is a baseline of its own, though its octets are the same.
    assert numbered(disk.samples("/meter1/input_registers")) == [[1], [1]]
    (text,) = disk.told()
    assert b"who.number '2' instead of '1'" in text
    ((since, until),) = disk.replaced()
    assert 10 * 10**9 < until - since < 24 * 10**9
    ((at, kept),) = disk.begun
    assert kept == {
        "/meter1/flow": None,
        "/meter1/input_registers": None,
        "/meter1": {"seq": 0, "identity": {"who.number": "2"}},
    }
    after = [entry.topic for entry in disk.entries[at:] if entry.topic != "/log"]
    assert after[:2] == ["/meter1/gap", "/meter1/input_registers"]
    epochs = dict.fromkeys(epoch for epoch, _ in disk.samples("/meter1/flow"))
    before = Disk(disk.entries[:at]).samples("/meter1/flow")
    assert {epoch for epoch, _ in before} == {next(iter(epochs))}


@pytest.mark.parametrize("again", [1, 0])
def test_the_same_number_or_none_goes_on(again: int) -> None:
    disk = Disk()
    run(record(disk, [(10, 1), (20, None), (10, again), (20, None), (10, 1)]))
    (numbers,) = numbered(disk.samples("/meter1/flow"))
    assert numbers == list(range(1, len(numbers) + 1))
    assert (disk.told(), disk.begun, disk.replaced()) == ([], [], [])


def test_another_number_in_the_next_run() -> None:
    disk = Disk()
    run(record(disk, [(10, 1)]))
    assert disk.carried["/meter1"] == {"seq": 0, "identity": {"who.number": "1"}}
    run(record(disk, [(10, 1)]))
    assert disk.begun == []
    run(record(disk, [(10, 2)]))
    run(record(disk, [(10, 2)]))
    assert len(numbered(disk.samples("/meter1/flow"))) == 2
    assert len(disk.begun) == len(disk.told()) == len(disk.replaced()) == 1


def test_what_is_carried_and_is_no_identity_counts_for_nothing() -> None:
    disk = Disk(carried={"/meter1": {"seq": 0, "identity": "A7"}})
    run(record(disk, [(10, 1)]))
    assert disk.begun == []
    assert disk.carried["/meter1"] == {"seq": 0, "identity": {"who.number": "1"}}


def test_the_identity_of_a_roc_is_maker_model_and_serial_number() -> None:
    told = {"manufacturer": "HIAC", "model": "ROC", "serial_number": " A1 ", "sensor_id": "S"}
    expected = {"identity.manufacturer": "HIAC", "identity.model": "ROC"}
    assert identity(ROC, {"identity": told}) == expected | {"identity.serial_number": "A1"}
    assert identity(ROC, {"configuration": {"node_id": 138}}) == {}
    blank = dict.fromkeys(("manufacturer", "model", "serial_number"), "  ")
    assert identity(ROC, {"identity": blank}) == {}


def test_what_is_not_known_differs_from_nothing() -> None:
    assert difference({}, {"a": "1"}) == ""
    assert difference({"a": "1"}, {}) == ""
    assert difference({"a": "1", "b": "2"}, {"a": "1", "b": "3"}) == "b '3' instead of '2'"
    assert difference({"a": "1"}, {"b": "1"}) == "b '1' instead of None"

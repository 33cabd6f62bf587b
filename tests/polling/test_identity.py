"""Another device at the same address, on a serial line that tells nobody that it was unplugged."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest
from bus_fakes import MS, UNIT, FakeLink, VirtualClock, make, now, run
from told import gaps
from wire import rtu_frame

from roclog.config.settings import Device
from roclog.devices.hiac_roc import REGISTER_MAP as ROC
from roclog.errors import StorageError
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
from roclog.schema import Reason, read_signature

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

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
MORE = replace(
    WHO,
    name="more",
    address=20,
    points=(Point(name="code", offset=0, type=WordType.U16),),
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
    described: list[Mapping[str, str]] = field(default_factory=list)
    failing: range = range(0)

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        if self.failing and now() in self.failing:
            failed: Future[None] = Future()
            failed.set_exception(StorageError(Path("/disk"), "full"))
            return failed
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
        self.described.append(values)
        return done()

    def begin(
        self, name: str, values: Mapping[str, str], carry: Mapping[str, Mapping[str, object] | None]
    ) -> Future[None]:
        self.begun.append((len(self.entries), carry))
        self.described.append(values)
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
        found = [gap for gap in gaps(self.entries) if gap.reason == Reason.REPLACED]
        assert {gap.block for gap in found} <= {""}, "it is the whole device's"
        return [(gap.since, gap.until) for gap in found]

    def told(self) -> list[bytes]:
        return [e.data for e in self.entries if e.topic == "/log" and b"meter1.identity" in e.data]


def done() -> Future[None]:
    future: Future[None] = Future()
    future.set_result(None)
    return future


@dataclass
class Meter:
    """What answers on the line; ``number`` 0 is a device that does not know who it is yet.

    mute: addresses that it does not answer for. gateway: one says that nobody is there.
    asked: addresses in order.
    """

    link: FakeLink
    number: int
    is_there: bool = True
    mute: Collection[int] = ()
    refuses: Collection[int] = ()
    gateway: bool = False
    asked: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.link.on_send = self._hear

    def _hear(self, adu: bytes) -> None:
        pdu = adu[1:-2]
        address = int.from_bytes(pdu[1:3])
        self.asked.append(address)
        if not self.is_there and self.gateway:
            told = bytes([0x80 | pdu[0], 11])
        elif not self.is_there or address in self.mute:
            return
        elif address in self.refuses:
            told = bytes([0x80 | pdu[0], 2])
        elif pdu[0] == 43:
            told = bytes([0x2B, 0x84, 9, 0, 7]) + OCTETS
        else:
            value = self.number if pdu[1:3] == b"\0\x0a" else 7
            told = b"\x03\x02" + value.to_bytes(2)
        self.link.say(rtu_frame(adu[0], told), 20 * MS)


def settings(profile: RegisterMap = METER, poll: int = 1000 * MS) -> Device:
    return Device(
        name="meter1",
        profile=profile,
        connection="line",
        unit=UNIT,
        poll=poll,
        word_order=WordOrder.ABCD,
        acknowledge=False,
        cycle=None,
    )


Step = tuple[float, int | None] | tuple[float, int | None, Mapping[str, object]]


async def record(
    disk: Disk,
    steps: Sequence[Step],
    configured: Device | None = None,
    *,
    closed: int = 0,
    **manners: object,
) -> None:
    """One run: for so many seconds the meter has that number; None: nobody is there.

    closed: attempts to open the link that fail. manners: attributes of the meter, from the start or
    from a step on.
    """
    link, bus = make()
    link.open_failures = [OSError(111, "refused")] * closed
    meter = Meter(link, 0, **manners)  # type: ignore[arg-type]
    group = CommitGroup(disk)
    assembly = Assembly(cast("Writer", disk), group, VirtualClock(), dict(disk.carried))
    device = assembly.device(configured or settings(), bus, 0)
    polling = asyncio.create_task(device.run())
    for seconds, number, *changes in steps:
        meter.is_there = number is not None
        meter.number = number or 0
        for name, value in (changes[0] if changes else {}).items():
            setattr(meter, name, value)
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
    # A kill between the two would leave the next run to tell the gap once more, never not at all.
    assert "/meter1/gap" in {entry.topic for entry in disk.entries[:at]}
    after = [entry.topic for entry in disk.entries[at:] if entry.topic != "/log"]
    assert after[0] == "/meter1/input_registers"
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
    assert difference({"a": "1"}, {"b": "1"}) == ""


def test_a_part_of_the_identity_that_was_not_told_for_once_is_no_other_device() -> None:
    """The second block was refused at the first question of this run."""
    disk = Disk(carried={"/meter1": {"seq": 0, "identity": {"who.number": "1", "more.code": "7"}}})
    profile = replace(METER, facts=(WHO, MORE), identity=(*METER.identity, ("more", "code")))
    steps: list[Step] = [(10, 1), (20, None), (10, 1, {"refuses": ()}), (20, None), (10, 1)]
    run(record(disk, steps, settings(profile), refuses={20}))
    assert (disk.begun, disk.told()) == ([], [])


def test_more_of_the_identity_is_carried_once_it_is_told() -> None:
    disk = Disk()
    profile = replace(METER, facts=(WHO, MORE), identity=(*METER.identity, ("more", "code")))
    steps: list[Step] = [(10, 1), (20, None), (10, 1, {"refuses": ()})]
    run(record(disk, steps, settings(profile), refuses={20}))
    assert disk.carried["/meter1"]["identity"] == {"who.number": "1", "more.code": "7"}


def test_what_the_last_device_said_is_not_said_of_the_next_one() -> None:
    disk = Disk()
    profile = replace(METER, facts=(WHO, MORE))
    run(record(disk, [(10, 1), (20, None), (10, 2, {"refuses": {20}})], settings(profile)))
    assert '"code": 7' in disk.described[0]["more"]
    assert "more" not in disk.described[-1]
    assert len(disk.begun) == 1


@pytest.mark.parametrize("profile", [METER, replace(METER, facts=(), identity=())])
def test_a_device_that_stays_away_is_described_once(profile: RegisterMap) -> None:
    disk = Disk()
    run(record(disk, [(10, 1), (3600, None)], settings(profile)))
    assert len(disk.described) == 1


def test_a_device_that_tells_no_more_who_it_is_loses_few_polls() -> None:
    """In an hour one poll a minute, and at most fifteen after the silence."""
    disk = Disk()
    run(record(disk, [(10, 1), (20, None), (3600, 1, {"mute": {10}})]))
    (numbers,) = numbered(disk.samples("/meter1/flow"))
    assert len(numbers) > 3600 - 60 * 2 - 50
    assert disk.begun == []


def test_a_block_that_is_never_answered_has_nobody_asked_who_he_is() -> None:
    disk, asked = Disk(), list[int]()
    profile = replace(METER, samples=(FLOW, replace(FLOW, name="deaf", address=200)), stamped=())
    run(record(disk, [(600, 1)], settings(profile), mute={200}, asked=asked))
    assert asked.count(10) == 1
    assert len(disk.samples("/meter1/flow")) > 250


def test_an_attempt_over_a_link_that_is_not_open_asks_nobody() -> None:
    """So it is no reason to wait a minute: the first to be asked for is who it is."""
    disk, asked = Disk(), list[int]()
    run(record(disk, [(600, 1)], closed=50, asked=asked))
    assert asked[:2] == [10, 100]
    assert len(disk.samples("/meter1/flow")) > 450


def test_a_gateway_that_answers_for_nobody_is_not_the_device() -> None:
    disk = Disk()
    run(record(disk, [(10, 1), (60, None), (10, 2)], gateway=True))
    assert len(disk.begun) == 1
    ((since, until),) = disk.replaced()
    assert 59 * 10**9 < until - since < 64 * 10**9
    events = [entry.data for entry in disk.entries if entry.topic == "/log"]
    assert len(events) <= 6
    _, second = numbered(disk.samples("/meter1/flow"))
    assert len(second) >= 7


def test_one_unanswered_poll_in_a_minute_is_long_enough_for_another_device() -> None:
    disk = Disk()
    run(record(disk, [(90, 1), (60, None), (200, 2)], settings(poll=60_000 * MS)))
    assert len(disk.begun) == 1
    assert [len(numbers) for numbers in numbered(disk.samples("/meter1/flow"))] == [2, 3]


def test_the_next_one_may_tell_who_it_is_long_before_it_is_read() -> None:
    disk = Disk()
    steps: list[Step] = [(10, 1), (20, None), (30, 2, {"mute": {100}}), (10, 2, {"mute": ()})]
    run(record(disk, steps, settings(replace(METER, stamped=()))))
    ((since, until),) = disk.replaced()
    of_the_first, of_the_next = [gap for gap in gaps(disk.entries) if gap.reason == Reason.UNREAD]
    assert (of_the_first.block, of_the_next.block) == ("flow", "flow")
    assert since <= of_the_first.since < of_the_first.until <= until
    assert 19 <= of_the_first.expected <= 20
    assert until - 10**9 < of_the_next.since <= until
    assert 28 <= of_the_next.expected <= 30
    (start, *_) = [e.log_time for e in disk.entries[disk.begun[0][0] :] if "flow" in e.topic]
    assert of_the_next.until == start


def test_the_gap_begins_where_the_last_device_was_read_however_long_the_disk_takes() -> None:
    start = 1000 * 10**9
    disk = Disk(failing=range(start + 5 * 10**9, start + 60 * 10**9))
    run(record(disk, [(10, 1), (20, None), (60, 2)]))
    gaps = disk.replaced()
    assert len(disk.begun) == 1
    (at, _) = disk.begun[0]
    assert gaps == sorted(gaps)
    for (_, end), (begin, _) in itertools.pairwise(gaps):
        assert end == begin
    flow = [e for e in disk.entries if e.topic == "/meter1/flow"]
    before = [e.log_time for e in disk.entries[:at] if e.topic == "/meter1/flow"]
    after = [e.log_time for e in flow if e.log_time not in before]
    assert gaps[0][0] <= max(before) < min(after) < gaps[-1][1] + 10**9
    assert len(after) > 25


def link_events(disk: Disk) -> list[str]:
    """What is told of the link, without how long it took."""
    found = [e.data for e in disk.entries if e.topic == "/log" and b"meter1.link" in e.data]
    texts = (
        re.findall(rb"(?:[a-z_]+: )?(?:fake: no answer|answer(?:s|ed) again)", d) for d in found
    )
    return [text.decode() for (text,) in texts]


def test_one_poller_that_gets_no_answer_is_told_by_name_and_once() -> None:
    """However often the others get theirs."""
    disk = Disk()
    run(record(disk, [(5, 1), (20, 1, {"mute": {100}}), (5, 1, {"mute": ()})]))
    assert link_events(disk) == ["flow: fake: no answer", "flow: answered again"]
    (gap,) = [gap for gap in gaps(disk.entries) if gap.block == "flow"]
    assert 18 <= gap.expected <= 21


def test_a_silent_device_is_told_as_one() -> None:
    disk = Disk()
    run(record(disk, [(5, 1), (20, None), (5, 1)], settings(replace(METER, stamped=()))))
    assert link_events(disk) == ["fake: no answer", "answers again"]

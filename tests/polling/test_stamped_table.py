"""Inputs with time stamps over a bus in virtual time; their stamps come from a test device."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

import pytest
from bus_fakes import MS, PERMITTED, START, TCP, FakeLink, VirtualClock, now, outcome, run
from mei_stamps import octets
from told import gaps
from wire import mbap_frame

from roclog.bus.bus import Bus
from roclog.bus.tally import Tally
from roclog.changes import ChangeMemory
from roclog.clock import Instant
from roclog.errors import NoAnswer
from roclog.modbus.stamped import Layout
from roclog.outbox import Outbox
from roclog.polling.clock_watch import ClockWatch
from roclog.polling.stamped_table import StampedTable
from roclog.register_map import StampedInputs, Table
from roclog.schema import CLOCK_OFFSET, InputChange, Reason, stamped_type
from roclog.stamped_messages import StampedMaker
from roclog.stamps import StampDecoder, parse_zone
from roclog.time_flags import TimeFlag

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.recording.entries import Entry

BERLIN: Final = "Europe/Berlin"
SECOND, MINUTE, HOUR = 10**9, 60 * 10**9, 3600 * 10**9
TABLE = Table.INPUT_REGISTERS
INFERRED, SU = TimeFlag.DATE_INFERRED, TimeFlag.SU
AMBIGUOUS = TimeFlag.TIME_AMBIGUOUS


def utc(text: str) -> int:
    at = datetime.fromisoformat(text).replace(tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return (at.days * 86_400 + at.seconds) * SECOND + at.microseconds * 1000


@dataclass
class Wall:
    """The clock of the host: what it shows when the loop starts."""

    start: int

    def now(self) -> Instant:
        return Instant(self.start + now() - START, now())

    def pause(self, nanoseconds: int) -> None:
        VirtualClock().pause(nanoseconds)


@dataclass
class Disk:
    """A writer that keeps what it is given in memory."""

    entries: list[Entry] = field(default_factory=list)
    notes: list[Entry] = field(default_factory=list)
    carried: dict[str, Mapping[str, object]] = field(default_factory=dict)

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        self.entries += entries
        return _done()

    def note(self, entries: Sequence[Entry]) -> Future[None]:
        self.notes += entries
        return _done()

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]:
        self.carried[topic] = values
        return _done()

    @property
    def states(self) -> list[dict[str, Any]]:
        found = [e.data for e in self.entries if e.topic == f"/rtu7/{TABLE}"]
        kinds = [stamped_type("mei-timestamped", TABLE, size) for size in (7, 4)]
        return [next(v for kind in kinds if (v := kind.unpack(data))) for data in found]

    @property
    def times(self) -> list[tuple[int, TimeFlag]]:
        return [(state["device_time"], TimeFlag(state["time_flags"])) for state in self.states]

    @property
    def gaps(self) -> list[tuple[int, int, Reason]]:
        """From, to, reason."""
        found = gaps(self.entries)
        assert {gap.block for gap in found} <= {"discrete_inputs", "input_registers"}
        return [(gap.since, gap.until, gap.reason) for gap in found]


def _done() -> Future[None]:
    done: Future[None] = Future()
    done.set_result(None)
    return done


@dataclass
class Device:
    """Registers with stamps. after: ns until it answers. refused: counts that it does not read.

    mute: addresses that it does not answer for.
    """

    inputs: dict[int, tuple[int, bytes]] = field(default_factory=dict)
    after: int = MS
    silent: bool = False
    refused: tuple[int, ...] = ()
    mute: tuple[int, ...] = ()
    grouped: bool = False
    asked: list[tuple[int, int]] = field(default_factory=list)

    def attach(self, link: FakeLink) -> None:
        link.on_send = lambda adu: self._take(link, adu)

    def _take(self, link: FakeLink, adu: bytes) -> None:
        if self.silent:
            return
        mei, address, count = adu[8], int.from_bytes(adu[9:11]), int.from_bytes(adu[11:13])
        self.asked.append((address, count))
        if address in self.mute:
            return
        pdu = bytes([0xAB, mei, 2])
        if count not in self.refused:
            size = {0x84: 7, 0x94: 4}[mei]
            read = [self.inputs[address + n] for n in range(count)]
            pairs = [(value.to_bytes(2), stamp[:size]) for value, stamp in read]
            body = b"".join(value + stamp for value, stamp in pairs)
            if self.grouped:
                body = b"".join(v for v, _ in pairs) + b"".join(stamp for _, stamp in pairs)
            pdu = bytes([0x2B, mei, len(body)]) + body
        link.say(mbap_frame(int.from_bytes(adu[:2]), adu[6], pdu), self.after)


@dataclass
class Bench:
    """A poller on one list from address 0 on; stands for one run of the logger."""

    wall: Wall
    device: Device
    disk: Disk
    table: StampedTable
    clock: ClockWatch

    def state(self, address: int = 0, *, at: int | None = None, value: int = 0) -> None:
        """The input changes; at: UTC ns of its stamp, default now."""
        self.device.inputs[address] = value, octets(self.wall.now().utc if at is None else at)

    async def turn(self, after: int = 0) -> None:
        await asyncio.sleep(after / 1e9)
        await self.table.turn(now())


def bench(
    wall: Wall,
    *,
    stamp: int = 7,
    count: int = 1,
    zone: str = "UTC",
    lenient: bool = False,
    layout: Layout | None = Layout.INTERLEAVED,
    before: Disk | None = None,
) -> Bench:
    """before: what an earlier run left."""
    disk, link, device = Disk(), FakeLink(), Device()
    carry: Mapping[str, Any] = {"seq": 0, "states": "", "read_at": 0}
    if before is not None:
        carry = before.carried[f"/rtu7/{TABLE}"]
    device.attach(link)
    outbox = Outbox("rtu7", disk, wall)
    clock = ClockWatch("rtu7", outbox)
    table = StampedTable(
        unit=1,
        bus=Bus(link, TCP, wall, PERMITTED),
        tally=Tally(),
        lists=[StampedInputs(table=TABLE, stamp=stamp, address=0, count=count, layout=layout)],
        maker=StampedMaker("rtu7", "mei-timestamped", TABLE, b"e" * 16, carry["seq"]),
        decoder=StampDecoder(parse_zone(zone), lenient=lenient),
        memory=ChangeMemory(carry["states"]),
        clock=clock,
        outbox=outbox,
        period=SECOND,
        read_until=carry["read_at"],
    )
    return Bench(wall, device, disk, table, clock)


def recorded(
    stamp: bytes, at: int, zone: str = BERLIN, *, lenient: bool = False, ago: int = SECOND
) -> tuple[int, TimeFlag]:
    """Time and flags of an input that changed to this stamp since a read that long before ``at``.

    It is read a second after ``at``.
    """
    disk = Disk()

    async def main() -> None:
        nonlocal disk
        made = bench(Wall(at - ago), stamp=len(stamp), zone=zone, lenient=lenient)
        disk = made.disk
        made.device.inputs[0] = 1, octets(at - 2 * HOUR, zone)
        await made.turn()
        made.device.inputs[0] = 2, stamp
        await made.turn(ago + SECOND)

    run(main())
    assert [state["change"] for state in disk.states] == [InputChange.BASELINE, InputChange.CHANGED]
    return disk.times[-1]


INSTANTS: dict[str, TimeFlag] = {
    "2026-03-28T22:59:59.999": TimeFlag(0),
    "2026-03-28T23:00:00.001": TimeFlag(0),  # midnight of the day on which clocks go forward
    "2026-03-29T00:59:59.999": TimeFlag(0),  # 01:59:59.999, the last of winter
    "2026-03-29T01:00:00.000": SU,  # 03:00
    "2026-03-29T21:59:59.999": SU,
    "2026-03-29T22:00:00.000": SU,
    "2026-06-30T21:59:59.999": SU,
    "2026-06-30T22:00:00.000": SU,  # midnight
    "2026-10-24T23:59:59.999": SU,
    "2026-10-25T00:00:00.000": SU | AMBIGUOUS,  # 02:00 for the first time
    "2026-10-25T00:59:59.999": SU | AMBIGUOUS,
    "2026-10-25T01:00:00.000": AMBIGUOUS,  # 02:00 again
    "2026-10-25T01:59:59.999": AMBIGUOUS,
    "2026-10-25T02:00:00.000": TimeFlag(0),
    "2026-12-31T22:59:59.999": TimeFlag(0),
    "2026-12-31T23:00:00.001": TimeFlag(0),  # New Year
    "2028-02-28T23:00:00.001": TimeFlag(0),  # 29 February
    "2028-02-29T22:59:59.999": TimeFlag(0),
    "2028-02-29T23:00:00.001": TimeFlag(0),
}
"""UTC, and the flags of that instant in Berlin."""


@pytest.mark.parametrize("size", [7, 4])
@pytest.mark.parametrize("instant", INSTANTS)
@pytest.mark.parametrize("ago", [SECOND, 20 * MINUTE])
def test_the_edges_of_days_years_and_clocks(instant: str, size: int, ago: int) -> None:
    at = utc(instant)
    inferred = INFERRED if size == 4 else TimeFlag(0)
    stamp = octets(at, BERLIN)[:size]
    assert recorded(stamp, at, ago=ago) == (at, INSTANTS[instant] | inferred)


@pytest.mark.parametrize("size", [7, 4])
@pytest.mark.parametrize(
    ("instant", "zone"), [("2026-12-31T23:00", BERLIN), ("2028-02-29T00:00", "UTC")]
)
def test_midnight_itself(instant: str, zone: str, size: int) -> None:
    """Four octets of zeros are what a stamp that was never set looks like."""
    at = utc(instant)
    right = (0, TimeFlag.NO_TIME) if size == 4 else (at, TimeFlag(0))
    assert recorded(octets(at, zone)[:size], at, zone) == right


@pytest.mark.parametrize("size", [7, 4])
def test_a_device_that_never_marks_summer_time(size: int) -> None:
    inferred = INFERRED if size == 4 else TimeFlag(0)

    def unmarked(at: int) -> bytes:
        stamp = bytearray(octets(at, BERLIN)[:size])
        stamp[3] &= 0x7F
        return bytes(stamp)

    summer = utc("2026-07-01T10:20:30.456")
    wrong = TimeFlag.SU_CONTRADICTION
    assert recorded(unmarked(summer), summer) == (0, wrong | inferred)
    forgiven = summer, wrong | TimeFlag.LENIENT | inferred
    assert recorded(unmarked(summer), summer, lenient=True) == forgiven


@pytest.mark.parametrize("lenient", [False, True])
def test_a_device_that_never_marks_summer_time_when_clocks_go_back(*, lenient: bool) -> None:
    """In the first of the two hours it is an hour late by its digits, and that is marked."""
    first = utc("2026-10-25T00:30:00")
    stamp = bytearray(octets(first, BERLIN))
    stamp[3] &= 0x7F
    later = first + HOUR, AMBIGUOUS | TimeFlag.FUTURE
    assert recorded(bytes(stamp), first, lenient=lenient) == later
    forgiven = TimeFlag.LENIENT if lenient else TimeFlag(0)
    unknown = 0, TimeFlag.SU_CONTRADICTION | TimeFlag.DATE_UNKNOWN | forgiven
    assert recorded(bytes(stamp[:4]), first, lenient=lenient) == unknown


@pytest.mark.parametrize("size", [7, 4])
def test_a_time_that_the_clocks_skip(size: int) -> None:
    at = utc("2026-03-29T01:30:00")  # 02:30 winter time, which the zone shows as 03:30
    stamp = bytearray(octets(at, BERLIN))
    stamp[3] = 2
    inferred = INFERRED if size == 4 else TimeFlag(0)
    found = recorded(bytes(stamp[:size]), at)
    assert found == (0, TimeFlag.TIME_NONEXISTENT | inferred)


def test_an_unchanged_stamp_without_a_date_stays_on_its_day() -> None:
    """For three days, and into a run that begins on the fourth."""
    at = utc("2026-12-30T23:59:30.250")

    async def main() -> None:
        made = bench(Wall(at + SECOND), stamp=4)
        made.state(at=at)
        for _ in range(72):
            await made.turn(HOUR)
        assert made.disk.times == [(at, INFERRED)]
        made.table.close(made.wall.now())
        await asyncio.sleep(86_400)
        again = bench(made.wall, stamp=4, before=made.disk)
        again.device.inputs = made.device.inputs
        await again.turn()
        assert again.disk.states == []
        changed = again.wall.now().utc // MS * MS
        again.state(at=changed, value=1)
        await again.turn(SECOND)
        (state,) = again.disk.states
        assert (state["seq"], state["change"]) == (2, InputChange.CHANGED)
        assert (state["device_time"], state["time_flags"]) == (changed, INFERRED)

    run(main())


@pytest.mark.parametrize(
    ("ahead", "days"), [(-23 * HOUR, 0), (-MS, 0), (9 * MINUTE, 0), (11 * MINUTE, -1)]
)
def test_a_baseline_has_the_nearest_date_not_later_than_the_host(ahead: int, days: int) -> None:
    read = utc("2026-11-23T12:00:00.000")

    async def main() -> None:
        made = bench(Wall(read), stamp=4)
        made.state(at=read + ahead)
        await made.turn()
        assert made.disk.times == [(read + ahead + days * 24 * HOUR, INFERRED)]

    run(main())


def test_a_long_list_that_is_new_is_recorded_whole() -> None:
    """More baselines than an outbox holds while it waits for the disk."""

    async def main() -> None:
        made = bench(Wall(utc("2026-11-23T12:00:00")), count=3000)
        for address in range(3000):
            made.state(address, at=made.wall.start - address * MS)
        await made.turn()
        await made.turn(SECOND)
        states = made.disk.states
        assert [(state["seq"], state["address"]) for state in states] == [
            (n + 1, n) for n in range(3000)
        ]
        assert made.disk.gaps == []

    run(main())


def test_time_in_which_nobody_looked() -> None:
    """One gap for all requests of a list, from the last answer before to the first behind."""
    wall = Wall(utc("2026-11-23T12:00:00"))

    async def main() -> None:
        made = bench(wall, count=60)
        for address in range(60):
            made.state(address, at=wall.start)
        await made.turn()
        await made.turn(SECOND)
        assert made.disk.gaps == []
        last = wall.now().utc
        made.device.silent = True
        assert isinstance(await outcome(_answerless(made)), NoAnswer)
        made.device.silent = False
        await made.turn(60 * SECOND)
        ((since, until, reason),) = made.disk.gaps
        assert (reason, until) == (Reason.UNREAD, wall.now().utc)
        assert last - 10 * MS < since < last
        made.table.close(wall.now())
        seen = wall.now().utc
        await asyncio.sleep(3600)
        again = bench(wall, count=60, before=made.disk)
        again.device.inputs = made.device.inputs
        await again.turn()
        ((since, until, reason),) = again.disk.gaps
        assert (reason, until) == (Reason.DOWNTIME, wall.now().utc)
        assert seen - 10 * MS < since < seen

    run(main())


def test_who_is_silent_at_the_start_and_at_the_end_has_a_gap_there() -> None:
    wall = Wall(utc("2026-11-23T12:00:00"))

    async def main() -> None:
        made = bench(wall)
        made.state()
        began = wall.now().utc
        made.device.silent = True
        for _ in range(3):
            assert isinstance(await outcome(_answerless(made)), NoAnswer)
        made.device.silent = False
        await made.turn(SECOND)
        read = wall.now().utc
        assert made.disk.gaps == [(began + SECOND, read, Reason.UNREAD)]
        made.device.silent = True
        for _ in range(2):
            assert isinstance(await outcome(_answerless(made)), NoAnswer)
        made.table.close(wall.now())
        await made.table.outbox.flush()
        _, (since, until, reason) = made.disk.gaps
        assert read - 10 * MS < since < read
        assert (until, reason) == (wall.now().utc, Reason.UNREAD)
        last = made.disk.entries[-1]
        assert last.carry is not None
        assert (last.carry["read_at"], last.carry_topic) == (until, "/rtu7/input_registers")

    run(main())


async def _answerless(made: Bench) -> Any:
    await made.turn(SECOND)


def test_inputs_that_are_never_answered_for_keep_no_others_from_being_read() -> None:
    wall = Wall(utc("2026-11-23T12:00:00"))

    async def main() -> None:
        made = bench(wall, count=60)
        for address in range(60):
            made.state(address, at=wall.start)
        made.device.mute = (0,)
        for _ in range(3):
            assert isinstance(await outcome(_answerless(made)), NoAnswer)
        read = {state["address"] for state in made.disk.states}
        first = made.device.asked[0][1]
        assert read == set(range(first, 60))
        assert [address for address, _ in made.device.asked].count(0) == 3

    run(main())


def test_a_slow_answer_is_no_error_of_the_clock() -> None:
    """What happens while an answer is on its way is stamped before that answer is read."""

    async def main() -> None:
        made = bench(Wall(utc("2026-11-23T12:00:00")))
        made.device.after = 300 * MS
        made.state()
        for value in range(1, 20):
            turn = asyncio.ensure_future(made.turn(SECOND))
            await asyncio.sleep(1.001)
            made.state(value=value)
            await turn
        assert len(made.disk.states) == 19
        made.clock.report(made.wall.now())
        (note,) = made.disk.notes
        told = CLOCK_OFFSET.unpack(note.data)
        assert told is not None
        assert abs(told["offset"]) <= told["uncertainty"]
        for state in made.disk.states[1:]:
            assert state["previous_read_at"] - MS <= state["device_time"] <= state["read_at"]

    run(main())


def test_a_layout_that_cannot_be_asked_for_shows_in_the_stamps() -> None:
    """Also where they are older than half a day and have no date."""
    wall = Wall(utc("2026-11-23T12:00:00"))

    async def main() -> None:
        made = bench(wall, stamp=4, count=3, layout=None)
        made.device.refused, made.device.grouped = (1, 2), True
        for address in range(3):
            made.state(address, at=wall.start - 14 * HOUR - address * MS, value=0xFFFF)
        await made.turn()
        assert [state["value"] for state in made.disk.states] == 3 * [0xFFFF]
        assert made.disk.times == [(wall.start - 14 * HOUR - n * MS, INFERRED) for n in range(3)]

    run(main())

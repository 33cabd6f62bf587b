"""Blocks read on schedule, over a bus whose other end answers every register with its address."""

from __future__ import annotations

import asyncio
import dataclasses
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bus_fakes import MS, START, UTC_OFFSET, FakeLink, VirtualClock, answer_to, make, now, run
from told import gaps
from wire import rtu_frame

from roclog.bus.tally import Tally
from roclog.errors import ExceptionAnswer, LinkDown, NoAnswer, StorageError
from roclog.outbox import CommitGroup, Outbox
from roclog.polling.clock_watch import ClockWatch
from roclog.polling.cyclic_block import CyclicBlock
from roclog.polling.cyclic_blocks import CyclicBlocks
from roclog.register_map import (
    Block,
    Change,
    ClearOnRead,
    Counter,
    Point,
    Table,
    WordOrder,
    WordType,
)
from roclog.request_plan import read_request
from roclog.samples import SampleMaker
from roclog.schema import Origin, Reason, read_signature
from roclog.triggers import Known

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.bus.bus import Bus
    from roclog.recording.entries import Entry
    from roclog.register_map import Trigger

SECOND = 10**9
UNIT = 138


def block(name: str, address: int, count: int, *, atomic: bool = True) -> Block:
    point = Point(name="first", offset=0, type=WordType.U16)
    return Block(
        name=name,
        table=Table.HOLDING_REGISTERS,
        address=address,
        count=count,
        points=(point,),
        atomic=atomic,
    )


@dataclass
class Disk:
    """A writer that keeps what it is given in memory. full: it takes nothing."""

    committed: list[Entry] = field(default_factory=list)
    carried: dict[str, Mapping[str, object]] = field(default_factory=dict)
    commits: int = 0
    full: bool = False
    notes: list[Entry] = field(default_factory=list)

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        done: Future[None] = Future()
        if self.full:
            done.set_exception(StorageError(Path("/disk"), "full"))
            return done
        self.commits += 1
        self.committed += entries
        done.set_result(None)
        return done

    def note(self, entries: Sequence[Entry]) -> Future[None]:
        self.notes += entries
        done: Future[None] = Future()
        done.set_result(None)
        return done

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]:
        self.carried[topic] = values
        done: Future[None] = Future()
        done.set_result(None)
        return done

    def samples(self, topic: str) -> list[tuple[int, str]]:
        """(seq, raw) in the order of the disk."""
        found = []
        for entry in self.committed:
            values = read_signature(entry.data) if entry.topic == topic else None
            if values is not None:
                assert values["origin"] in (Origin.CYCLIC, Origin.FLAG)
                found.append((values["seq"], values["raw"].hex()))
        return found

    def gaps(self) -> list[tuple[int, int]]:
        """(reason, expected)."""
        return [(gap.reason, gap.expected) for gap in gaps(self.committed)]


def poller(
    bus: Bus,
    disk: Disk,
    *blocks: Block,
    seq: int = 0,
    read_until: int = 0,
    cycle: int | None = None,
) -> tuple[CyclicBlocks, CommitGroup]:
    group = CommitGroup(disk)
    outbox = Outbox("flow", disk, VirtualClock(), group)
    makers = [SampleMaker("flow", "registers", b, WordOrder.ABCD, b"e" * 16) for b in blocks]
    members = [CyclicBlock(m, SECOND, Known(seq), read_until, cycle=cycle) for m in makers]
    made = CyclicBlocks(
        unit=UNIT,
        bus=bus,
        tally=Tally(),
        blocks=members,
        period=SECOND,
        outbox=outbox,
        clock_watch=ClockWatch("flow", outbox),
    )
    return made, group


def test_neighbours_share_a_request_and_each_gets_its_own_sample() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        blocks, group = poller(
            bus, disk, block("a", 100, 2, atomic=False), block("b", 102, 1, atomic=False)
        )
        await blocks.turn(now())
        await group.finish()
        assert [adu[2:6].hex() for _, adu in link.sent] == ["00640003"]
        assert disk.samples("/flow/a") == [(1, "00640065")]
        assert disk.samples("/flow/b") == [(1, "0066")]
        assert blocks.samples == 2

    run(main())


def test_a_block_larger_than_an_answer_is_one_sample() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        blocks, group = poller(bus, disk, block("a", 0, 200, atomic=False))
        await blocks.turn(now())
        await group.finish()
        assert len(link.sent) == 2
        expected = b"".join(n.to_bytes(2) for n in range(200)).hex()
        assert disk.samples("/flow/a") == [(1, expected)]

    run(main())


def test_a_refused_block_keeps_no_other_from_being_read() -> None:
    async def main() -> None:
        link, bus = make()
        refusal = rtu_frame(UNIT, b"\x83\x02")
        link.on_send = lambda adu: link.say(refusal if adu[3] == 100 else answer_to(adu))
        disk = Disk()
        blocks, group = poller(bus, disk, block("a", 100, 1), block("b", 200, 1))
        for _ in range(3):
            await blocks.turn(now())
            await asyncio.sleep(1)
        await group.finish()
        assert disk.samples("/flow/a") == []
        assert [seq for seq, _ in disk.samples("/flow/b")] == [1, 2, 3]
        told = [entry for entry in disk.committed + disk.notes if entry.topic == "/log"]
        assert len(told) == 1  # told once, asked every time
        assert sum(adu[3] == 100 for _, adu in link.sent) == 3
        assert len(link.sent) == 6  # nothing else is asked

    run(main())


def test_reads_that_failed_are_a_gap_with_their_number() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        blocks, group = poller(bus, disk, block("a", 100, 1))
        await blocks.turn(now())
        link.on_send = None
        for _ in range(3):
            await asyncio.sleep((START + SECOND - now()) % SECOND / SECOND)
            with pytest.raises(NoAnswer):
                await blocks.turn(now())
        link.on_send = lambda adu: link.say(answer_to(adu))
        await asyncio.sleep((START + SECOND - now()) % SECOND / SECOND)
        before = now()
        await blocks.turn(before)
        await group.finish()
        assert disk.gaps() == [(Reason.UNREAD, round((before - START) / SECOND) - 1)]
        assert [seq for seq, _ in disk.samples("/flow/a")] == [1, 2]

    run(main())


def test_the_time_between_two_runs_is_a_gap_before_the_first_sample() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        until = VirtualClock().now().utc - 5 * SECOND
        blocks, group = poller(bus, disk, block("a", 100, 1), seq=41, read_until=until)
        await blocks.turn(now())
        await group.finish()
        assert disk.gaps() == [(Reason.DOWNTIME, 4)], "the fifth is the read that was made"
        assert disk.committed[0].topic == "/flow/gap"
        assert disk.samples("/flow/a") == [(42, "0064")]
        blocks.close(VirtualClock().now())
        assert disk.carried["/flow/a"]["seq"] == 42

    run(main())


def test_a_full_disk_costs_nothing_until_a_thousand_wait_then_says_how_many() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk(full=True)
        blocks, group = poller(bus, disk, block("a", 100, 1))
        for _ in range(1010):
            await blocks.turn(now())
            await group.finish()
            await asyncio.sleep((START - now()) % SECOND / SECOND)
        disk.full = False
        for _ in range(2):
            await blocks.turn(now())
            await group.finish()
            await asyncio.sleep((START - now()) % SECOND / SECOND)
        numbers = [seq for seq, _ in disk.samples("/flow/a")]
        lost = [expected for reason, expected in disk.gaps() if reason == Reason.STORAGE]
        assert len(numbers) == len(set(numbers))
        assert numbers == sorted(numbers)
        assert len(numbers) + sum(lost) == blocks.samples == 1012

    run(main())


def test_a_run_without_a_sample_leaves_what_the_trigger_compares_with() -> None:
    """Else the run after it would take the unchanged block for news."""

    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        changing = dataclasses.replace(block("a", 100, 1), trigger=Change())
        maker = SampleMaker("flow", "registers", changing, WordOrder.ABCD, b"e" * 16)
        outbox = Outbox("flow", disk, VirtualClock(), CommitGroup(disk))
        answer = await bus.transact(UNIT, read_request(changing), Tally())
        one = CyclicBlock(maker, SECOND, maker.known(7, answer.pdu[2:]), 0, answer.pdu[2:])
        one.begin(now())
        assert one.take(answer.pdu[2:], answer, answer.asked, outbox, due=now()) is None
        one.close(now(), VirtualClock().now(), outbox, is_end=True)
        carried = disk.carried["/flow/a"]
        assert (carried["seq"], carried["raw"]) == (7, "0064")

    run(main())


def test_how_far_a_block_was_read_is_not_said_before_its_samples_are_on_disk() -> None:
    """A kill in between would make what was lost look recorded."""

    async def main() -> None:
        link, bus = make()
        Registers(link)
        disk = Disk()
        blocks, group = poller(bus, disk, block("a", 0, 1))
        await blocks.turn(now())
        blocks.close(VirtualClock().now())
        assert disk.carried == {}
        await group.finish()
        blocks.close(VirtualClock().now())
        assert disk.carried["/flow/a"]["seq"] == 1

    run(main())


def test_one_commit_for_all_devices() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        blocks, group = poller(bus, disk, block("a", 100, 1))
        for _ in range(5):
            await blocks.turn(now())
        await group.finish()
        assert disk.commits == 1
        assert len(disk.samples("/flow/a")) == 5

    run(main())


@dataclass
class Registers:
    """The other end of a line: registers 0 to 9 and a coil, as a test sets them."""

    link: FakeLink
    words: list[int] = field(default_factory=lambda: [0] * 10)
    coil: int = 0
    is_silent: bool = False
    delay: int = 0

    def __post_init__(self) -> None:
        self.link.on_send = self._take

    def _take(self, adu: bytes) -> None:
        first, count = int.from_bytes(adu[2:4]), int.from_bytes(adu[4:6])
        if adu[1] == 1:
            spare = 0xFE  # says nothing
            self.link.say(rtu_frame(UNIT, bytes([1, 1, spare | self.coil])), self.delay)
        elif not self.is_silent:
            data = b"".join(word.to_bytes(2) for word in self.words[first : first + count])
            self.link.say(rtu_frame(UNIT, bytes([adu[1], len(data)]) + data), self.delay)


def triggered(trigger: Trigger | None, count: int = 2) -> Block:
    return dataclasses.replace(block("a", 0, count), trigger=trigger)


async def next_second(seconds: int = 1) -> None:
    await asyncio.sleep(((START - now()) % SECOND + (seconds - 1) * SECOND) / SECOND)


FLAG_IN_COIL = ClearOnRead(table=Table.COILS, address=5)
FLAG_IN_BLOCK = ClearOnRead(table=Table.HOLDING_REGISTERS, address=1)


def test_a_flag_elsewhere_that_is_down_is_no_gap() -> None:
    """The block is not read then; all the same it is known that there was nothing new in it."""

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 0]), Disk()
        blocks, group = poller(bus, disk, triggered(FLAG_IN_COIL))
        for coil in (1, 0, 0, 0, 1):
            device.coil = coil
            await blocks.turn(now())
            await next_second()
        await group.finish()
        assert [seq for seq, _ in disk.samples("/flow/a")] == [1, 2]
        assert disk.gaps() == []
        assert [adu[1] for _, adu in link.sent] == [1, 3, 1, 1, 1, 1, 3]

    run(main())


@pytest.mark.parametrize("trigger", [FLAG_IN_COIL, FLAG_IN_BLOCK])
def test_a_read_that_clears_and_is_not_answered_is_a_gap_however_short(trigger: Trigger) -> None:
    """Its turn was late, so that by the time alone none was left out."""

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 1], coil=1), Disk()
        blocks, group = poller(bus, disk, triggered(trigger))
        await asyncio.sleep(0.6)
        await blocks.turn(START)
        await next_second()
        device.is_silent = True
        with pytest.raises(NoAnswer):
            await blocks.turn(now())
        device.is_silent, device.coil, device.words[1] = False, 0, 0
        await asyncio.sleep(0.1)
        await blocks.turn(now())
        await next_second()
        await blocks.turn(now())
        await group.finish()
        assert [seq for seq, _ in disk.samples("/flow/a")] == [1]
        (gap,) = gaps(disk.committed)
        assert (gap.reason, gap.expected, gap.possible) == (Reason.UNREAD, 0, True)

    run(main())


@pytest.mark.parametrize("trigger", [FLAG_IN_COIL, FLAG_IN_BLOCK])
def test_a_sample_may_complete_while_the_answer_without_it_is_on_the_wire(trigger: Trigger) -> None:
    """What is lost next completed after the last request, not only after its answer."""

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 0], delay=300 * MS), Disk()
        blocks, group = poller(bus, disk, triggered(trigger))
        await blocks.turn(now())
        asked = UTC_OFFSET + link.sent[-1][0]
        device.words[1] = device.coil = 1
        device.is_silent = True
        await next_second()
        with pytest.raises(NoAnswer):
            await blocks.turn(now())
        device.is_silent, device.coil, device.words[1] = False, 0, 0
        await next_second()
        await blocks.turn(now())
        await group.finish()
        (gap,) = gaps(disk.committed)
        assert (gap.since, gap.expected, gap.possible) == (asked, 0, True)
        blocks.close(VirtualClock().now())
        assert disk.carried["/flow/a"]["read_at"] == UTC_OFFSET + link.sent[-1][0], (
            "nor does a later run know more"
        )

    run(main())


def test_a_gateway_that_says_nobody_answered_is_a_read_without_an_answer() -> None:
    """It may have cleared all the same; and the device is not there."""

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 1]), Disk()
        blocks, group = poller(bus, disk, triggered(FLAG_IN_BLOCK))
        await asyncio.sleep(0.6)
        await blocks.turn(START)
        await next_second()
        hear, link.on_send = link.on_send, lambda adu: link.say(rtu_frame(adu[0], b"\x83\x0b"))
        with pytest.raises(ExceptionAnswer, match="gateway"):
            await blocks.turn(now())
        link.on_send, device.words[1] = hear, 0
        await asyncio.sleep(0.1)
        await blocks.turn(now())
        await group.finish()
        assert disk.gaps() == [(Reason.UNREAD, 0)]

    run(main())


def test_the_very_first_read_that_clears_may_have_taken_a_sample_too() -> None:
    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 1], is_silent=True), Disk()
        blocks, group = poller(bus, disk, triggered(FLAG_IN_BLOCK))
        began = VirtualClock().now().utc
        with pytest.raises(NoAnswer):
            await blocks.turn(now())
        device.is_silent = False
        await next_second()
        await blocks.turn(now())
        await group.finish()
        (gap,) = gaps(disk.committed[:1])
        assert (gap.since, gap.expected, gap.possible) == (began, 0, True)
        assert [seq for seq, _ in disk.samples("/flow/a")] == [1]

    run(main())


@pytest.mark.parametrize(("cycle", "possible", "missed"), [(None, 1, 25_536), (SECOND, 1, 1)])
def test_a_counter_cannot_grow_by_more_than_the_time_allows(
    cycle: int | None, possible: int, missed: int
) -> None:
    """A device of 16 bits that begins again at 0 looks as if it had missed thousands.

    Without a cycle nobody can tell; with one, only what came after the restart may be missing.
    """

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link), Disk()
        blocks, group = poller(bus, disk, triggered(Counter(point="first")), cycle=cycle)
        for number in (39_999, 40_000, 1):
            device.words[0] = number
            await blocks.turn(now())
            await next_second()
        await group.finish()
        assert [seq for seq, _ in disk.samples("/flow/a")] == [1, 2, 3]
        (gap,) = gaps(disk.committed)
        assert (gap.possible, gap.expected) == (bool(possible), missed)

    run(main())


def test_a_block_that_is_never_answered_keeps_no_other_from_being_read() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: None if adu[3] == 50 else link.say(answer_to(adu))
        disk = Disk()
        dead, large = block("dead", 50, 1), block("large", 100, 130, atomic=False)
        blocks, group = poller(bus, disk, dead, block("b", 0, 1), large)
        with pytest.raises(NoAnswer):
            await blocks.turn(now())  # nobody knows yet whether anybody is there
        await next_second(2)
        for _ in range(3):
            await blocks.turn(now())
            await next_second(2)
        link.on_send = lambda adu: link.say(answer_to(adu))
        for _ in range(2):
            await blocks.turn(now())
            await next_second()
        await group.finish()
        assert [len(disk.samples(f"/flow/{name}")) for name in ("dead", "b", "large")] == [2, 5, 5]
        whole = [50, 0, 100, 225]
        order = [adu[3] for _, adu in link.sent]
        assert order == [50, 0, 100, 225, 50, *whole * 4]
        told = [e.data for e in (*disk.committed, *disk.notes) if b"flow.silent" in e.data]
        assert [b"block dead is not answered for" in data for data in told] == [True, False]
        assert b"block dead answered again" in told[1]

    run(main())


def test_a_block_of_which_a_part_is_lost_is_begun_anew() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: None if adu[3] == 125 else link.say(answer_to(adu))
        disk = Disk()
        large, other = block("large", 0, 300, atomic=False), block("z", 400, 1, atomic=False)
        blocks, group = poller(bus, disk, large, other)
        for _ in range(2):
            await blocks.turn(now())
            await next_second(2)
        assert [int.from_bytes(adu[2:4]) for _, adu in link.sent] == [0, 125, 400] * 2
        link.on_send = lambda adu: link.say(answer_to(adu))
        await blocks.turn(now())
        await group.finish()
        (sample,) = disk.samples("/flow/large")
        assert sample == (1, b"".join(n.to_bytes(2) for n in range(300)).hex())
        assert len(disk.samples("/flow/z")) == 3


def test_a_device_that_dies_costs_two_time_outs_then_one_a_turn() -> None:
    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: link.say(answer_to(adu))
        disk = Disk()
        blocks, group = poller(bus, disk, *(block(f"b{n}", 100 * n, 1) for n in range(5)))
        await blocks.turn(now())
        link.on_send = None
        asked = []
        for _ in range(4):
            before = len(link.sent)
            await next_second(5)
            with pytest.raises(NoAnswer):
                await blocks.turn(now())
            asked.append([int.from_bytes(adu[2:4]) // 100 for _, adu in link.sent[before:]])
        assert asked == [[0, 1], [2], [3], [4]]
        await group.finish()
        assert [e for e in disk.committed if b"silent" in e.data] == []

    run(main())

    run(main())


async def closed(blocks: CyclicBlocks, group: CommitGroup) -> None:
    """The end of a run."""
    await group.finish()
    blocks.close(VirtualClock().now())
    await blocks.outbox.flush()


@pytest.mark.parametrize("trigger", [None, Change(), Counter(point="first"), FLAG_IN_COIL])
def test_what_nobody_answered_before_the_first_read_is_told_with_it(
    trigger: Trigger | None,
) -> None:
    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 1], is_silent=True, coil=1), Disk()
        blocks, group = poller(bus, disk, triggered(trigger))
        began = now()
        for _ in range(3):
            with pytest.raises(NoAnswer):
                await blocks.turn(now())
            await next_second()
        device.is_silent = False
        last = now()
        await blocks.turn(last)
        await closed(blocks, group)
        (gap,) = gaps(disk.committed)
        assert (gap.since, gap.reason, gap.block) == (UTC_OFFSET + began, Reason.UNREAD, "a")
        turns = (last - began) // SECOND
        assert turns >= 3
        assert (gap.expected, gap.possible) == ((0, True) if trigger else (turns, False))
        assert len([entry for entry in disk.committed if entry.topic == "/flow/a"]) == 1

    run(main())


@pytest.mark.parametrize("trigger", [None, Change(), Counter(point="first"), FLAG_IN_COIL])
def test_what_nobody_answered_until_the_end_is_told_there(trigger: Trigger | None) -> None:
    """And the next run begins where this one ended, not where it was read last."""

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 1], coil=1), Disk()
        blocks, group = poller(bus, disk, triggered(trigger))
        first = now()
        await blocks.turn(first)
        read = max(UTC_OFFSET + at for at, _ in link.sent)
        await next_second()
        device.is_silent = True
        for _ in range(3):
            with pytest.raises(NoAnswer):
                await blocks.turn(now())
            await next_second()
        await asyncio.sleep(0.5)
        end = VirtualClock().now().utc
        await closed(blocks, group)
        (gap,) = gaps(disk.committed)
        turns = (end - UTC_OFFSET - first) // SECOND
        assert turns >= 3
        assert (gap.until, gap.reason, gap.block) == (end, Reason.UNREAD, "a")
        assert read <= gap.since <= read + 20 * MS
        assert (gap.expected, gap.possible) == ((0, True) if trigger else (turns, False))
        (told,) = [e for e in disk.committed if e.topic == "/flow/gap"]
        assert told.carry is not None
        until = read if isinstance(trigger, Counter) else end  # the next number tells since then
        assert (told.carry_topic, told.carry["read_at"]) == ("/flow/a", until)

    run(main())


def test_a_block_that_is_refused_all_the_time_is_told_at_the_end() -> None:
    async def main() -> None:
        link, bus = make()
        Registers(link)
        hear = link.on_send
        assert hear is not None

        def answer(adu: bytes) -> None:
            if adu[3] == 50:
                link.say(rtu_frame(UNIT, b"\x83\x02"))
            else:
                hear(adu)

        link.on_send = answer
        disk = Disk()
        blocks, group = poller(bus, disk, block("a", 0, 1), block("other", 50, 1))
        for _ in range(4):
            await blocks.turn(now())
            await next_second()
        await blocks.turn(now())
        await closed(blocks, group)
        (gap,) = gaps(disk.committed)
        assert (gap.block, gap.expected, gap.possible) == ("other", 5, False)
        assert disk.carried["/flow/a"]["seq"] == 5
        assert "/flow/other" not in disk.carried, "it goes with the gap"

    run(main())


def test_a_read_that_is_late_is_none_that_is_missing() -> None:
    """Its turn brought it; only turns that are left out for it are told, each of them once."""

    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link), Disk()
        blocks, group = poller(bus, disk, block("a", 0, 1))
        first = now()
        for lateness in (0.0, 0.7, 0.0, 0.7, 0.0):
            due = first + len(disk.samples("/flow/a")) * SECOND
            await asyncio.sleep((due - now()) / SECOND + lateness)
            await blocks.turn(due)
            await group.finish()
        assert disk.gaps() == []
        device.delay = 400 * MS
        late = first + 5 * SECOND
        await asyncio.sleep((late - now()) / SECOND + 3.2)
        await blocks.turn(late)
        device.delay = 0
        await blocks.turn(late + 3 * SECOND)  # as the schedule goes on
        await group.finish()
        assert disk.gaps() == [(Reason.UNREAD, 2)]
        assert len(disk.samples("/flow/a")) == 7

    run(main())


def test_what_was_not_read_is_told_behind_what_waits_for_the_disk() -> None:
    """Where another device answers, nobody else would tell it."""

    async def main() -> None:
        link, bus = make()
        link.on_send = lambda adu: None if adu[3] == 50 else link.say(answer_to(adu))
        disk = Disk()
        blocks, _ = poller(bus, disk, block("a", 0, 1), block("mute", 50, 1))
        first = now()
        for _ in range(3):
            await blocks.turn(now())
            await next_second(2)
        last = now()
        await blocks.turn(last)
        assert not blocks.outbox.empty
        blocks.close(VirtualClock().now(), is_end=False)
        await blocks.outbox.flush()
        (gap,) = [gap for gap in gaps(disk.committed) if gap.block == "mute"]
        assert (gap.expected, gap.possible) == ((last - first) // SECOND + 1, False)
        assert "/flow/mute" in [entry.carry_topic for entry in disk.committed]

    run(main())


def test_a_request_that_never_left_has_taken_no_sample() -> None:
    async def main() -> None:
        link, bus = make()
        device, disk = Registers(link, words=[7, 0]), Disk()
        blocks, group = poller(bus, disk, triggered(FLAG_IN_BLOCK))
        await blocks.turn(now())
        hear, link.on_send = link.on_send, None
        link.break_off()
        link.open_failures = [OSError(111, "refused")]
        with pytest.raises(LinkDown):
            await blocks.turn(now())
        link.on_send = hear
        await next_second()
        device.words[1] = 1
        await blocks.turn(now())
        await group.finish()
        assert [seq for seq, _ in disk.samples("/flow/a")] == [1]
        assert disk.gaps() == []

    run(main())

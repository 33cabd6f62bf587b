"""The order of reads, commits and clears of one block, against a scripted bus."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pytest
from told import gaps

from roclog.bus.bus import Answer
from roclog.bus.tally import Tally
from roclog.clock import Instant
from roclog.devices import PROFILES
from roclog.errors import ExceptionAnswer, NoAnswer
from roclog.handshake import Memory
from roclog.modbus.request import WriteRegister
from roclog.polling.flagged_block import FlaggedBlock
from roclog.register_map import WordOrder
from roclog.samples import SampleMaker
from roclog.schema import CLEAR, ClearResult, Reason, read_signature

if TYPE_CHECKING:
    from roclog.recording.entries import Entry

MS = 10**6
PROFILE = PROFILES["hiac-roc"]
BLOCK = PROFILE.block("sample")
CYCLE = 400 * MS


@dataclass
class Bench:
    """A clock, a bus and an outbox in one; ``log`` is what happened, in order.

    blocks: (flag, value, milliseconds the answer takes) of each read; the last one repeats.
    """

    blocks: list[tuple[int, int, int]]
    clears: list[Exception | None] = field(default_factory=list)
    disk: list[bool] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    time: int = 10**9
    previous: list[int] = field(default_factory=list)
    guarded: list[bool] = field(default_factory=list)
    results: list[tuple[int, int]] = field(default_factory=list)
    empty: bool = True
    entries: list[Entry] = field(default_factory=list)

    def now(self) -> Instant:
        return Instant(self.time, self.time)

    def pause(self, nanoseconds: int) -> None:
        self.time += nanoseconds

    async def transact(
        self,
        unit: int,
        request: object,
        tally: Tally,
        *,
        due: int = 0,
        not_after: int | None = None,
    ) -> Answer:
        asked = self.now()
        if isinstance(request, WriteRegister):
            self.log.append(f"clear {request.address}={request.value}")
            self.time += 5 * MS
            problem = self.clears.pop(0) if self.clears else None
            if problem is not None:
                raise problem
            return Answer(request.pdu, asked, self.now(), self.now())
        flag, value, took = self.blocks.pop(0) if len(self.blocks) > 1 else self.blocks[0]
        self.time += took * MS
        self.log.append(f"read {value}")
        words = [flag, 0, 0, 0, 0, 10, 0, 0, 0, value, *([0] * 17)]
        pdu = bytes([3, 54]) + b"".join(word.to_bytes(2) for word in words)
        return Answer(pdu, asked, self.now(), self.now())

    def add(self, entry: Entry) -> None:
        self.entries.append(entry)
        sample = read_signature(entry.data)
        if sample is not None:
            self.log.append(f"add {int.from_bytes(sample['raw'][18:20])}")
            self.previous.append(sample["previous_read_at"])
        self.empty = False

    async def flush(self) -> bool:
        if not self.empty:
            done = self.disk.pop(0) if self.disk else True
            self.log.append("committed" if done else "disk full")
            self.empty = done
        return self.empty

    def note(self, entry: object) -> None:
        clear = CLEAR.unpack(getattr(entry, "data", b""))
        if clear is not None:
            self.guarded.append(clear["guarded"])
            self.results.append((clear["result"], clear["exception_code"]))

    def event(self, level: str, kind: str, text: str) -> None:
        del level, text
        self.log.append(f"event {kind}")

    def checkpoint(self, topic: str, carry: object) -> None:
        del topic, carry


def make(
    bench: Bench, memory: Memory, *, cycle: int | None = CYCLE, read_until: int = 0, **more: int
) -> FlaggedBlock:
    block = FlaggedBlock(
        unit=1,
        bus=bench,  # type: ignore[arg-type]
        tally=Tally(),
        maker=SampleMaker("roc1", PROFILE.name, BLOCK, WordOrder.ABCD, b"e" * 16),
        memory=memory,
        outbox=bench,  # type: ignore[arg-type]
        clock=bench,
        acknowledge=True,
        period=100 * MS,
        read_until=read_until,
        **more,
    )
    block.cadence.cycle = cycle
    return block


KNOWN = Memory(seq=3, payload=b"\0\x0a" + bytes(36), restarted=False)


def turn(bench: Bench, block: FlaggedBlock) -> list[str]:
    bench.log.clear()
    asyncio.run(block.turn(0))
    return bench.log


def test_the_straight_path() -> None:
    bench = Bench([(0, 0, 5), (1, 7, 5)])
    block = make(bench, KNOWN)
    assert turn(bench, block) == ["read 0"]
    assert turn(bench, block) == ["read 7", "read 7", "add 7", "committed", "clear 300=0"]
    assert bench.guarded == [True]
    assert bench.previous == [10**9], "it may complete while the answer without it is on its way"


def test_without_a_guard_the_block_is_read_once_more() -> None:
    bench = Bench([(1, 7, 5)])
    expected = ["read 7", "read 7", "add 7", "committed", "read 7", "clear 300=0"]
    assert turn(bench, make(bench, KNOWN)) == expected
    assert bench.guarded == [False]


def test_a_read_that_took_long_says_nothing_about_now() -> None:
    bench = Bench([(1, 7, 5), (1, 7, 5), (1, 7, 300), (1, 7, 5)])
    reads = ["read 7", "read 7", "add 7", "committed", "read 7", "read 7"]
    assert turn(bench, make(bench, KNOWN)) == [*reads, "clear 300=0"]


def test_a_device_that_is_always_slow_is_cleared_in_the_end() -> None:
    bench = Bench([(1, 7, 300)])
    assert turn(bench, make(bench, KNOWN))[-1] == "clear 300=0"


def test_nothing_is_cleared_while_the_disk_takes_nothing() -> None:
    bench = Bench([(0, 0, 5), (1, 7, 5)], disk=[False, False, True])
    block = make(bench, KNOWN)
    turn(bench, block)
    assert turn(bench, block) == ["read 7", "read 7", "add 7", "disk full"]
    assert turn(bench, block) == ["read 7", "disk full"]
    assert turn(bench, block)[:2] == ["read 7", "committed"]
    assert bench.log[-1] == "clear 300=0"


def test_an_unanswered_clear_is_followed_by_a_read_before_the_next() -> None:
    bench = Bench([(0, 0, 5), (1, 7, 5)], clears=[NoAnswer("late")])
    block = make(bench, KNOWN)
    turn(bench, block)
    assert turn(bench, block)[-1] == "clear 300=0"
    assert turn(bench, block) == ["read 7", "clear 300=0"]


def test_a_gateway_that_had_no_answer_to_a_clear_is_no_refusal() -> None:
    """The device may have taken it."""
    bench = Bench([(0, 0, 5), (1, 7, 5)], clears=[ExceptionAnswer(6, 11)])
    block = make(bench, KNOWN)
    turn(bench, block)
    assert turn(bench, block)[-1] == "clear 300=0"
    assert turn(bench, block) == ["read 7", "clear 300=0"]
    assert bench.results == [(ClearResult.UNANSWERED, 11), (ClearResult.DONE, 0)]


def test_a_refused_clear_is_told_once_and_tried_a_minute_later() -> None:
    bench = Bench([(0, 0, 5), (1, 7, 5)], clears=[ExceptionAnswer(6, 3), ExceptionAnswer(6, 3)])
    block = make(bench, KNOWN)
    turn(bench, block)
    assert turn(bench, block)[-2:] == ["clear 300=0", "event clear"]
    assert turn(bench, block) == ["read 7"]
    bench.time += 61 * 1000 * MS
    assert "clear 300=0" in turn(bench, block)
    assert "event clear" not in bench.log


def test_an_overtaken_sample_ends_the_interval_of_the_next() -> None:
    bench = Bench([(0, 0, 5), (1, 7, 5), (1, 8, 5)])
    block = make(bench, KNOWN)
    turn(bench, block)
    log = turn(bench, block)
    assert [line for line in log if line.startswith("add")] == ["add 7", "add 8"]
    first, second = bench.previous
    assert first == 10**9
    assert second == 10**9 + 5 * MS


def test_a_failed_read_ends_the_turn() -> None:
    bench = Bench([(1, 7, 5)])

    async def silent(*_: object, **__: object) -> Answer:
        raise NoAnswer("silence")

    bench.transact = silent  # type: ignore[method-assign]
    with pytest.raises(NoAnswer):
        turn(bench, make(bench, KNOWN))


def at(bench: Bench, block: FlaggedBlock, time: int, *, fails: bool = False) -> None:
    """A turn that is due at ``time``."""
    bench.time = max(bench.time, time)
    if fails:
        block.expect(time)
    else:
        asyncio.run(block.turn(time))


@pytest.mark.parametrize(("cycle", "expected"), [(CYCLE, 1), (None, 0)])
def test_what_was_not_read_before_the_first_read_may_be_missing(
    cycle: int | None, expected: int
) -> None:
    bench = Bench([(0, 0, 5)])
    block = make(bench, KNOWN, cycle=cycle)
    start = bench.time
    for step in range(5):
        at(bench, block, start + step * 100 * MS, fails=True)
    at(bench, block, start + 500 * MS)
    (gap,) = gaps(bench.entries)
    assert (gap.since, gap.until) == (start, start + 505 * MS)
    assert (gap.expected, gap.possible, gap.reason) == (expected, True, Reason.UNREAD)
    at(bench, block, start + 600 * MS)
    assert len(gaps(bench.entries)) == 1


def test_what_was_not_read_until_the_end_may_be_missing() -> None:
    bench = Bench([(0, 0, 5)])
    block = make(bench, KNOWN)
    start = bench.time
    at(bench, block, start)
    for step in range(1, 10):
        at(bench, block, start + step * 100 * MS, fails=True)
    bench.time = start + 950 * MS
    block.close(bench.now())
    (gap,) = gaps(bench.entries)
    assert (gap.since, gap.until) == (start, start + 950 * MS)
    assert (gap.expected, gap.possible, gap.reason) == (2, True, Reason.UNREAD)
    (told,) = bench.entries
    assert told.carry is not None
    assert (told.carry["seq"], told.carry["read_at"]) == (3, start + 950 * MS)


def test_polls_that_failed_are_told_where_no_cycle_tells_what_they_missed() -> None:
    told = []
    for cycle in (CYCLE, None):
        bench = Bench([(0, 0, 5)])
        block = make(bench, KNOWN, cycle=cycle)
        start = bench.time
        at(bench, block, start)
        at(bench, block, start + 100 * MS, fails=True)
        at(bench, block, start + 200 * MS)
        told.append([(gap.since, gap.until, gap.possible) for gap in gaps(bench.entries)])
    assert told == [[], [(start, start + 205 * MS, True)]]


def test_an_end_at_which_everything_was_read_leaves_no_gap() -> None:
    bench = Bench([(0, 0, 5)])
    block = make(bench, KNOWN)
    at(bench, block, bench.time)
    bench.time += 90 * MS
    block.close(bench.now())
    assert bench.entries == []


@pytest.mark.parametrize(("sampled_at", "expected"), [(0, 9), (2_000, 4)])
def test_the_time_between_two_runs_is_counted_from_the_last_sample(
    sampled_at: int, expected: int
) -> None:
    """It may have been read long after the read before it, when the line was down."""
    bench = Bench([(1, 7, 5)], time=4_000 * MS)
    block = make(bench, KNOWN, read_until=1, sampled_at=sampled_at * MS)
    asyncio.run(block.turn(bench.time))
    (gap,) = gaps(bench.entries)
    assert (gap.since, gap.reason) == (1, Reason.DOWNTIME)
    assert (gap.expected, gap.possible) == (expected, False)

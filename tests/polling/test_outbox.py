"""What devices want recorded reaches the writer in the order of its times."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bus_fakes import VirtualClock, run
from told import gaps

from roclog.errors import StorageError
from roclog.outbox import CommitGroup, Outbox
from roclog.recording.entries import Entry
from roclog.schema import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


@dataclass
class Disk:
    """lots: (was it a commit, times of its entries)."""

    lots: list[tuple[bool, list[int]]] = field(default_factory=list)
    failing: bool = False
    entries: list[Entry] = field(default_factory=list)

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        done: Future[None] = Future()
        if self.failing:
            done.set_exception(StorageError(Path("/disk"), "full"))
            return done
        self.entries += entries
        self.lots.append((True, [entry.log_time for entry in entries]))
        done.set_result(None)
        return done

    def note(self, entries: Sequence[Entry]) -> Future[None]:
        self.lots.append((False, [entry.log_time for entry in entries]))
        done: Future[None] = Future()
        done.set_result(None)
        return done

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]:
        raise NotImplementedError


def entry(time: int, topic: str = "/a/b") -> Entry:
    return Entry(topic, time, time, 0, b"", {})


def test_a_lot_is_in_order_of_time_whoever_it_is_from() -> None:
    async def main() -> None:
        disk = Disk()
        group = CommitGroup(disk)
        one, two = (Outbox(name, disk, VirtualClock(), group) for name in ("one", "two"))
        for time in (1, 4):
            one.add(entry(time))
        two.add(entry(2))
        one.flush_soon()
        two.note(entry(3))
        two.flush_soon()
        await group.finish()
        assert disk.lots == [(True, [1, 2, 3, 4])]
        assert one.empty
        assert two.empty

    run(main())


def test_who_cannot_wait_takes_along_what_was_read_before() -> None:
    async def main() -> None:
        disk = Disk()
        group = CommitGroup(disk)
        patient, flagged = (Outbox(name, disk, VirtualClock(), group) for name in ("p", "f"))
        patient.add(entry(1))
        patient.flush_soon()
        flagged.add(entry(2))
        assert await flagged.flush()
        assert disk.lots == [(True, [1, 2])]
        await group.finish()
        assert len(disk.lots) == 1

    run(main())


@dataclass
class SlowDisk(Disk):
    """Settles the oldest commit when it is told to."""

    open: list[Future[None]] = field(default_factory=list)

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        self.entries += entries
        self.lots.append((True, [entry.log_time for entry in entries]))
        self.open.append(Future())
        return self.open[-1]

    async def settle(self, failure: StorageError | None = None) -> None:
        done = self.open.pop(0)
        if failure is None:
            done.set_result(None)
        else:
            done.set_exception(failure)
        await asyncio.sleep(0.001)


def test_a_commit_in_which_one_had_nothing_says_nothing_of_what_it_gave_to_the_next() -> None:
    async def main() -> None:
        disk = SlowDisk()
        group = CommitGroup(disk)
        flagged, other, patient = (Outbox(n, disk, VirtualClock(), group) for n in ("f", "o", "p"))
        patient.flush_soon()  # of a turn in which nothing was read
        flagged.add(entry(1))
        first = asyncio.create_task(flagged.flush())
        await asyncio.sleep(0.001)
        patient.add(entry(2))
        patient.flush_soon()
        other.add(entry(3))
        second = asyncio.create_task(other.flush())
        await asyncio.sleep(0.001)
        await disk.settle()
        assert await first
        assert not patient.empty
        await disk.settle(StorageError(Path("/disk"), "full"))
        assert not await second
        assert not patient.empty
        assert patient.take()[0].log_time == 2

    run(main())


def test_notes_alone_are_written_and_not_committed() -> None:
    async def main() -> None:
        disk = Disk()
        group = CommitGroup(disk)
        outbox = Outbox("one", disk, VirtualClock(), group)
        outbox.note(entry(1))
        assert disk.lots == []
        await group.finish()
        outbox.note(entry(2))
        assert disk.lots == [(False, [1]), (False, [2])]

    run(main())


def test_a_commit_that_fails_leaves_everybody_waiting() -> None:
    async def main() -> None:
        disk = Disk(failing=True)
        group = CommitGroup(disk)
        patient, flagged = (Outbox(name, disk, VirtualClock(), group) for name in ("p", "f"))
        patient.add(entry(1))
        patient.flush_soon()
        flagged.add(entry(2))
        assert not await flagged.flush()
        assert (patient.empty, flagged.empty) == (False, False)
        disk.failing = False
        assert await flagged.flush()
        patient.flush_soon()
        await group.finish()
        first, second = (times for is_commit, times in disk.lots if is_commit)
        assert first[0] == 2
        assert len(first) == 3  # and what both said about it
        assert second[0] == 1

    run(main())


def test_what_the_disk_did_not_take_in_time_is_a_gap_of_each_block() -> None:
    async def main() -> None:
        disk = Disk(failing=True)
        group = CommitGroup(disk)
        outbox = Outbox("one", disk, VirtualClock(), group)
        for time in range(700):
            outbox.add(entry(time, "/one/even" if time % 2 == 0 else "/one/odd"))
        assert not await outbox.flush()
        for time in range(700, 1007):
            outbox.add(entry(time, "/one/odd"))
        disk.failing = False
        assert await outbox.flush()
        await group.finish()
        assert outbox.empty
        ((_, together),) = [lot for lot in disk.lots if lot[0]]
        assert len(together) == 1000 + 2 + 1, "samples, gaps, an event: no crash can part them"
        kept = [e.log_time for e in disk.entries if e.carry is not None]
        assert kept == list(range(7, 1007))
        assert sorted(gaps(disk.entries)) == [
            (0, 6, 4, Reason.STORAGE, False, "even"),
            (1, 5, 3, Reason.STORAGE, False, "odd"),
        ]

    run(main())


@pytest.mark.parametrize("last", [{}, {"carry": {}, "carry_topic": "/one/a"}])
def test_a_gap_that_the_disk_did_not_take_in_time_is_one_nobody_can_count(
    last: dict[str, Any],
) -> None:
    """Also the last one of a block, which says what a later run must know."""

    async def main() -> None:
        disk = Disk(failing=True)
        outbox = Outbox("one", disk, VirtualClock())
        for time in range(1001):
            outbox.add(Entry("/one/gap", time, time, 0, b"", **last))
        disk.failing = False
        assert await outbox.flush()
        (told,) = gaps(disk.entries[1000:])
        assert (told.since, told.until, told.reason) == (0, 0, Reason.STORAGE)
        assert (told.possible, told.block) == (True, "")

    run(main())


def test_what_is_under_way_is_not_taken_twice() -> None:
    async def main() -> None:
        disk = Disk()
        stuck: Future[None] = Future()
        group = CommitGroup(disk)
        outbox = Outbox("one", disk, VirtualClock(), group)
        outbox.add(entry(1))
        disk.commit = lambda entries: stuck  # type: ignore[method-assign]
        first = asyncio.create_task(outbox.flush())
        await asyncio.sleep(0.01)
        outbox.add(entry(2))
        assert not await outbox.flush()
        stuck.set_result(None)
        await asyncio.sleep(0.01)
        assert not await first  # the second one still waits
        del disk.commit
        assert await outbox.flush()
        assert disk.lots == [(True, [2])]

    run(main())

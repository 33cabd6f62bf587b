"""What one device wants recorded, kept in order until it is on disk."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any, Final, Protocol

from roclog.errors import StorageError
from roclog.recording.entries import Entry, gap_entry, in_order, log_entry
from roclog.schema import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from concurrent.futures import Future

    from roclog.clock import Clock

_MOST: Final = 1000
"""Messages kept while the disk takes none; then the oldest samples are given up, and counted in a
gap for each block once the disk takes messages again."""
_GATHER_SECONDS: Final = 0.25


class Recorder(Protocol):
    """The writer, as far as a device needs it."""

    def commit(self, entries: Sequence[Entry]) -> Future[None]: ...

    def note(self, entries: Sequence[Entry]) -> Future[None]: ...

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]: ...


class Outbox:
    """Messages of one device. ``add`` what must be durable, then ``flush`` or ``flush_soon``.

    group: commits for all devices together; None: everything goes to the recorder by itself.
    on_give_up: called with each message that the disk did not take in time.
    """

    def __init__(
        self, device: str, recorder: Recorder, clock: Clock, group: CommitGroup | None = None
    ) -> None:
        self._device = device
        self._recorder = recorder
        self._clock = clock
        self._group = group
        self._waiting: list[Entry] = []
        self._in_flight: list[Entry] = []
        self._given_up: dict[str, tuple[int, int, int]] = {}
        self._telling: dict[str, tuple[int, int, int]] = {}
        self._failing = False
        self.on_give_up: Callable[[Entry], None] | None = None

    @property
    def empty(self) -> bool:
        """Everything added so far is on disk; only then may a device forget."""
        return not self._waiting and not self._in_flight

    def add(self, entry: Entry) -> None:
        self._waiting.append(entry)
        if len(self._waiting) > _MOST:
            self._give_up_oldest()

    def take(self) -> list[Entry]:
        """What waits, to be committed, with what was given up; ``settle`` says how that went."""
        if not self._waiting:
            return []
        self._in_flight, self._waiting = self._waiting, []
        self._telling, self._given_up = self._given_up, {}
        return [*self._in_flight, *self._gaps()]

    def settle(self, failure: StorageError | None) -> None:
        """What was taken is on disk, or waits again; one event when the disk begins to fail."""
        if failure is not None:
            self.put_back()
        self._in_flight, self._telling = [], {}
        if failure is not None and not self._failing:
            self._failing = True
            self.event("error", "storage", f"not recording, nothing is cleared: {failure}")
        elif failure is None and self._failing:
            self._failing = False
            self.event("info", "storage", "recording again")

    def put_back(self) -> None:
        """Nobody knows whether the disk has what was taken; readers drop a second copy."""
        self._waiting = self._in_flight + self._waiting
        self._in_flight = []
        for block, (first, last, count) in self._telling.items():
            _, later, more = self._given_up.get(block, (0, last, 0))
            self._given_up[block] = first, later, count + more
        self._telling = {}
        while len(self._waiting) > _MOST:
            self._give_up_oldest()

    def note(self, entry: Entry) -> None:
        """Record without waiting for the disk, behind the samples that were read before."""
        if self._group is None:
            self._recorder.note([entry])
        else:
            self._group.note(entry)

    def event(self, level: str, kind: str, text: str) -> None:
        """A ``/log`` event, on stderr as well."""
        name = f"{self._device}.{kind}"
        logging.getLogger("roclog").log(_LEVELS[level], "%s: %s", name, text)
        self.note(log_entry(self._clock.now().utc, level, name, text))

    def checkpoint(self, topic: str, carry: Mapping[str, Any]) -> None:
        """Something a later run must know changed without a message of its own."""
        self._recorder.carry(topic, carry)

    @property
    def is_under_way(self) -> bool:
        """Something was taken and is not settled yet."""
        return bool(self._in_flight)

    async def flush(self) -> bool:
        """Commit what waits; False (and an event, once) when the disk does not take it."""
        if not self._waiting:
            return True
        if self._group is not None:
            return await self._group.commit(self)
        return await _commit(self._recorder, [self], [])

    def flush_soon(self) -> None:
        """Have what waits committed with that of other devices, within a quarter of a second."""
        if self._group is not None:
            self._group.ask(self)

    def _give_up_oldest(self) -> None:
        samples = (n for n, waiting in enumerate(self._waiting) if waiting.carry is not None)
        oldest = self._waiting.pop(next(samples, 0))
        if self.on_give_up is not None:
            self.on_give_up(oldest)
        is_sample = oldest.carry is not None and not oldest.carry_topic
        block = oldest.topic.rpartition("/")[2] if is_sample else ""
        first, _, count = self._given_up.get(block, (oldest.log_time, 0, 0))
        self._given_up[block] = (first, oldest.log_time, count + 1)

    def _gaps(self) -> list[Entry]:
        """One for each block; where gaps themselves were given up, what is missing is vague.

        In one commit with the samples behind them, which would hide them from a later run.
        """
        now = self._clock.now().utc
        return [
            gap_entry(
                self._device,
                first,
                last,
                count,
                Reason.STORAGE,
                block=block,
                now=now,
                possible=not block,
            )
            for block, (first, last, count) in self._telling.items()
        ]


class CommitGroup:
    """One commit for everything that devices wanted kept in the last quarter of a second.

    A device that holds its sample until it is told to forget it does not wait so long: its commit
    takes along what waits of the others. So messages are written in the order of their times.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._asking: dict[Outbox, None] = {}
        self._notes: list[Entry] = []
        self._task: asyncio.Task[None] | None = None
        self._finished = False

    def ask(self, outbox: Outbox) -> None:
        """Commit ``outbox`` with the next lot."""
        self._asking[outbox] = None
        self._wake()

    def note(self, entry: Entry) -> None:
        """Write ``entry`` with the next lot; nobody asks whether the disk has it."""
        if self._finished:
            self._recorder.note([entry])
            return
        self._notes.append(entry)
        self._wake()

    async def commit(self, outbox: Outbox) -> bool:
        """Commit ``outbox`` and the next lot now; as Outbox.flush."""
        self._asking[outbox] = None
        await self._commit_lot()
        return outbox.empty

    async def finish(self) -> None:
        """Commit what is left; return when nothing is under way any more."""
        while self._task is not None:
            await self._task
        self._finished = True

    def _wake(self) -> None:
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._commit_soon())

    async def _commit_soon(self) -> None:
        await asyncio.sleep(_GATHER_SECONDS)
        try:
            await self._commit_lot()
        finally:
            self._task = None
        if self._asking or self._notes:
            self._wake()

    async def _commit_lot(self) -> None:
        ready = [outbox for outbox in self._asking if not outbox.is_under_way]
        for outbox in ready:
            del self._asking[outbox]
        notes, self._notes = self._notes, []
        await _commit(self._recorder, ready, notes)


async def _commit(recorder: Recorder, outboxes: Sequence[Outbox], notes: Sequence[Entry]) -> bool:
    failure = None
    # Who gave nothing has no part in this: it may have given something elsewhere when this is over.
    lots = {outbox: lot for outbox in outboxes if (lot := outbox.take())}
    batch = in_order([*lots.values(), notes])
    try:
        if lots:
            await asyncio.wrap_future(recorder.commit(batch))
        elif notes:
            recorder.note(batch)
    except StorageError as error:
        failure = error
    except BaseException:
        for outbox in lots:
            outbox.put_back()
        raise
    for outbox in lots:
        outbox.settle(failure)
    return failure is None


_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}

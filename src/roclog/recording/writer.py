"""The one writer: group commit, rotation, and what to do when the disk says no.

Whatever waits when the writer is free shares one chunk and one fsync. A segment on which a write or
an fsync failed is never touched again; what was not yet known to be on disk is written to a new
one. If that fails too, the commit fails, so nothing is cleared, and the next commit tries again.
"""

from __future__ import annotations

import json
import logging
import queue
import threading
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Final

from roclog.errors import StorageError
from roclog.recording.entries import in_order
from roclog.recording.segment import HotSegment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from roclog.clock import Clock
    from roclog.recording.directory import Directory, Inheritance
    from roclog.recording.entries import ChannelInfo, Entry
    from roclog.recording.sealer import Sealer

_log = logging.getLogger(__name__)
_STEP: Final = 10**9
"""Nanoseconds by which a message may be older than its predecessor in the same segment."""
_FIRST_RETRY: Final = 100_000_000
_LAST_RETRY: Final = 5_000_000_000
"""Nanoseconds between attempts while the disk takes nothing: doubling from first to last."""
STATE_METADATA: Final = "roclog.state"


@dataclass(frozen=True, slots=True)
class Limits:
    """When a segment is full: age in nanoseconds of monotonic time, size in octets."""

    duration: int
    size: int


@dataclass(frozen=True, slots=True)
class _Job:
    entries: tuple[Entry, ...]
    durable: bool
    done: Future[None]
    metadata: tuple[str, Mapping[str, str]] | None = None
    carry: Mapping[str, Mapping[str, object] | None] | None = None
    begins: bool = False


class Writer:
    """Owns the thread that writes. Thread-safe; create, use, ``close``.

    segment_facts: the ``roclog.segment`` metadata of a new segment, given its number.
    """

    def __init__(
        self,
        *,
        directory: Directory,
        inheritance: Inheritance,
        channels: Sequence[ChannelInfo],
        limits: Limits,
        clock: Clock,
        segment_facts: Callable[[int], dict[str, str]],
        sealer: Sealer,
    ) -> None:
        """Opens the first segment. Raises StorageError."""
        self._directory = directory
        self._inheritance = inheritance
        self._channels = channels
        self._limits = limits
        self._clock = clock
        self._segment_facts = segment_facts
        self._sealer = sealer
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._unsynced: list[Entry] = []
        self._segment: HotSegment | None = None
        self._opened_at = 0
        self._retry_at = 0
        self._retry_delay = _FIRST_RETRY
        self._failure: StorageError | None = None
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        try:
            self._segment = self._open_next()
        except OSError as error:
            raise self._storage_error(error) from error
        self._thread = threading.Thread(target=self._run, name="roclog-writer")
        self._thread.start()

    def commit(self, entries: Sequence[Entry]) -> Future[None]:
        """Done when all entries are on disk; fails with StorageError when they cannot be."""
        return self._submit(_Job(tuple(entries), durable=True, done=Future()))

    def note(self, entries: Sequence[Entry]) -> Future[None]:
        """As commit, but the disk may have it later: at the next commit, rotation or close."""
        return self._submit(_Job(tuple(entries), durable=False, done=Future()))

    def describe(self, name: str, values: Mapping[str, str]) -> Future[None]:
        """Put a metadata record into this segment and into every later one."""
        return self._submit(_Job((), durable=False, done=Future(), metadata=(name, values)))

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]:
        """Let a later run know something that no message says."""
        return self._submit(_Job((), durable=False, done=Future(), carry={topic: values}))

    def begin(
        self,
        name: str,
        values: Mapping[str, str],
        carry: Mapping[str, Mapping[str, object] | None],
    ) -> Future[None]:
        """Put what comes next into a new segment, with this metadata record.

        carry: by topic, what a later run is to know; None = nothing of what was known any more.
        """
        job = _Job(
            (), durable=False, done=Future(), metadata=(name, values), carry=carry, begins=True
        )
        return self._submit(job)

    def close(self) -> None:
        """Write what waits, close and seal the segment, leave the state file. Idempotent.

        Raises:
            StorageError: the last segment could not be closed, or nothing could be written.
        """
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()
        if self._failure is not None:
            raise self._failure

    def _submit(self, job: _Job) -> Future[None]:
        job.done.set_running_or_notify_cancel()  # who stops waiting does not stop the writer
        self._jobs.put(job)
        return job.done

    def _run(self) -> None:
        open_for_jobs = True
        while open_for_jobs:
            jobs = [self._jobs.get()]
            while not self._jobs.empty():
                jobs.append(self._jobs.get())
            open_for_jobs = None not in jobs
            for together in _split(job for job in jobs if job is not None):
                self._serve(together)
        self._finish()

    def _serve(self, jobs: list[_Job]) -> None:
        if not jobs:
            return
        for job in jobs:
            self._learn(job)
        if self._failure is None or self._clock.now().monotonic >= self._retry_at:
            self._failure = self._try(jobs)
        for job in jobs:
            if self._failure is None:
                job.done.set_result(None)
            else:
                job.done.set_exception(self._failure)

    def _try(self, jobs: list[_Job]) -> StorageError | None:
        """Write into this segment or, where that fails, into a new one."""
        try:
            self._write(jobs)
        except OSError as first:
            if self._failure is None:
                _log.error("%s: %s; trying a new segment", self._directory.root, first)
            try:
                self._abandon()
                self._write(jobs)
            except OSError as error:
                self._abandon()
                self._retry_at = self._clock.now().monotonic + self._retry_delay
                self._retry_delay = min(2 * self._retry_delay, _LAST_RETRY)
                return self._storage_error(error)
        self._retry_delay = _FIRST_RETRY
        return None

    def _write(self, jobs: list[_Job]) -> None:
        begins = any(job.begins for job in jobs)
        entries = in_order(job.entries for job in jobs)
        segment = self._segment_for(entries, begins=begins)
        for job in jobs:
            if job.metadata is not None and not begins:
                segment.append_metadata(*job.metadata)
        if any(job.carry is not None for job in jobs):
            self._directory.write_state_file(self._inheritance)
        if not entries:
            return
        durable = any(job.durable for job in jobs)
        segment.append(entries, sync=durable)
        for entry in entries:
            if entry.carry is not None:
                self._inheritance.carry[entry.carry_topic or entry.topic] = dict(entry.carry)
        if any(entry.carry is not None and entry.topic.endswith("/gap") for entry in entries):
            # After a crash the samples of the segment say how far each block was read; no gap does.
            self._directory.write_state_file(self._inheritance)
        self._unsynced = [] if durable else self._unsynced + entries

    def _learn(self, job: _Job) -> None:
        """What the head of the next segment says, whatever the disk takes until then."""
        if job.metadata is not None:
            self._metadata[job.metadata[0]] = job.metadata[1]
        for topic, values in (job.carry or {}).items():
            self._inheritance.carry.pop(topic, None)
            if values is not None:
                self._inheritance.carry[topic] = dict(values)

    def _segment_for(self, entries: list[Entry], *, begins: bool) -> HotSegment:
        segment = self._segment
        if segment is None:
            self._segment = segment = self._open_next()
            if self._unsynced:
                segment.append(self._unsynced, sync=False)
            begins = False
        age = self._clock.now().monotonic - self._opened_at
        earliest = min([self._clock.now().utc, *(entry.log_time for entry in entries[:1])])
        stepped_back = earliest < segment.last_log_time - _STEP
        full = age >= self._limits.duration or segment.size >= self._limits.size
        if begins or full or stepped_back:
            segment = self._rotate(segment)
        return segment

    def _rotate(self, full: HotSegment) -> HotSegment:
        """The next segment is open before the full one is given up."""
        full.sync()
        self._unsynced = []
        self._segment = self._open_next()
        full.close()
        self._sealer.seal(full.path)
        return self._segment

    def _open_next(self) -> HotSegment:
        number = self._inheritance.number = self._free_number()
        facts = self._segment_facts(number)
        metadata = {
            "roclog.segment": facts,
            STATE_METADATA: {"state": json.dumps(self._inheritance.carry)},
            **self._metadata,
        }
        self._directory.restore()
        path = self._directory.hot / f"{number:08d}.mcap"
        segment = HotSegment(path, f"roclog {facts['version']}", self._channels, metadata)
        self._opened_at = self._clock.now().monotonic
        self._directory.write_state_file(self._inheritance)
        return segment

    def _free_number(self) -> int:
        """The next one. What a crash has left without a head has a name, and no number that counts.

        It is about to be set aside, or is only looked at, by the sealer.
        """
        number = self._inheritance.number + 1
        while (self._directory.hot / f"{number:08d}.mcap").exists():
            number += 1
        return number

    def _abandon(self) -> None:
        segment, self._segment = self._segment, None
        if segment is not None:
            try:
                segment.close()
            except OSError as error:
                _log.warning("closing %s: %s", segment.path, error)
            if segment.is_empty:
                segment.path.unlink(missing_ok=True)
            else:
                self._sealer.seal(segment.path)

    def _finish(self) -> None:
        segment, self._segment = self._segment, None
        if segment is None:
            return
        try:
            segment.sync()
            segment.close()
            self._directory.write_state_file(self._inheritance)
        except OSError as error:
            _log.error("closing %s: %s", segment.path, error)
            self._failure = self._storage_error(error)
        self._sealer.seal(segment.path)

    def _storage_error(self, error: OSError) -> StorageError:
        return StorageError(self._directory.root, error.strerror or str(error))


def _split(jobs: Iterable[_Job]) -> Iterator[list[_Job]]:
    """Those that may share a chunk; one that begins a segment stands alone."""
    for _, together in groupby(jobs, lambda job: id(job) if job.begins else None):
        yield list(together)

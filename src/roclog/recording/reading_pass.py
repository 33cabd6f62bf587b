"""One reading of a recording, from its first record to its last, each sample once."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

from roclog.errors import DamagedFile
from roclog.recording.dedupe import Finding, SeenMessages, SeenSamples
from roclog.recording.listing import HOT
from roclog.recording.records import Conflict, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from roclog.recording.records import Channel, Record, Segment
    from roclog.recording.segment_reader import Decoded, SegmentReader


class Sinks(NamedTuple):
    """Whom a reading tells. moved: finds the copy of a segment that has gone, or None."""

    damage: Callable[[DamagedFile], None]
    metadata: Callable[[Mapping[str, Mapping[str, str]]], None]
    moved: Callable[[Segment], Segment | None]


class ReadingPass:
    """Iterate once over (segment, records); take the records of one before the next segment.

    opened: makes the reader of a segment.
    """

    def __init__(
        self,
        segments: list[Segment],
        opened: Callable[..., SegmentReader],
        choose: Callable[[Channel], bool],
        sinks: Sinks,
        *,
        start: int | None = None,
        end: int | None = None,
    ) -> None:
        self.dropped = 0
        self.conflicts: list[Conflict] = []
        self._segments = segments
        self._opened = opened
        self._choose = choose
        self._sinks = sinks
        self._start = start
        self._end = end
        self._samples = SeenSamples()
        self._messages = SeenMessages()
        self._whole: set[tuple[str, int]] = set()

    def __iter__(self) -> Iterator[tuple[Segment, Iterator[Record]]]:
        for segment in self._segments:
            if not self._skips(segment):
                records = self._read(segment)
                yield segment, records
                for _ in records:
                    pass

    @property
    def missing(self) -> list[tuple[str, bytes, int, int]]:
        """Topic, epoch, first and last seq that are absent between others."""
        return list(self._samples.holes())

    def _skips(self, segment: Segment) -> bool:
        """Outside the times asked for, or a hot segment whose sealed copy was whole."""
        if segment.state == HOT and segment.identity in self._whole:
            return True
        first, last = segment.span or (0, 2**64)
        return (self._start is not None and last < self._start) or (
            self._end is not None and first >= self._end
        )

    def _read(self, segment: Segment) -> Iterator[Record]:
        self._messages.begin(segment.identity)
        try:
            yield from self._open(segment)
        except FileNotFoundError:
            moved = self._sinks.moved(segment)
            if moved is None:
                self._sinks.damage(DamagedFile(segment.path, 0, "removed before it was read"))
            elif moved.identity not in self._whole:
                yield from self._open(moved)

    def _open(self, segment: Segment) -> Iterator[Record]:
        file = self._opened(segment, choose=self._choose, start=self._start, end=self._end)
        try:
            for decoded in file:
                if not self._is_copy(segment, decoded):
                    yield decoded.record
            if segment.identity is not None and segment.state == "sealed" and not file.damage:
                self._whole.add(segment.identity)
        finally:
            for problem in file.damage:
                self._sinks.damage(problem)
            self._sinks.metadata(file.metadata)

    def _is_copy(self, segment: Segment, decoded: Decoded) -> bool:
        record = decoded.record
        if not isinstance(record, Sample):
            return self._messages.is_copy(record.topic, decoded.message.data)
        if not decoded.decoder.has_key:
            return False
        payload = decoded.decoder.payload(record, decoded.message.data)
        finding = self._samples.add(record.topic, record.epoch, record.seq, payload)
        is_filtered = self._start is not None or self._end is not None
        if finding is Finding.NEW and record.redelivered and is_filtered:
            finding = self._look_back(segment, decoded, payload)
        if finding is Finding.CONFLICT:
            conflict = Conflict(record.topic, record.epoch, record.seq, record.log_time)
            self.conflicts.append(conflict)
        self.dropped += finding is Finding.COPY
        return finding is Finding.COPY

    def _look_back(self, segment: Segment, copy: Decoded, payload: int) -> Finding:
        """Whether a redelivered sample stands before the times asked for as well."""
        wanted = cast("Sample", copy.record)
        key = (wanted.epoch, wanted.seq)
        here = {one.path: n for n, one in enumerate(self._segments)}.get(segment.path)
        for one in reversed(self._segments[: None if here is None else here + 1]):
            try:
                for found in self._opened(one, choose=lambda c: c.topic == wanted.topic):
                    record = found.record
                    if isinstance(record, Sample) and (record.epoch, record.seq) == key:
                        if found.message == copy.message:
                            break
                        same = found.decoder.payload(record, found.message.data) == payload
                        return Finding.COPY if same else Finding.CONFLICT
            except FileNotFoundError:
                continue
        return Finding.NEW

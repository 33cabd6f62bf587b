"""Recordings back as samples, whatever happened to their files.

1. Recording order everywhere: segment by segment, as written. The wall clock may step; order by
   ``log_time`` would not be the order in which things happened.
2. A sample is given once. Copies (read again after a crash, hot and sealed, a recording given
   twice) are left out only where key and payload are equal.
3. Nothing is given whose checksum fails; what is left out is listed in ``damage``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Final, Self, cast

from roclog.errors import DamagedFile
from roclog.quantities import parse_instant
from roclog.recording.decoding import Readers
from roclog.recording.dedupe import Finding, SeenMessages, SeenSamples
from roclog.recording.listing import HOT, list_segments
from roclog.recording.records import (
    Channel,
    Clear,
    Conflict,
    Device,
    Event,
    Gap,
    Link,
    Record,
    Sample,
    Segment,
)
from roclog.recording.segment_reader import Decoded, SegmentReader
from roclog.recording.topics import Topics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

Instant = int | str | None
"""Nanoseconds UTC, or ISO 8601."""
Patterns = str | list[str] | tuple[str, ...] | None
"""A topic or glob, or several of them."""
_DEVICE: Final = "roclog.device."


def open_recording(*paths: Path | str) -> Recording:
    """Open segments, directories and globs of them as one recording.

    Raises:
        ValueError: no path, a path that does not exist, or a directory without a recording.
        DamagedFile: a file named by itself is not MCAP, or cannot be read.
    """
    return Recording(*paths)


@dataclass
class _Pass:
    """One reading, from its first record to its last."""

    segments: list[Segment]
    choose: Callable[[Channel], bool]
    start: int | None
    end: int | None
    samples: SeenSamples = field(default_factory=SeenSamples)
    messages: SeenMessages = field(default_factory=SeenMessages)
    whole: set[tuple[str, int]] = field(default_factory=set)
    dropped: int = 0
    conflicts: list[Conflict] = field(default_factory=list)

    @property
    def is_filtered(self) -> bool:
        return self.start is not None or self.end is not None

    def skips(self, segment: Segment) -> bool:
        """Outside the times asked for, or a hot segment whose sealed copy was whole."""
        if segment.state == HOT and segment.identity in self.whole:
            return True
        first, last = segment.span or (0, 2**64)
        return (self.start is not None and last < self.start) or (
            self.end is not None and first >= self.end
        )


class Recording:
    """Samples and what stands beside them; see ``open_recording``.

    No file stays open between two readings. Each reading looks at the files anew, so segments that
    a recorder has added meanwhile are read as well.
    """

    def __init__(self, *paths: Path | str) -> None:
        if not paths:
            raise ValueError("no path given")
        self._paths = paths
        self._readers = Readers()
        self._topics = Topics(self._readers)
        self._segments: list[Segment] = []
        self._damage: dict[tuple[Path, int, str], DamagedFile] = {}
        self._devices: dict[str, Device] = {}
        self._pass = _Pass([], lambda _: True, None, None)
        self._look()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing stays open; ``with`` is for the shape of the program."""

    def __iter__(self) -> Iterator[Sample]:
        return self.samples()

    @property
    def channels(self) -> Mapping[str, Channel]:
        """By topic. A channel whose messages cannot be decoded has a ``problem``."""
        return self._topics.channels

    @property
    def segments(self) -> list[Segment]:
        """In reading order, as of the latest look at the files."""
        return list(self._segments)

    @property
    def devices(self) -> Mapping[str, Device]:
        """What the files read so far say of each device."""
        return self._devices

    @property
    def damage(self) -> list[DamagedFile]:
        """What was left out, of everything read so far."""
        return list(self._damage.values())

    @property
    def dropped(self) -> int:
        """Copies of samples that the latest reading left out."""
        return self._pass.dropped

    @property
    def conflicts(self) -> list[Conflict]:
        """Samples of the latest reading that share their key with another payload."""
        return list(self._pass.conflicts)

    @property
    def missing(self) -> list[tuple[str, bytes, int, int]]:
        """Topic, epoch, first and last seq that are absent between others in the latest reading."""
        return list(self._pass.samples.holes())

    def samples(
        self,
        channel: Patterns = None,
        *,
        device: str | None = None,
        start: Instant = None,
        end: Instant = None,
    ) -> Iterator[Sample]:
        """Samples in recording order.

        Args:
            channel: topic or glob, or a list of them.
            device: only of this device.
            start: the earliest log_time, included.
            end: the log_time from which on nothing is given.

        Raises:
            ValueError: no such topic or device; a text that is not an instant.
        """
        found = self.records(channel, device=device, start=start, end=end, kinds=("sample",))
        return cast("Iterator[Sample]", found)

    def gaps(self, **which: Patterns | Instant) -> Iterator[Gap]:
        """Where samples are known to be missing; arguments as for ``samples``."""
        return cast("Iterator[Gap]", self._of_kind("gap", which))

    def clears(self, **which: Patterns | Instant) -> Iterator[Clear]:
        """Writes to flags; arguments as for ``samples``."""
        return cast("Iterator[Clear]", self._of_kind("clear", which))

    def links(self, **which: Patterns | Instant) -> Iterator[Link]:
        """Counts of each minute on the wire; arguments as for ``samples``."""
        return cast("Iterator[Link]", self._of_kind("link", which))

    def events(self, **which: Patterns | Instant) -> Iterator[Event]:
        """What the recorder had to tell; arguments as for ``samples``."""
        return cast("Iterator[Event]", self._of_kind("log", which))

    def _of_kind(self, kind: str, which: dict[str, Patterns | Instant]) -> Iterator[Record]:
        return self.records(**which, kinds=(kind,))  # type: ignore[arg-type]

    def records(
        self,
        channel: Patterns = None,
        *,
        device: str | None = None,
        start: Instant = None,
        end: Instant = None,
        kinds: Iterable[str] | None = None,
    ) -> Iterator[Record]:
        """All kinds of records in recording order; arguments as for ``samples``.

        kinds: only of channels of these kinds ("sample", "gap", "clear", "link", "log").
        """
        parts = self.by_segment(channel, device=device, start=start, end=end, kinds=kinds)
        return chain.from_iterable(records for _, records in parts)

    def by_segment(
        self,
        channel: Patterns = None,
        *,
        device: str | None = None,
        start: Instant = None,
        end: Instant = None,
        kinds: Iterable[str] | None = None,
    ) -> Iterator[tuple[Segment, Iterator[Record]]]:
        """Each segment with its records; arguments as for ``records``."""
        self._look()
        choose = self._topics.selection(channel, device, kinds)
        self._pass = reading = _Pass(self._segments, choose, _instant(start), _instant(end))
        return self._read(reading)

    def chosen_channels(self, channel: Patterns = None) -> dict[str, Channel]:
        """Those that match and can be decoded, by topic. Raises ValueError: no such topic."""
        choose = self._topics.selection(channel, None, None)
        return {t: c for t, c in sorted(self.channels.items()) if choose(c) and not c.problem}

    def _look(self) -> None:
        known = {segment.path: segment for segment in self._segments}
        self._segments = list_segments(self._paths, known, self._topics.define)

    def _read(self, reading: _Pass) -> Iterator[tuple[Segment, Iterator[Record]]]:
        for segment in reading.segments:
            if not reading.skips(segment):
                records = self._read_segment(reading, segment)
                yield segment, records
                for _ in records:
                    pass

    def _read_segment(self, reading: _Pass, segment: Segment) -> Iterator[Record]:
        """Raises nothing for what the file is like; that becomes damage."""
        reading.messages.begin(segment.identity)
        try:
            yield from self._open_segment(reading, segment)
        except FileNotFoundError:
            moved = self._moved(segment)
            if moved is None:
                self._add_damage(DamagedFile(segment.path, 0, "removed before it was read"))
            elif moved.identity not in reading.whole:
                yield from self._open_segment(reading, moved)

    def _open_segment(self, reading: _Pass, segment: Segment) -> Iterator[Record]:
        file = SegmentReader(
            segment,
            self._readers,
            self._topics.channels,
            reading.choose,
            start=reading.start,
            end=reading.end,
        )
        try:
            for decoded in file:
                if not self._is_copy(reading, segment, decoded):
                    yield decoded.record
            if segment.identity is not None and segment.state == "sealed" and not file.damage:
                reading.whole.add(segment.identity)
        finally:
            for problem in file.damage:
                self._add_damage(problem)
            self._describe(file.metadata)

    def _is_copy(self, reading: _Pass, segment: Segment, decoded: Decoded) -> bool:
        record = decoded.record
        if not isinstance(record, Sample):
            return reading.messages.is_copy(record.topic, decoded.message.data)
        if not decoded.decoder.has_key:
            return False
        payload = decoded.decoder.payload(record, decoded.message.data)
        finding = reading.samples.add(record.topic, record.epoch, record.seq, payload)
        if finding is Finding.NEW and record.redelivered and reading.is_filtered:
            finding = self._look_back(reading, segment, decoded, payload)
        if finding is Finding.CONFLICT:
            conflict = Conflict(record.topic, record.epoch, record.seq, record.log_time)
            reading.conflicts.append(conflict)
        reading.dropped += finding is Finding.COPY
        return finding is Finding.COPY

    def _look_back(self, reading: _Pass, segment: Segment, copy: Decoded, payload: int) -> Finding:
        """Whether a redelivered sample stands before the times asked for as well."""
        wanted = cast("Sample", copy.record)
        key = (wanted.epoch, wanted.seq)
        here = {one.path: n for n, one in enumerate(reading.segments)}.get(segment.path)
        earlier = reading.segments[: None if here is None else here + 1]
        for one in reversed(earlier):
            reader = SegmentReader(
                one, self._readers, self._topics.channels, lambda c: c.topic == wanted.topic
            )
            for found in reader:
                record = found.record
                if isinstance(record, Sample) and (record.epoch, record.seq) == key:
                    if found.message == copy.message:
                        break
                    same = found.decoder.payload(record, found.message.data) == payload
                    return Finding.COPY if same else Finding.CONFLICT
        return Finding.NEW

    def _moved(self, segment: Segment) -> Segment | None:
        """The sealed copy of a hot segment that has gone since the files were listed."""
        if segment.identity is None:
            return None
        paths = {one.path: one for one in self._segments}
        for found in list_segments(self._paths, paths, self._topics.define):
            if found.identity == segment.identity and found.path != segment.path:
                return found
        return None

    def _add_damage(self, problem: DamagedFile) -> None:
        self._damage.setdefault((problem.path, problem.offset, problem.reason), problem)

    def _describe(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        for name, values in metadata.items():
            if name.startswith(_DEVICE):
                device = name.removeprefix(_DEVICE)
                self._devices[device] = Device(
                    name=device,
                    profile=values.get("profile", ""),
                    unit=values.get("unit", ""),
                    connection=values.get("connection", ""),
                    identity=_object(values.get("identity")),
                    configuration=_object(values.get("configuration")),
                )


def _instant(value: Instant) -> int | None:
    return parse_instant(value) if isinstance(value, str) else value


def _object(text: str | None) -> dict[str, object]:
    try:
        values = json.loads(text or "{}")
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}

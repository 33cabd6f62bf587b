"""Recordings back as samples, whatever happened to their files.

1. Recording order everywhere: segment by segment, as written. The wall clock may step; order by
   ``log_time`` would not be the order in which things happened.
2. A sample is given once. Copies (read again after a crash, hot and sealed, a recording given
   twice) are left out only where key and payload are equal.
3. Nothing is given whose checksum fails; what is left out is listed in ``damage``.
"""

from __future__ import annotations

import json
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Final, Self, cast

from roclog.quantities import parse_instant
from roclog.recording.listing import list_segments
from roclog.recording.protobuf import Readers
from roclog.recording.reading_pass import ReadingPass, Sinks
from roclog.recording.records import Device
from roclog.recording.segment_reader import SegmentReader
from roclog.recording.topics import Topics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from roclog.errors import DamagedFile
    from roclog.recording.records import (
        Channel,
        Clear,
        Conflict,
        Event,
        Gap,
        Link,
        Record,
        Sample,
        Segment,
    )

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
        self._pass = self._reading(lambda _: True, None, None)
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
        return self._pass.missing

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

        kinds: only of channels of these kinds ("sample", "gap", "clear", "link", "offset", "log").
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
        self._pass = self._reading(choose, _instant(start), _instant(end))
        return iter(self._pass)

    def chosen_channels(self, channel: Patterns = None) -> dict[str, Channel]:
        """Those that match and can be decoded, by topic. Raises ValueError: no such topic."""
        choose = self._topics.selection(channel, None, None)
        return {t: c for t, c in sorted(self.channels.items()) if choose(c) and not c.problem}

    def _reading(
        self, choose: Callable[[Channel], bool], start: int | None, end: int | None
    ) -> ReadingPass:
        opened = partial(SegmentReader, readers=self._readers, listed=self._topics.channels)
        sinks = Sinks(self._add_damage, self._describe, self._moved)
        return ReadingPass(self._segments, opened, choose, sinks, start=start, end=end)

    def _look(self) -> None:
        known = {segment.path: segment for segment in self._segments}
        self._segments = list_segments(self._paths, known, self._topics.define)

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

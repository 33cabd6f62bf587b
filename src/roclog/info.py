"""What a recording holds, counted in one reading."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.quantities import format_instant
from roclog.recording.records import Event, Gap, Offset, Sample

if TYPE_CHECKING:
    from roclog.recording.reader import Recording
    from roclog.recording.records import Record, Segment

INFO_SCHEMA: Final = "roclog.info/1"


@dataclass(slots=True)
class Extent:
    """How many records, and the least and the greatest log_time among them."""

    count: int = 0
    first: int | None = None
    last: int | None = None

    def add(self, log_time: int) -> None:
        self.count += 1
        if self.first is None or log_time < self.first:
            self.first = log_time
        if self.last is None or log_time > self.last:
            self.last = log_time


class GapKind(NamedTuple):
    """What gaps are counted by. block: empty for the whole device."""

    device: str
    block: str
    reason: str
    possible: bool


@dataclass(slots=True)
class Info:
    """The counts; what stands in the recording itself is not repeated here.

    gaps: records and expected samples.
    events: by device, kind and level. clocks: the latest offset of each device's clock.
    """

    recording: Recording
    segments: list[tuple[Segment, Extent]] = field(default_factory=list)
    channels: dict[str, Extent] = field(default_factory=dict)
    gaps: dict[GapKind, tuple[int, int]] = field(default_factory=dict)
    events: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    samples: Extent = field(default_factory=Extent)
    clocks: dict[str, Offset] = field(default_factory=dict)


def summarize(recording: Recording) -> Info:
    """Read everything once."""
    info = Info(recording)
    for segment, records in recording.by_segment():
        extent = Extent()
        for record in records:
            extent.add(record.log_time)
            info.channels.setdefault(record.topic, Extent()).add(record.log_time)
            _count(info, record)
        info.segments.append((segment, extent))
    return info


def _count(info: Info, record: Record) -> None:
    match record:
        case Sample():
            info.samples.add(record.log_time)
        case Gap():
            key = GapKind(record.device, record.block, record.reason, record.possible)
            records, expected = info.gaps.get(key, (0, 0))
            info.gaps[key] = (records + 1, expected + record.expected)
        case Offset():
            info.clocks[record.device] = record
        case Event():
            info.events[record.device, record.kind, record.level] += 1


def as_object(info: Info) -> dict[str, object]:
    """For ``--json``: instants as ISO 8601 text, everything else as numbers and text."""
    recording = info.recording
    return {
        "schema": INFO_SCHEMA,
        "samples": _extent(info.samples),
        "segments": [_segment(segment, extent) for segment, extent in info.segments],
        "channels": [
            {
                "topic": topic,
                "device": channel.device,
                "block": channel.block,
                "kind": channel.kind,
                "profile": channel.profile,
                "message_type": channel.schema,
                "message_types": channel.schemas,
                "problem": channel.problem or None,
                **_extent(info.channels.get(topic, Extent())),
            }
            for topic, channel in sorted(recording.channels.items())
        ],
        "gaps": [
            {**kind._asdict(), "count": count, "expected": expected}
            for kind, (count, expected) in sorted(info.gaps.items())
        ],
        "copies_dropped": recording.dropped,
        "conflicts": [
            {"topic": c.topic, "epoch": c.epoch.hex(), "seq": c.seq} for c in recording.conflicts
        ],
        "missing": [
            {"topic": topic, "epoch": epoch.hex(), "first_seq": first, "last_seq": last}
            for topic, epoch, first, last in recording.missing
        ],
        "damage": [
            {"path": str(d.path), "offset": d.offset, "reason": d.reason} for d in recording.damage
        ],
        "devices": {
            device.name: {
                "profile": device.profile,
                "unit": device.unit,
                "connection": device.connection,
                "identity": device.identity,
                "configuration": device.configuration,
            }
            for device in recording.devices.values()
        },
        "clocks": {
            device: {"at": format_instant(clock.log_time), **clock.values}
            for device, clock in sorted(info.clocks.items())
        },
        "events": [
            {"device": device, "kind": kind, "level": level, "count": count}
            for (device, kind, level), count in sorted(info.events.items())
        ],
    }


def _segment(segment: Segment, extent: Extent) -> dict[str, object]:
    return {
        "path": str(segment.path),
        "state": segment.state,
        "number": segment.number,
        "logger": segment.logger or None,
        "run": segment.run or None,
        "version": segment.version or None,
        "size": segment.size,
        **_extent(extent),
    }


def _extent(extent: Extent) -> dict[str, object]:
    return {
        "count": extent.count,
        "first": None if extent.first is None else format_instant(extent.first),
        "last": None if extent.last is None else format_instant(extent.last),
    }

"""What reading gives back: samples and what is recorded beside them. Times are ns UTC."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

Value = object
"""int, float, bool, str, bytes or None; from files of other programs also lists and dicts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One sample of a block; two with the same topic, epoch and seq are copies.

    log_time: host time of the answer. publish_time: device time where it is trusted, else log_time.
    seq: counts the samples of a topic within an epoch; elsewhere the MCAP sequence.
    epoch: 16 octets; empty in files of other programs.
    origin: "flag", "changed", "cyclic" or "unknown".
    redelivered: read again after a restart because its clear was still owed.
    asked_at, read_at: first octet of the request sent, last octet of the answer received.
    read_at_monotonic: as read_at on the monotonic clock of the segment's boot.
    previous_read_at: the sample completed after this; None = not known.
    device_time: what the device claims; None = unknown, then time_flags may say why.
    doubtful: names of the points outside their documented range.
    raw: the registers as on the wire.
    values: by name, in map order.

    The four read times are None where the file does not give them.
    """

    topic: str
    device: str
    block: str
    log_time: int
    publish_time: int
    seq: int
    epoch: bytes = b""
    origin: str = "unknown"
    redelivered: bool = False
    asked_at: int | None = None
    read_at: int | None = None
    read_at_monotonic: int | None = None
    previous_read_at: int | None = None
    device_time: int | None = None
    time_flags: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()
    raw: bytes = b""
    values: dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """``expected`` samples completed between ``start`` and ``end`` and are not recorded.

    possible: it cannot be told whether that many are missing, or any.
    block: whose samples; empty for the whole device, and in files of versions before.
    """

    topic: str
    device: str
    log_time: int
    start: int
    end: int
    expected: int
    reason: str
    possible: bool = False
    block: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clear:
    """One write to a flag; ``result`` is "done", "refused", "unanswered" or "unknown".

    guarded: no further sample could have completed since the read.
    """

    topic: str
    device: str
    log_time: int
    seq: int
    epoch: bytes
    asked_at: int
    ended_at: int
    result: str
    exception_code: int
    guarded: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """What happened on the wire between ``start`` and ``end``; ``values`` by counter name."""

    topic: str
    device: str
    log_time: int
    start: int
    end: int
    values: dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """How far a device's clock was from the host's.

    ``values``: offset, device less host, and uncertainty in seconds; drift and drift_uncertainty in
    ppm, NaN where they are not known.
    """

    topic: str
    device: str
    log_time: int
    values: dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something worth telling. ``device`` is empty where the event is about the whole logger."""

    topic: str
    device: str
    log_time: int
    time: int
    level: str
    kind: str
    text: str
    file: str = ""
    line: int = 0

    @property
    def name(self) -> str:
        return f"{self.device}.{self.kind}" if self.device else self.kind


Record = Sample | Gap | Clear | Link | Offset | Event


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """One topic.

    kind: "sample", "gap", "clear", "link", "offset" or "log".
    fields: names of the values in order. units: UCUM, by field name, where there is one.
    flagged: its samples are taken when the device raises a flag.
    schema: the message type. schemas: all of them, where files differ.
    problem: why its messages cannot be decoded; empty where they can.
    """

    topic: str
    device: str
    block: str
    profile: str
    kind: str
    fields: tuple[str, ...]
    units: Mapping[str, str]
    flagged: bool
    schema: str
    problem: str = ""
    schemas: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """One file of a recording.

    state: "sealed" (complete), "hot" (being written, or left so by a crash), "unfinished" (of
        another program, or cut off) or "unreadable".
    number: grows over the life of the directory; None, like the texts empty, where the file does
        not say it.
    """

    path: Path
    size: int
    state: str
    number: int | None = None
    logger: str = ""
    run: str = ""
    version: str = ""
    opened_at: int | None = None
    span: tuple[int, int] | None = field(default=None, compare=False)

    @property
    def identity(self) -> tuple[str, int] | None:
        """Equal for all copies of one segment; None for files of other programs."""
        return None if self.number is None else (self.logger, self.number)


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two samples with one key and different payloads; both are given."""

    topic: str
    epoch: bytes
    seq: int
    log_time: int


@dataclass(slots=True)
class Device:
    """What is known of a device; the latest that the files say."""

    name: str
    profile: str = ""
    unit: str = ""
    connection: str = ""
    identity: dict[str, Value] = field(default_factory=dict)
    configuration: dict[str, Value] = field(default_factory=dict)

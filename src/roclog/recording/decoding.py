"""Messages of a channel to samples, gaps, clears, link counts and events."""

from __future__ import annotations

import json
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from google.protobuf.descriptor import FieldDescriptor

from roclog.decode import TimeFlag
from roclog.recording.dedupe import digest
from roclog.recording.protobuf import UndecodableError, nanoseconds
from roclog.recording.records import Channel, Clear, Event, Gap, Link, Offset, Record, Sample
from roclog.schema import (
    ANSWERED,
    CLEAR,
    CLOCK_OFFSET,
    GAP,
    LINK,
    MISSING,
    RAW_NUMBER,
    SIGNATURE,
    ClearResult,
    Origin,
    Reason,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from enum import IntEnum

    from mcap.records import Channel as ChannelRecord
    from mcap.records import Message
    from mcap.records import Schema as SchemaRecord

    from roclog.recording.protobuf import MessageReader, Readers
    from roclog.schema import Field

_TIME_FLAGS: Final = {flag.value: str(flag.name).lower() for flag in TimeFlag}
_LOG_FIELDS: Final = (
    ("timestamp", 1, FieldDescriptor.TYPE_MESSAGE),
    ("level", 2, FieldDescriptor.TYPE_ENUM),
    ("message", 3, FieldDescriptor.TYPE_STRING),
    ("name", 4, FieldDescriptor.TYPE_STRING),
    ("file", 5, FieldDescriptor.TYPE_STRING),
    ("line", 6, FieldDescriptor.TYPE_FIXED32),
)


def _described(fields: Iterable[Field]) -> tuple[tuple[str, int, int], ...]:
    return tuple((field.name, field.number, field.kind.value[0]) for field in fields)


_SAMPLE_FIELDS: Final = (
    *_described(SIGNATURE[:11]),
    ("raw", RAW_NUMBER, FieldDescriptor.TYPE_BYTES),
)
_COMMON: Final = frozenset(name for name, _, _ in _SAMPLE_FIELDS)
_LATER: Final = (MISSING, ANSWERED)
"""Fields that not every version has."""
_MISSING: Final = _described([MISSING])
_KINDS: Final = {
    GAP.name: ("gap", _described(GAP.fields[:4])),
    CLEAR.name: ("clear", _described(CLEAR.fields[:7])),
    LINK.name: ("link", _described(LINK.fields[:2])),
    CLOCK_OFFSET.name: ("offset", _described(CLOCK_OFFSET.fields)),
    "foxglove.Log": ("log", _LOG_FIELDS),
}
"""The fields of the first version, so that files of every version are read."""


class ChannelDecoder:
    """Decodes the messages of one channel of one file.

    channel: the facts. damaged: it says protobuf, but the schema makes no message type.
    has_key: its samples have (epoch, seq), so that copies can be told.
    """

    def __init__(
        self, record: ChannelRecord, schema: SchemaRecord | None, readers: Readers
    ) -> None:
        self.damaged = False
        self.has_key = False
        self._metadata = record.metadata
        self._reader: MessageReader | None = None
        problem = _encoding_problem(record, schema)
        if schema is not None and not problem:
            try:
                self._reader = readers.reader(schema.name, schema.data)
            except UndecodableError as error:
                self.damaged = True
                problem = str(error)
        self.channel = self._facts(record, schema.name if schema is not None else "", problem)
        fields = self.channel.fields
        self._has_possible, self._has_block = "possible" in fields, "block" in fields
        points = record.metadata.get("points")
        self._points = points.split(",") if points else []
        self._decode = self._decoder()
        self._ranges = _payload_ranges(record.metadata.get("payload"))

    def decode(self, message: Message) -> Record | None:
        """None where the channel has a problem.

        Raises:
            UndecodableError: the message does not fit its schema.
        """
        if self._reader is None:
            return None
        return self._decode(message, self._reader.parse(message.data))

    def payload(self, sample: Sample, data: bytes) -> int:
        """Digest of what makes a sample another one: its payload words, else all octets."""
        if self._ranges is None:
            return digest(data)
        return digest(*(sample.raw[2 * first : 2 * (first + n)] for first, n in self._ranges))

    def _facts(self, record: ChannelRecord, schema: str, problem: str) -> Channel:
        first, _, rest = record.topic.strip("/").partition("/")
        kind = "sample"
        names: tuple[str, ...] = ()
        if self._reader is not None:
            kind = self._kind(schema)
            names = self._reader.names
            self.has_key = kind == "sample" and self._reader.has(_SAMPLE_FIELDS)
            if self.has_key:
                names = tuple(name for name in names if name not in _COMMON)
                later = [field for field in _LATER if self._reader.has(_described([field]))]
                names = tuple(name for name in names if name not in [f.name for f in later])
        metadata = record.metadata
        unit = "unit."
        return Channel(
            topic=record.topic,
            device=metadata.get("device", first if kind != "log" else ""),
            block=metadata.get("block", rest if kind != "log" else first),
            profile=metadata.get("profile", ""),
            kind=kind,
            fields=names,
            units={k.removeprefix(unit): v for k, v in metadata.items() if k.startswith(unit)},
            flagged="payload" in metadata,
            schema=schema,
            problem=problem,
            schemas=(schema,),
        )

    def _kind(self, schema: str) -> str:
        kind, fields = _KINDS.get(schema, ("sample", ()))
        if self._reader is None or not self._reader.has(fields):
            return "sample"
        if kind == "log":
            timestamp: Any = self._reader.descriptor.fields_by_name["timestamp"].message_type
            return kind if timestamp.full_name == "google.protobuf.Timestamp" else "sample"
        return kind

    def _decoder(self) -> Callable[[Message, Any], Record]:
        others: dict[str, Callable[[Message, Any], Record]] = {
            "gap": self._gap,
            "clear": self._clear,
            "link": self._link,
            "offset": self._offset,
            "log": self._event,
        }
        if self.channel.kind in others:
            return others[self.channel.kind]
        if not self.has_key:
            return self._foreign
        self._names = self.channel.fields
        self._get = attrgetter("seq", "raw", *self._names)
        self._enums = {
            field.name: {value.number: value.name.lower() for value in kind.values}
            for field in self._fields_of_names()
            if (kind := field.enum_type) is not None
        }
        self._of_point = _fields_of_points(self._points, self._names)
        has_missing = self._reader is not None and self._reader.has(_MISSING)
        return self._sample_with_missing if has_missing else self._sample

    def _sample_with_missing(self, message: Message, m: Any) -> Sample:
        sample = self._sample(message, m)
        mask = m.missing
        if mask:
            for index, names in enumerate(self._of_point):
                if mask >> index & 1:
                    sample.values.update(dict.fromkeys(names))
        return sample

    def _sample(self, message: Message, m: Any) -> Sample:
        seq, raw, *values = self._get(m)
        sample = Sample(
            topic=self.channel.topic,
            device=self.channel.device,
            block=self.channel.block,
            log_time=message.log_time,
            publish_time=message.publish_time,
            seq=seq,
            epoch=m.epoch,
            origin=_name(Origin, m.origin),
            redelivered=m.redelivered,
            asked_at=m.asked_at or None,
            read_at=m.read_at or None,
            read_at_monotonic=m.read_at_monotonic or None,
            previous_read_at=m.previous_read_at or None,
            device_time=m.device_time or None,
            time_flags=_bits(m.time_flags, _TIME_FLAGS.get) if m.time_flags else (),
            doubtful=_bits(m.doubtful, self._point) if m.doubtful else (),
            raw=raw,
            values=dict(zip(self._names, values, strict=True)),
        )
        for name, words in self._enums.items():
            number: Any = sample.values[name]
            sample.values[name] = words.get(number, number)
        return sample

    def _fields_of_names(self) -> list[FieldDescriptor]:
        assert self._reader is not None
        return [self._reader.descriptor.fields_by_name[name] for name in self._names]

    def _point(self, mask: int) -> str | None:
        index = mask.bit_length() - 1
        return self._points[index] if index < len(self._points) else None

    def _foreign(self, message: Message, m: Any) -> Sample:
        assert self._reader is not None
        return Sample(
            topic=self.channel.topic,
            device=self.channel.device,
            block=self.channel.block,
            log_time=message.log_time,
            publish_time=message.publish_time,
            seq=message.sequence,
            values=self._reader.values(m),
        )

    def _gap(self, message: Message, m: Any) -> Gap:
        return Gap(
            topic=self.channel.topic,
            device=self.channel.device,
            log_time=message.log_time,
            start=getattr(m, "from"),
            end=m.to,
            expected=m.expected,
            reason=_name(Reason, m.reason),
            possible=self._has_possible and bool(m.possible),
            block=str(m.block) if self._has_block else "",
        )

    def _clear(self, message: Message, m: Any) -> Clear:
        return Clear(
            topic=self.channel.topic,
            device=self.channel.device,
            log_time=message.log_time,
            seq=m.seq,
            epoch=m.epoch,
            asked_at=m.asked_at,
            ended_at=m.ended_at,
            result=_name(ClearResult, m.result),
            exception_code=m.exception_code,
            guarded=m.guarded,
        )

    def _link(self, message: Message, m: Any) -> Link:
        assert self._reader is not None
        values = self._reader.values(m)
        start, end = getattr(m, "from"), m.to
        del values["from"], values["to"]
        return Link(
            topic=self.channel.topic,
            device=self.channel.device,
            log_time=message.log_time,
            start=start,
            end=end,
            values=values,
        )

    def _offset(self, message: Message, m: Any) -> Offset:
        assert self._reader is not None
        return Offset(
            topic=self.channel.topic,
            device=self.channel.device,
            log_time=message.log_time,
            values=self._reader.values(m),
        )

    def _event(self, message: Message, m: Any) -> Event:
        device, _, kind = m.name.rpartition(".")
        levels = m.DESCRIPTOR.fields_by_name["level"].enum_type.values_by_number
        return Event(
            topic=self.channel.topic,
            device=device,
            log_time=message.log_time,
            time=nanoseconds(m.timestamp),
            level=levels[m.level].name.lower() if m.level in levels else "unknown",
            kind=kind,
            text=m.message,
            file=m.file,
            line=m.line,
        )


def _encoding_problem(record: ChannelRecord, schema: SchemaRecord | None) -> str:
    if schema is None:
        return "no schema"
    for encoding in (record.message_encoding, schema.encoding):
        if encoding != "protobuf":
            return f"encoding {encoding!r}, not protobuf"
    return ""


def _name(kind: type[IntEnum], number: int) -> str:
    try:
        return kind(number).name.lower()
    except ValueError:
        return "unknown"


def _bits(mask: int, name: Callable[[int], str | None]) -> tuple[str, ...]:
    """A name for each bit set, from the lowest on."""
    masks = [1 << bit for bit in range(mask.bit_length()) if mask >> bit & 1]
    return tuple(name(one) or f"bit_{one.bit_length() - 1}" for one in masks)


def _payload_ranges(text: str | None) -> list[tuple[int, int]] | None:
    """(first word, words) pairs from the channel's metadata; None where it gives none."""
    try:
        pairs = [(first, words) for first, words in json.loads(text or "")]
    except (ValueError, TypeError, RecursionError):
        return None
    good = pairs and all(isinstance(n, int) and 0 <= n < 2**16 for pair in pairs for n in pair)
    return pairs if good else None


def _fields_of_points(points: list[str], names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The fields of each point: its own, and those of its bits and parts, which follow it."""
    starts = [names.index(point) if point in names else len(names) for point in points]
    return [names[start:end] for start, end in pairwise([*starts, len(names)])]

"""Recordings made with the official MCAP and protobuf libraries, from the documented format.

Nothing here uses roclog's encoder: field names, numbers and types are written down once more.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "roclog 0.1.0"
EPOCH = bytes(range(16))
T0 = 1_795_000_000_000_000_000
SECOND = 10**9
_F = descriptor_pb2.FieldDescriptorProto
_TYPES = {
    "double": _F.TYPE_DOUBLE,
    "fixed64": _F.TYPE_FIXED64,
    "sfixed64": _F.TYPE_SFIXED64,
    "fixed32": _F.TYPE_FIXED32,
    "sfixed32": _F.TYPE_SFIXED32,
    "bool": _F.TYPE_BOOL,
    "bytes": _F.TYPE_BYTES,
    "string": _F.TYPE_STRING,
}
SIGNATURE = """seq 1 fixed64, epoch 2 bytes, origin 3 Origin:UNKNOWN|FLAG|CHANGED|CYCLIC,
redelivered 4 bool, asked_at 5 sfixed64, read_at 6 sfixed64, read_at_monotonic 7 sfixed64,
previous_read_at 8 sfixed64, device_time 9 sfixed64, time_flags 10 fixed32, doubtful 11 fixed64,
raw 12 bytes"""
_POINTS = """count_1 16 double, count_2 17 double, iso_code_1 18 double, nas_class 19 sfixed32,
temperature 20 double, alarms 21 fixed32, laser_low 22 bool"""
_GAP = """from 1 sfixed64, to 2 sfixed64, expected 3 fixed64,
reason 4 Reason:UNKNOWN|OVERWRITTEN|DOWNTIME|STORAGE|UNGUARDED_CLEAR"""
_CLEAR = """seq 1 fixed64, epoch 2 bytes, asked_at 5 sfixed64, ended_at 6 sfixed64,
result 7 Result:UNKNOWN|DONE|REFUSED|UNANSWERED, exception_code 8 fixed32, guarded 9 bool"""
_LINK = """from 1 sfixed64, to 2 sfixed64, requests 3 fixed64, round_trip_mean 11 double"""


def message_class(full_name: str, fields: str) -> Any:
    """A message type from lines like ``name number type``; ``Name:A|B`` is an enum."""
    package, _, name = full_name.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{name}.proto", package=package, syntax="proto3"
    )
    message = file.message_type.add(name=name)
    for line in fields.split(","):
        field_name, number, kind = line.split()
        made = message.field.add(name=field_name, number=int(number), label=_F.LABEL_OPTIONAL)
        enum, _, values = kind.partition(":")
        if values:
            made.type, made.type_name = _F.TYPE_ENUM, f".{full_name}.{enum}"
            described = message.enum_type.add(name=enum)
            for value, text in enumerate(values.split("|")):
                described.value.add(name=text, number=value)
        else:
            made.type = _TYPES[kind]
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(full_name))


SAMPLE = message_class("roclog.test_device.Sample", f"{SIGNATURE}, {_POINTS}")
GAP = message_class("roclog.Gap", _GAP)
GAP_OF_BLOCK = message_class("roclog.Gap", f"{_GAP}, possible 5 bool, block 6 string")
"""Since it tells whose samples are missing."""
CLEAR = message_class("roclog.Clear", _CLEAR)
LINK = message_class("roclog.Link", _LINK)


@dataclass(frozen=True)
class Topic:
    """A channel to declare."""

    topic: str
    kind: Any
    metadata: dict[str, str] = field(default_factory=dict)
    encoding: str = "protobuf"
    schema: bytes | None = None

    @property
    def schema_name(self) -> str:
        return str(self.kind.DESCRIPTOR.full_name)

    @property
    def schema_data(self) -> bytes:
        if self.schema is not None:
            return self.schema
        return bytes(build_file_descriptor_set(self.kind).SerializeToString())


POINTS = "count_1,count_2,iso_code_1,nas_class,temperature,alarms"
FLAGGED = {
    "device": "roc1",
    "block": "sample",
    "profile": "test-device",
    "points": POINTS,
    "payload": "[[0, 2]]",
    "unit.count_1": "1/mL",
    "unit.count_2": "1/mL",
    "unit.temperature": "Cel",
}
TOPICS = (
    Topic("/log", Log),
    Topic("/roc1/sample", SAMPLE, FLAGGED),
    Topic("/roc1/gap", GAP, {"device": "roc1", "block": "gap"}),
    Topic("/roc1/clear", CLEAR, {"device": "roc1", "block": "clear", "clears": "/roc1/sample"}),
    Topic("/roc1/link", LINK, {"device": "roc1", "block": "link"}),
)
WITH_BLOCKS = (*TOPICS[:2], replace(TOPICS[2], kind=GAP_OF_BLOCK), *TOPICS[3:])
"""Gaps say of which block they are."""


@dataclass(frozen=True)
class Item:
    """One message to write."""

    topic: str
    log_time: int
    data: bytes
    sequence: int = 0
    publish_time: int = 0


def sample(seq: int, topic: str = "/roc1/sample", at: int | None = None, **values: Any) -> Item:
    """A sample whose values follow from ``seq``; ``values`` replaces fields."""
    log_time = T0 + seq * SECOND if at is None else at
    fields: dict[str, Any] = {
        "seq": seq,
        "epoch": EPOCH,
        "origin": 1,
        "asked_at": log_time - 10_000_000,
        "read_at": log_time,
        "read_at_monotonic": 5 * SECOND + seq,
        "previous_read_at": 0 if seq == 1 else log_time - SECOND,
        "device_time": 0 if seq % 2 else T0 - SECOND,
        "raw": struct.pack(">3H", seq % 65536, 7, 250),
        "count_1": seq + 0.25,
        "count_2": seq / 100,
        "iso_code_1": 15.5,
        "nas_class": -2,
        "temperature": 25.1,
        "alarms": seq % 4,
        "laser_low": seq % 4 == 1,
    } | values
    return Item(topic, log_time, SAMPLE(**fields).SerializeToString(), seq, log_time)


def gap(at: int, start: int, end: int, expected: int = 2, reason: int = 2) -> Item:
    data = GAP(**{"from": start, "to": end, "expected": expected, "reason": reason})
    return Item("/roc1/gap", at, data.SerializeToString(), publish_time=at)


def gap_of_block(at: int, start: int, end: int, block: str) -> Item:
    values = {"from": start, "to": end, "expected": 3, "reason": 3, "block": block}
    return Item("/roc1/gap", at, GAP_OF_BLOCK(**values).SerializeToString(), publish_time=at)


def clear(seq: int, at: int) -> Item:
    data = CLEAR(seq=seq, epoch=EPOCH, asked_at=at, ended_at=at + 5, result=1, guarded=True)
    return Item("/roc1/clear", at, data.SerializeToString(), seq, at)


def link(at: int) -> Item:
    data = LINK(**{"from": at - 60 * SECOND, "to": at, "requests": 60, "round_trip_mean": 0.02})
    return Item("/roc1/link", at, data.SerializeToString(), publish_time=at)


def event(
    at: int, name: str = "roc1.baseline", message: str = "first block", level: int = 2
) -> Item:
    data: Any = Log()
    data.level, data.message, data.name = level, message, name
    data.timestamp.seconds, data.timestamp.nanos = divmod(at, SECOND)
    return Item("/log", at, data.SerializeToString(), publish_time=at)


def protected(values: dict[str, str]) -> dict[str, str]:
    """With the checksum that the format asks of metadata."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return {**values, "crc32": str(zlib.crc32(text.encode()))}


def facts(number: int = 1, logger: str = "ab" * 16) -> dict[str, dict[str, str]]:
    """Metadata at the head of a segment."""
    return {
        "roclog.segment": protected(
            {
                "number": str(number),
                "logger": logger,
                "run": "cd" * 16,
                "boot_id": "00000000-0000-0000-0000-000000000000",
                "version": "0.1.0",
                "opened_at": str(T0 + number),
                "opened_at_monotonic": "1",
            }
        ),
        "roclog.device.roc1": protected(
            {
                "profile": "test-device",
                "unit": "138",
                "connection": "hydraulics",
                "identity": json.dumps({"manufacturer": "HIAC", "serial_number": "1234"}),
                "configuration": json.dumps({"sample_period": 15}),
            }
        ),
    }


def write_sealed(
    path: Path,
    items: Iterable[Item],
    *,
    topics: Sequence[Topic] = TOPICS,
    metadata: dict[str, dict[str, str]] | None = None,
    library: str = LIBRARY,
    **options: Any,
) -> Path:
    """With the official writer."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer: Any = Writer(file, **{"enable_data_crcs": True, **options})
        writer.start(library=library)
        for name, values in (facts() if metadata is None else metadata).items():
            writer.add_metadata(name, values)
        ids: dict[str, int] = {}
        for topic in topics:
            schema = writer.register_schema(topic.schema_name, "protobuf", topic.schema_data)
            ids[topic.topic] = writer.register_channel(
                topic.topic, topic.encoding, schema, topic.metadata
            )
        for item in items:
            writer.add_message(
                ids[item.topic], item.log_time, item.data, item.publish_time, item.sequence
            )
        writer.finish()
    return path


def hot_octets(
    commits: Iterable[Sequence[Item]],
    *,
    topics: Sequence[Topic] = TOPICS,
    metadata: dict[str, dict[str, str]] | None = None,
) -> bytes:
    """A hot segment: a chunk for the definitions, one for each commit, no footer."""
    builder: Any = RecordBuilder()
    Header("", LIBRARY).write(builder)
    for name, values in (facts() if metadata is None else metadata).items():
        Metadata(name, values).write(builder)
    definitions: Any = RecordBuilder()
    ids: dict[str, int] = {}
    for number, topic in enumerate(topics, start=1):
        ids[topic.topic] = number
        Schema(number, topic.schema_data, "protobuf", topic.schema_name).write(definitions)
        Channel(number, topic.topic, topic.encoding, topic.metadata, number).write(definitions)
    octets: bytes = MAGIC + builder.end() + chunk(definitions.end(), 0, 0)
    for commit in commits:
        for item in commit:
            Message(
                ids[item.topic], item.log_time, item.data, item.publish_time, item.sequence
            ).write(builder)
        times = [item.log_time for item in commit]
        octets += chunk(builder.end(), min(times), max(times))
    return octets


def chunk(content: bytes, start: int, end: int, **replaced: Any) -> bytes:
    """An uncompressed chunk record; ``replaced`` lies about it."""
    builder: Any = RecordBuilder()
    said: dict[str, Any] = {
        "compression": "",
        "data": content,
        "message_start_time": start,
        "message_end_time": end,
        "uncompressed_crc": zlib.crc32(content),
        "uncompressed_size": len(content),
    }
    Chunk(**(said | replaced)).write(builder)
    return bytes(builder.end())


def write_hot(path: Path, commits: Iterable[Sequence[Item]], **options: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(hot_octets(commits, **options))
    return path


UNCOMPRESSED = CompressionType.NONE

"""What is written: channels, messages and metadata, before they become MCAP records."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from roclog.schema import GAP

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from roclog.register_map import Block
    from roclog.schema import MessageType, Reason

LOG_TOPIC: Final = "/log"
LOG_NAME: Final = "foxglove.Log"


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """A channel as it is declared at the head of every segment."""

    topic: str
    schema_name: str
    schema: bytes
    metadata: Mapping[str, str] = field(default_factory=dict)


class Entry(NamedTuple):
    """One message.

    carry: what a later run must know of the channel once this message is on disk; ``carry_topic``
    where it is another channel than that of the message.
    """

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes
    carry: Mapping[str, object] | None = None
    carry_topic: str = ""


def in_order(lots: Iterable[Sequence[Entry]]) -> list[Entry]:
    """All messages in order of time; those of one lot never change places.

    One device's messages must stay in the order of their numbers even where the wall clock was set
    back between them: a later run takes up what the last one says.
    """
    timed: list[tuple[int, Entry]] = []
    for lot in lots:
        latest = 0
        for entry in lot:
            latest = max(latest, entry.log_time)
            timed.append((latest, entry))
    return [entry for _, entry in sorted(timed, key=lambda pair: pair[0])]


def block_channel(device: str, profile: str, block: Block, kind: MessageType) -> ChannelInfo:
    """Channel of a block's samples, with the facts that a reader needs beside the schema."""
    metadata = {"device": device, "block": block.name, "profile": profile}
    metadata["points"] = ",".join(point.name for point in block.points)
    metadata |= {f"unit.{point.name}": point.unit for point in block.points if point.unit}
    if block.handshake is not None:
        metadata["payload"] = json.dumps(block.handshake.payload)
    elif block.trigger is not None:
        metadata["trigger"] = type(block.trigger).__name__
    return ChannelInfo(f"/{device}/{block.name}", kind.name, kind.descriptor_set, metadata)


def plain_channel(device: str, name: str, kind: MessageType, **more: str) -> ChannelInfo:
    """Channel of a device's gaps, clears or link counts."""
    metadata = {"device": device, "block": name, **more}
    return ChannelInfo(f"/{device}/{name}", kind.name, kind.descriptor_set, metadata)


def protected(values: Mapping[str, str]) -> dict[str, str]:
    """The values of a metadata record with their checksum, which MCAP does not give them."""
    return {**values, "crc32": str(_checksum(values))}


def intact(values: Mapping[str, str]) -> bool:
    """Whether the checksum of ``protected`` holds."""
    rest = {key: value for key, value in values.items() if key != "crc32"}
    return values.get("crc32") == str(_checksum(rest))


def _checksum(values: Mapping[str, str]) -> int:
    return zlib.crc32(json.dumps(values, sort_keys=True, separators=(",", ":")).encode())


def _log_file() -> descriptor_pb2.FileDescriptorProto:
    """foxglove/Log.proto, the schema that log panels know; numbers and names are theirs."""
    proto = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name="foxglove/Log.proto",
        package="foxglove",
        syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )
    message = file.message_type.add(name="Log")
    level = message.enum_type.add(name="Level")
    for number, name in enumerate(("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")):
        level.value.add(name=name, number=number)
    fields = (
        ("timestamp", proto.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
        ("level", proto.TYPE_ENUM, ".foxglove.Log.Level"),
        ("message", proto.TYPE_STRING, None),
        ("name", proto.TYPE_STRING, None),
        ("file", proto.TYPE_STRING, None),
        ("line", proto.TYPE_FIXED32, None),
    )
    for number, (name, kind, type_name) in enumerate(fields, start=1):
        message.field.add(
            name=name, number=number, type=kind, type_name=type_name, label=proto.LABEL_OPTIONAL
        )
    return file


def _timestamp_file() -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(file)
    return file


_FILES: Final = descriptor_pb2.FileDescriptorSet(file=[_timestamp_file(), _log_file()])


def _log_class() -> type:
    pool = descriptor_pool.DescriptorPool()
    for file in _FILES.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(LOG_NAME))


_Log: Final = _log_class()
LOG_CHANNEL: Final = ChannelInfo(LOG_TOPIC, LOG_NAME, _FILES.SerializeToString(deterministic=True))
LEVELS: Final = {"info": 2, "warning": 3, "error": 4}


def gap_entry(
    device: str,
    after: int,
    before: int,
    expected: int,
    reason: Reason,
    *,
    block: str,
    now: int,
    possible: bool,
) -> Entry:
    """Samples that are missing. ``after``, ``before`` and ``now`` in ns UTC.

    block: empty for the whole device. possible: nobody can tell if any is missing.
    """
    data = GAP.pack(iter((after, before, expected, reason, possible, block)))
    return Entry(f"/{device}/gap", now, now, 0, data)


def log_entry(utc: int, level: str, name: str, message: str) -> Entry:
    """An event; ``name`` is ``<device>.<kind>`` or ``<kind>``."""
    seconds, nanoseconds = divmod(utc, 10**9)
    data = _Log(
        timestamp={"seconds": seconds, "nanos": nanoseconds},
        level=LEVELS[level],
        message=message,
        name=name,
    ).SerializeToString()
    return Entry(LOG_TOPIC, utc, utc, 0, data)

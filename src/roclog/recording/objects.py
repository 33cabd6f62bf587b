"""Records as plain objects: what NDJSON, CSV and tables are made from."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Final

from roclog.recording.records import Clear, Event, Gap, Link, Offset, Record, Sample

if TYPE_CHECKING:
    from collections.abc import Mapping

RECORD_SCHEMA: Final = "roclog.record/1"
TIME_FIELDS: Final = frozenset({"from", "to", "asked_at", "ended_at", "timestamp"})
"""Fields that are ns UTC in gaps, clears, link counts and events."""


def kind_of(record: Record) -> str:
    """As ``Channel.kind``."""
    return "log" if isinstance(record, Event) else type(record).__name__.lower()


def fields_of(record: Record) -> Mapping[str, object]:
    """The fields of the message by the names they have in the file; of a sample its values."""
    match record:
        case Sample() | Link() | Offset():
            between = {"from": record.start, "to": record.end} if isinstance(record, Link) else {}
            return between | record.values
        case Gap():
            return {
                "from": record.start,
                "to": record.end,
                "expected": record.expected,
                "reason": record.reason,
                "possible": record.possible,
                "block": record.block,
            }
        case Clear():
            return {
                "seq": record.seq,
                "epoch": record.epoch,
                "asked_at": record.asked_at,
                "ended_at": record.ended_at,
                "result": record.result,
                "exception_code": record.exception_code,
                "guarded": record.guarded,
            }
        case Event():
            return {
                "timestamp": record.time,
                "level": record.level,
                "message": record.text,
                "name": record.name,
                "file": record.file,
                "line": record.line,
            }


def as_object(record: Record) -> dict[str, object]:
    """One line of NDJSON before it is text: octets as hex, NaN and infinities as None."""
    head: dict[str, object] = {
        "schema": RECORD_SCHEMA,
        "kind": kind_of(record),
        "topic": record.topic,
        "device": record.device,
        "log_time": record.log_time,
    }
    if not isinstance(record, Sample):
        return head | {name: _plain(value) for name, value in fields_of(record).items()}
    return head | {
        "block": record.block,
        "publish_time": record.publish_time,
        "device_time": record.device_time,
        "seq": record.seq,
        "epoch": record.epoch.hex(),
        "origin": record.origin,
        "redelivered": record.redelivered,
        "asked_at": record.asked_at,
        "read_at": record.read_at,
        "read_at_monotonic": record.read_at_monotonic,
        "previous_read_at": record.previous_read_at,
        "time_flags": list(record.time_flags),
        "doubtful": list(record.doubtful),
        "raw": record.raw.hex(),
        "values": _plain(record.values),
    }


def as_line(record: Record) -> str:
    """One line of NDJSON, without its end."""
    return to_json(as_object(record))


def to_json(value: object) -> str:
    return json.dumps(_plain(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def _plain(value: object) -> object:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case bytes():
            return value.hex()
        case dict():
            return {key: _plain(item) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item) for item in value]
    return value

"""Turn a hot segment into a file that every MCAP tool opens: compressed, indexed, with a summary.

Idempotent: the sealed file appears whole under its name or not at all, and the hot one goes only
afterwards. What the hot one cannot give back (a torn tail) is counted in the sealed one.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from mcap.records import Channel, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from roclog.errors import DamagedFile
from roclog.recording.entries import intact, protected
from roclog.recording.scan import MAGIC, Scan
from roclog.recording.segment import sync_directory

if TYPE_CHECKING:
    from pathlib import Path

_CHUNK: Final = 512 * 1024
SEGMENT_METADATA: Final = "roclog.segment"
SEALED_METADATA: Final = "roclog.sealed"


@dataclass(frozen=True, slots=True)
class _Survey:
    """Latest metadata of each name, and what of the file cannot be used."""

    metadata: dict[str, dict[str, str]]
    dropped: int
    reason: str
    inside: bool
    """The damage is not (only) an unfinished tail."""


def seal(hot: Path, root: Path) -> Path:
    """Write the sealed copy of ``hot`` below ``root``, then remove ``hot``. Returns the copy.

    A hot segment that is damaged elsewhere than at its end stays beside, as ``.damaged``.

    Raises:
        DamagedFile: the head of the segment is not readable; the file is left alone.
        OSError: the disk; the hot segment is still there.
    """
    survey = _survey(hot)
    segment = survey.metadata.get(SEGMENT_METADATA)
    if segment is None:
        raise DamagedFile(hot, len(MAGIC), "the head of the segment is not readable")
    target = root / _sealed_name(int(segment["opened_at"]), int(segment["number"]))
    target.parent.mkdir(parents=True, exist_ok=True)
    metadata = survey.metadata
    if survey.dropped:
        facts = {"dropped_octets": str(survey.dropped), "reason": survey.reason}
        metadata[SEALED_METADATA] = protected(facts)
    temporary = target.with_suffix(f".sealing-{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            _copy(hot, file, metadata)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    for folder in (target.parent, *target.parent.parents):
        sync_directory(folder)
        if folder == root:
            break
    if survey.inside:
        hot.rename(hot.with_suffix(".damaged"))
    else:
        hot.unlink()
    sync_directory(hot.parent)
    return target


def _survey(hot: Path) -> _Survey:
    scan = Scan(hot)
    metadata: dict[str, dict[str, str]] = {}
    channels: set[int] = set()
    last_good = 0
    for found in scan:
        last_good = found.offset
        match found.record:
            case Metadata(name=name, metadata=values) if intact(values):
                metadata[name] = dict(values)
            case Channel(id=identifier):
                channels.add(identifier)
            case Message(channel_id=identifier) if identifier not in channels:
                raise DamagedFile(hot, found.offset, "messages of an unknown channel")
    if not scan.damage:
        return _Survey(metadata, 0, "", inside=False)
    dropped = max(1, hot.stat().st_size - scan.octets)
    inside = scan.damage[0].offset < last_good
    return _Survey(metadata, dropped, str(scan.damage[0].reason), inside)


def _copy(hot: Path, file: Any, metadata: dict[str, dict[str, str]]) -> None:
    writer = Writer(
        file,
        chunk_size=_CHUNK,
        compression=CompressionType.ZSTD,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for found in Scan(hot):
        match found.record:
            case Header(library=library):
                writer.start(library=library)
                for name, values in metadata.items():
                    writer.add_metadata(name, values)
            case Schema() as schema:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            case Channel() as channel:
                channels[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[channel.schema_id],
                    channel.metadata,
                )
            case Message() as message:
                writer.add_message(
                    channels[message.channel_id],
                    message.log_time,
                    message.data,
                    message.publish_time,
                    message.sequence,
                )
    writer.finish()


def _sealed_name(opened_at: int, number: int) -> str:
    opened = datetime.fromtimestamp(opened_at // 10**9, UTC)
    return f"{opened:%Y/%m/%d}/{opened:%Y%m%dT%H%M%SZ}-{number:08d}.mcap"

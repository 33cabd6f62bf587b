"""What a finished file says of itself behind its data: trusted only where its checksum holds."""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from roclog.errors import DamagedFile
from roclog.recording.scan import MAGIC, MAX_RECORD

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import IO

_FRAME: Final = struct.Struct("<BQ")
_FOOTER: Final = struct.Struct("<BQQQI")
_TAIL: Final = _FOOTER.size + len(MAGIC)
_BLOCK: Final = 2**20


@dataclass
class Summary:
    """start: offset where it begins. span: first and last log_time, None without messages."""

    start: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[tuple[str, int]] = field(default_factory=list)
    """Name and offset of each metadata record."""
    statistics: Statistics | None = None

    @property
    def span(self) -> tuple[int, int] | None:
        if self.statistics is None or not self.statistics.message_count:
            return None
        return self.statistics.message_start_time, self.statistics.message_end_time


def read_summary(path: Path) -> Summary | None:
    """None for an unfinished file, and for one whose summary is absent, unprotected or damaged.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        footer = _footer(file)
    if footer is None or not footer[1]:
        return None
    start, octets = footer[0], footer[1]
    summary = Summary(start)
    try:
        for opcode, body in _frames(octets):
            _take(summary, opcode, ReadDataStream(io.BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError):
        return None
    return summary


def is_finished(path: Path) -> bool:
    """Whether the file ends with a footer, whatever stands before it. Raises OSError."""
    with path.open("rb") as file:
        return _footer(file) is not None


def read_metadata(path: Path, offset: int) -> Metadata | None:
    """The metadata record at ``offset``, which holds no checksum but its own ``crc32`` key.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        file.seek(offset)
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            return None
        opcode, length = _FRAME.unpack(head)
        if opcode != Opcode.METADATA or length > MAX_RECORD:
            return None
        try:
            record: Metadata = Metadata.read(ReadDataStream(io.BytesIO(file.read(length))))
        except (McapError, struct.error, UnicodeDecodeError, OverflowError):
            return None
        return record


def check_sums(path: Path) -> Iterator[DamagedFile]:
    """The checksums over the data section and over the summary of a finished file.

    Chunks have their own, which every reading checks; these two also cover what is between them.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        footer = _footer(file)
        if footer is None:
            return
        start, octets = footer
        if octets is None:
            yield DamagedFile(path, start, "a summary whose checksum is wrong")
            return
        end = start or file.seek(0, io.SEEK_END) - _TAIL
        end -= _FRAME.size + 4
        file.seek(max(0, end))
        tail = file.read(_FRAME.size + 4)
        if len(tail) < 13 or _FRAME.unpack_from(tail) != (Opcode.DATA_END, 4):
            yield DamagedFile(path, max(0, end), "no end of the data where the footer says")
            return
        expected = int.from_bytes(tail[-4:], "little")
        if expected and expected != _crc(file, end):
            yield DamagedFile(path, end, "a data section whose checksum is wrong")


def _footer(file: IO[bytes]) -> tuple[int, bytes | None] | None:
    """Start and octets of the summary (None where damaged or unprotected); None: unfinished."""
    size = file.seek(0, io.SEEK_END)
    if size < len(MAGIC) + _TAIL:
        return None
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    opcode, length, start, _, crc = _FOOTER.unpack_from(tail)
    if tail[-len(MAGIC) :] != MAGIC or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    covered = size - len(MAGIC) - 4 - start
    if start == 0:
        return 0, b""
    if not (len(MAGIC) <= start <= size - _TAIL and covered <= MAX_RECORD):
        return start, None
    file.seek(start)
    octets = file.read(covered)
    if crc and crc != zlib.crc32(octets):
        return start, None
    return start, octets[: size - _TAIL - start] if crc else b""


def _frames(octets: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(octets):
        opcode, length = _FRAME.unpack_from(octets, at)
        at += _FRAME.size + length
        yield opcode, octets[at - length : at]


def _take(summary: Summary, opcode: int, stream: ReadDataStream) -> None:
    match opcode:
        case Opcode.SCHEMA:
            schema: Schema = Schema.read(stream)
            summary.schemas[schema.id] = schema
        case Opcode.CHANNEL:
            channel: Channel = Channel.read(stream)
            summary.channels[channel.id] = channel
        case Opcode.METADATA_INDEX:
            index: MetadataIndex = MetadataIndex.read(stream)
            summary.metadata.append((index.name, index.offset))
        case Opcode.STATISTICS:
            summary.statistics = Statistics.read(stream)


def _crc(file: IO[bytes], size: int) -> int:
    crc = 0
    file.seek(0)
    while size and (block := file.read(min(size, _BLOCK))):
        crc = zlib.crc32(block, crc)
        size -= len(block)
    return crc

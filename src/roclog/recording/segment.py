"""A hot segment: append-only, one CRC-protected chunk for each commit, never reopened.

Its head (metadata, then one chunk with all schemas and channels) is on disk before the first
message. It has no footer; a reader takes what is whole.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from typing import TYPE_CHECKING, Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from roclog.recording.entries import protected
from roclog.recording.scan import MAGIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from roclog.recording.entries import ChannelInfo, Entry


_MESSAGE: Final = struct.Struct("<BQHIQQ")
"""Head of a message record: opcode and length, then channel, sequence, log and publish time. The
library's builder takes ten times as long, which counts at a thousand samples a second."""
_MESSAGE_HEAD: Final = _MESSAGE.size - 9


class HotSegment:
    """An open hot segment. Every method may raise OSError; then the segment is to be abandoned."""

    def __init__(
        self,
        path: Path,
        library: str,
        channels: Sequence[ChannelInfo],
        metadata: Mapping[str, Mapping[str, str]],
    ) -> None:
        self.path = path
        self.size = 0
        self.last_log_time = 0
        self._ids = {channel.topic: number for number, channel in enumerate(channels, start=1)}
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW
        self._fd = os.open(path, flags, 0o640)
        try:
            self._write(_head(library, channels, metadata))
            os.fsync(self._fd)
            sync_directory(path.parent)
            self._head_size = self.size
        except OSError:
            self.close()
            path.unlink(missing_ok=True)  # nothing is committed yet; a full disk is not littered
            raise

    @property
    def is_empty(self) -> bool:
        """Nothing was appended behind the head."""
        return self.size == self._head_size

    def append(self, entries: Sequence[Entry], *, sync: bool) -> None:
        """One chunk with all entries; on return with ``sync`` they are on disk.

        ``log_time`` never decreases inside a file. The few milliseconds by which one task may
        overtake another between answer and commit are levelled here; read_at stays exact.
        """
        first = max(entries[0].log_time, self.last_log_time)
        parts: list[bytes] = []
        for entry in entries:
            self.last_log_time = max(entry.log_time, self.last_log_time)
            head = _MESSAGE.pack(
                Opcode.MESSAGE,
                _MESSAGE_HEAD + len(entry.data),
                self._ids[entry.topic],
                entry.sequence & 0xFFFFFFFF,
                self.last_log_time,
                entry.publish_time,
            )
            parts += (head, entry.data)
        self._write(_chunk(b"".join(parts), first, self.last_log_time))
        if sync:
            os.fsync(self._fd)
            if os.fstat(self._fd).st_nlink == 0:
                raise FileNotFoundError(errno.ENOENT, "the segment was deleted", str(self.path))

    def append_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """One metadata record; on disk with the next synced append."""
        builder = RecordBuilder()
        Metadata(name, protected(values)).write(builder)
        self._write(builder.end())

    def sync(self) -> None:
        os.fsync(self._fd)

    def close(self) -> None:
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            os.close(fd)

    def _write(self, octets: bytes) -> None:
        rest = memoryview(octets)
        while rest:
            rest = rest[os.write(self._fd, rest) :]
        self.size += len(octets)


def sync_directory(path: Path) -> None:
    """Make the entries of a directory durable."""
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _head(
    library: str, channels: Sequence[ChannelInfo], metadata: Mapping[str, Mapping[str, str]]
) -> bytes:
    builder = RecordBuilder()
    Header("", library).write(builder)
    for name, values in metadata.items():
        Metadata(name, protected(values)).write(builder)
    head = builder.end()
    numbers: dict[tuple[str, bytes], int] = {}
    for identifier, channel in enumerate(channels, start=1):
        key = (channel.schema_name, channel.schema)
        if key not in numbers:
            numbers[key] = len(numbers) + 1
            Schema(
                id=numbers[key],
                name=channel.schema_name,
                encoding="protobuf",
                data=channel.schema,
            ).write(builder)
        Channel(
            id=identifier,
            topic=channel.topic,
            message_encoding="protobuf",
            metadata=dict(channel.metadata),
            schema_id=numbers[key],
        ).write(builder)
    return MAGIC + head + _chunk(builder.end(), 0, 0)


def _chunk(content: bytes, start: int, end: int) -> bytes:
    builder = RecordBuilder()
    Chunk(
        compression="",
        data=content,
        message_start_time=start,
        message_end_time=end,
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    ).write(builder)
    return builder.end()

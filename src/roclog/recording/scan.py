"""Reading MCAP without trusting it: every record of a file, and what is wrong with the rest.

Nothing is returned whose checksum fails. Sizes are checked before anything is allocated or
decompressed. A damaged chunk is skipped, since the records around it can still be found; a damaged
record frame ends the scan, since nothing behind it can.
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Message, Metadata, Schema, Statistics

from roclog.errors import DamagedFile

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MAGIC: Final = b"\x89MCAP0\r\n"
MAX_RECORD: Final = 64 * 2**20
MAX_CHUNK: Final = 32 * 2**20
"""Octets of a record, and of a chunk when decompressed. Every known writer stays far below."""
_CHUNK_HEAD: Final = struct.Struct("<QQQI")
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_KINDS: Final = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}

Record = Header | Schema | Channel | Metadata | Statistics | Message


@dataclass(frozen=True, slots=True)
class Found:
    """A record and the offset of the record (or of its chunk) in the file."""

    offset: int
    record: Record


class Scan:
    """Iterate once over the records of a file, in file order, chunks opened.

    finished: the footer was reached; False for a hot segment and for one that a crash left.
    damage: what was skipped or cut off, filled while iterating.
    octets: size of the good part.

    Raises (while iterating):
        DamagedFile: not an MCAP file at all.
        OSError: the file cannot be read.
    """

    def __init__(self, path: Path, *, start: int | None = None, end: int | None = None) -> None:
        """start, end: skip chunks without messages in [start, end), nanoseconds of log_time."""
        self.path = path
        self.finished = False
        self.damage: list[DamagedFile] = []
        self.octets = 0
        self._start = start
        self._end = end

    def __iter__(self) -> Iterator[Found]:
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise DamagedFile(self.path, 0, "not an MCAP file")
            self.octets = len(MAGIC)
            yield from self._records(file)

    def _records(self, file: IO[bytes]) -> Iterator[Found]:
        while head := file.read(9):
            offset = self.octets
            if len(head) < 9:
                self._note(offset, f"{len(head)} octets of an unfinished record")
                return
            opcode, length = head[0], int.from_bytes(head[1:], "little")
            if opcode == 0 or length > MAX_RECORD:
                self._note(offset, f"opcode {opcode} with {length} octets is not a record")
                return
            body = file.read(length)
            if len(body) < length:
                self._note(offset, f"{len(body)} of {length} octets of the last record")
                return
            yield from self._open(offset, opcode, body)
            self.octets += 9 + length
            if opcode == Opcode.FOOTER:
                self.finished = True
                if file.read() != MAGIC:
                    self._note(self.octets, "no MCAP magic after the footer")
                return

    def _open(self, offset: int, opcode: int, body: bytes) -> Iterator[Found]:
        try:
            if opcode == Opcode.CHUNK:
                content = self._content(body)
                if content is not None:
                    yield from (Found(offset, record) for record in list(_unpack(content)))
            elif opcode == Opcode.MESSAGE or opcode in _KINDS:
                yield Found(offset, _parse(opcode, body))
        except _Bad as problem:
            self._note(offset, str(problem))

    def _content(self, body: bytes) -> bytes | None:
        """Records of a chunk, decompressed and checked; None where the time filter skips it."""
        if len(body) < _CHUNK_HEAD.size + 12:
            raise _Bad("a chunk without a head")
        start, end, size, crc = _CHUNK_HEAD.unpack_from(body)
        at = _CHUNK_HEAD.size + 4
        name_end = at + int.from_bytes(body[at - 4 : at], "little")
        name = body[at:name_end]
        stored = body[name_end + 8 :]
        if len(stored) != int.from_bytes(body[name_end : name_end + 8], "little"):
            raise _Bad("a chunk whose length does not fit its record")
        if size > MAX_CHUNK:
            raise _Bad(f"a chunk of {size} octets, more than {MAX_CHUNK}")
        content = _decompress(name, stored, size)
        if len(content) != size:
            raise _Bad(f"a chunk of {len(content)} octets that says {size}")
        if crc not in (0, zlib.crc32(content)):
            raise _Bad("a chunk whose checksum is wrong")
        before = self._end is not None and start >= self._end
        after = self._start is not None and end < self._start
        has_messages = start or end
        return None if has_messages and (before or after) else content

    def _note(self, offset: int, reason: str) -> None:
        self.damage.append(DamagedFile(self.path, offset, reason))


class _Bad(Exception):
    """A part that must not be returned; becomes DamagedFile with its offset."""


def _decompress(name: bytes, stored: bytes, size: int) -> bytes:
    """At most ``size`` + 1 octets, whatever the compressed frame says of itself."""
    try:
        match name:
            case b"":
                return stored
            case b"zstd":
                with zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(stored) as reader:
                    return reader.read(size + 1)
            case b"lz4":
                with lz4.frame.open(io.BytesIO(stored)) as reader:
                    return bytes(reader.read(size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError) as error:
        raise _Bad(f"a chunk that cannot be decompressed ({error})") from error
    raise _Bad(f"a chunk compressed with {name[:16]!r}")


def _unpack(content: bytes) -> Iterator[Record]:
    at = 0
    while at < len(content):
        head = content[at : at + 9]
        end = at + 9 + int.from_bytes(head[1:], "little")
        if len(head) < 9 or end > len(content):
            raise _Bad("a chunk with an unfinished record")
        if head[0] in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            yield _parse(head[0], content[at + 9 : end])
        at = end


def _parse(opcode: int, body: bytes) -> Record:
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE_HEAD.size:
            raise _Bad("a message without a head")
        channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(body)
        return Message(
            channel_id=channel,
            sequence=sequence,
            log_time=log_time,
            publish_time=publish_time,
            data=body[_MESSAGE_HEAD.size :],
        )
    kind = _KINDS[Opcode(opcode)]
    try:
        return kind.read(ReadDataStream(io.BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as error:
        raise _Bad(f"an unreadable {kind.__name__} record ({error})") from error

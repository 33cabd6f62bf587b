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
_FRAME: Final = struct.Struct("<BQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQI")
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_KINDS: Final[dict[int, type[Header | Schema | Channel | Metadata | Statistics]]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_WANTED: Final = frozenset({*_KINDS, Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX})
_UNPROTECTED: Final = frozenset({Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL})
_FIXED: Final[dict[int, int]] = {Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17, Opcode.FOOTER: 20}
_LIBRARY: Final = "roclog"

Record = Header | Schema | Channel | Metadata | Statistics | Message


@dataclass(frozen=True, slots=True)
class Found:
    """A record and the offset of the record (or of its chunk) in the file."""

    offset: int
    record: Record


class Scan:
    """Iterate once over the records of a file, in file order, chunks opened.

    finished: the footer was reached; False for a hot segment and for one that a crash left.
    ours: the file says that roclog wrote it. Then messages, schemas and channels are taken only
        from chunks with a checksum. In files of others, messages outside chunks are taken as long
        as no chunk came before them: a flipped bit makes a message out of a message index.
    damage: what was skipped or cut off, filled while iterating.
    octets: size of the good part. torn_at: size of the file if it ended inside a record, else None.

    The schemas and channels that a finished file repeats behind its data are not returned; see
    ``recording/summary.py`` for them.

    Raises (while iterating):
        DamagedFile: not an MCAP file at all.
        OSError: the file cannot be read.
    """

    def __init__(self, path: Path, *, start: int | None = None, end: int | None = None) -> None:
        """start, end: leave out messages outside [start, end), nanoseconds of log_time."""
        self.path = path
        self.finished = False
        self.ours = False
        self.damage: list[DamagedFile] = []
        self.octets = 0
        self.torn_at: int | None = None
        self._start = 0 if start is None else start
        self._end = 2**64 if end is None else end
        self._chunks = 0
        self._data_ended = False

    def __iter__(self) -> Iterator[Found]:
        with self.path.open("rb") as file:
            magic = file.read(len(MAGIC))
            if magic != MAGIC:
                self.torn_at = len(magic) if MAGIC.startswith(magic) else None
                raise DamagedFile(self.path, 0, "not an MCAP file")
            self.octets = len(MAGIC)
            yield from self._records(file)

    def _records(self, file: IO[bytes]) -> Iterator[Found]:
        while head := file.read(_FRAME.size):
            offset = self.octets
            if len(head) < _FRAME.size:
                self.torn_at = file.tell()
                self._note(offset, f"{len(head)} octets of an unfinished record")
                return
            opcode, length = _FRAME.unpack(head)
            wanted = opcode in _WANTED
            if opcode == 0 or length > (MAX_RECORD if wanted else 2**62):
                self._note(offset, f"opcode {opcode} with {length} octets is not a record")
                return
            body = file.read(length) if wanted else b""
            missing = length - len(body) if wanted else _skip(file, length)
            if missing:
                self.torn_at = file.tell()
                self._note(offset, f"{length - missing} of {length} octets of the last record")
                return
            yield from self._open(offset, opcode, length, body)
            self.octets += _FRAME.size + length
            if opcode == Opcode.FOOTER:
                self.finished = True
                if file.read(len(MAGIC) + 1) != MAGIC:
                    self._note(self.octets, "no MCAP magic after the footer")
                return

    def _open(self, offset: int, opcode: int, length: int, body: bytes) -> Iterator[Found]:
        try:
            self._check_kind(opcode, length, body)
            if opcode == Opcode.CHUNK:
                self._chunks += 1
                yield from self._chunk(offset, body)
            elif opcode == Opcode.MESSAGE or opcode in _KINDS:
                if not (self._data_ended and opcode in _UNPROTECTED):
                    exact = self.ours or (opcode == Opcode.HEADER and _LIBRARY.encode() in body)
                    record = _parse(opcode, body, exact=exact)
                    self._recognise(record)
                    yield Found(offset, record)
            elif opcode == Opcode.DATA_END:
                self._data_ended = True
        except _PartError as problem:
            self._note(offset, str(problem))

    def _check_kind(self, opcode: int, length: int, body: bytes) -> None:
        """What a flipped bit in an opcode or a length makes of a record must not pass as one."""
        if opcode > Opcode.DATA_END and (opcode < 0x80 or self.ours):
            raise _PartError(f"a record of {length} octets with the unknown opcode {opcode}")
        if opcode == Opcode.MESSAGE_INDEX and (
            length < 6 or int.from_bytes(body[2:6], "little") != length - 6
        ):
            raise _PartError("a message index whose length does not fit its record")
        if length != _FIXED.get(opcode, length):
            raise _PartError(f"a record of kind {opcode} with {length} octets")
        unprotected = opcode in _UNPROTECTED and not self._data_ended
        if unprotected and (self.ours or (opcode == Opcode.MESSAGE and self._chunks)):
            raise _PartError(
                f"a record of kind {opcode} outside a chunk, where nothing protects it"
            )

    def _recognise(self, record: Record) -> None:
        if isinstance(record, Header):
            self.ours |= record.library.startswith(_LIBRARY)
        elif isinstance(record, Metadata):
            self.ours |= record.name == f"{_LIBRARY}.segment"

    def _chunk(self, offset: int, body: bytes) -> Iterator[Found]:
        start, end, content = _content(body, checked=self.ours)
        first, last = 2**64, 0
        for opcode, at, stop in _frames(content):
            if opcode == Opcode.MESSAGE and stop - at >= _MESSAGE_HEAD.size:
                log_time = int.from_bytes(content[at + 6 : at + 14], "little")
                first, last = min(first, log_time), max(last, log_time)
                if not self._start <= log_time < self._end:
                    continue
            if opcode in _UNPROTECTED:
                try:
                    yield Found(offset, _parse(opcode, content[at:stop]))
                except _PartError as problem:
                    self._note(offset, str(problem))
        if first <= last and (start, end) != (first, last):
            self._note(offset, "a chunk whose messages have other times than its head says")

    def _note(self, offset: int, reason: str) -> None:
        self.damage.append(DamagedFile(self.path, offset, reason))


class _PartError(Exception):
    """A part that must not be returned; becomes DamagedFile with its offset."""


def _skip(file: IO[bytes], length: int) -> int:
    """Pass over ``length`` octets; returns how many of them the file does not have."""
    at = file.tell()
    size = file.seek(0, io.SEEK_END)
    file.seek(min(at + length, size))
    return max(0, at + length - size)


def _content(body: bytes, *, checked: bool) -> tuple[int, int, bytes]:
    """Start and end of a chunk as its head says, and its records, decompressed and verified.

    checked: a chunk without a checksum is bad.
    """
    if len(body) < _CHUNK_HEAD.size + 12:
        raise _PartError("a chunk without a head")
    start, end, size, crc = _CHUNK_HEAD.unpack_from(body)
    at = _CHUNK_HEAD.size + 4
    name_end = at + int.from_bytes(body[at - 4 : at], "little")
    name = body[at:name_end]
    stored = body[name_end + 8 :]
    if len(stored) != int.from_bytes(body[name_end : name_end + 8], "little"):
        raise _PartError("a chunk whose length does not fit its record")
    if size > MAX_CHUNK:
        raise _PartError(f"a chunk of {size} octets, more than {MAX_CHUNK}")
    content = _decompress(name, stored, size)
    if len(content) != size:
        raise _PartError(f"a chunk of {len(content)} octets that says {size}")
    if (crc or checked) and crc != zlib.crc32(content):
        raise _PartError("a chunk whose checksum is wrong")
    for _ in _frames(content):
        pass
    return start, end, content


def _decompress(name: bytes, stored: bytes, size: int) -> bytes:
    """At most ``size`` + 1 octets, whatever the compressed frame says of itself."""
    try:
        match name:
            case b"":
                return stored
            case b"zstd":
                decompressor = zstandard.ZstdDecompressor(max_window_size=2**27)
                with decompressor.stream_reader(stored) as reader:
                    return reader.read(size + 1)
            case b"lz4":
                with lz4.frame.open(io.BytesIO(stored)) as reader:
                    return bytes(reader.read(size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError) as error:
        raise _PartError(f"a chunk that cannot be decompressed ({error})") from error
    raise _PartError(f"a chunk compressed with {name[:16]!r}")


def _frames(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of the body of each record in a chunk."""
    at, size = 0, len(content)
    while at < size:
        if size - at < _FRAME.size:
            raise _PartError("a chunk with an unfinished record")
        opcode, length = _FRAME.unpack_from(content, at)
        at += _FRAME.size
        if length > size - at:
            raise _PartError("a chunk with an unfinished record")
        yield opcode, at, at + length
        at += length


def _parse(opcode: int, body: bytes, *, exact: bool = False) -> Record:
    """exact: octets behind the known fields are damage, not a later version of the format."""
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE_HEAD.size:
            raise _PartError("a message without a head")
        channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(body)
        return Message(
            channel_id=channel,
            sequence=sequence,
            log_time=log_time,
            publish_time=publish_time,
            data=body[_MESSAGE_HEAD.size :],
        )
    kind = _KINDS[opcode]
    stream = ReadDataStream(io.BytesIO(body))
    try:
        record: Record = kind.read(stream)
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as error:
        raise _PartError(f"an unreadable {kind.__name__} record ({error})") from error
    if exact and stream.count != len(body):
        raise _PartError(
            f"a {kind.__name__} record with {len(body) - stream.count} octets too many"
        )
    return record

"""Looks into the MCAP files a logger has written so far, through the official library."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import EndOfFile
from mcap.records import Chunk, Footer, Message
from mcap.stream_reader import StreamReader, breakup_chunk


@dataclass
class _Seen:
    """What was read of one file: everything before `offset` is in `payloads`."""

    size: int = -1
    offset: int = 0
    payloads: list[bytes] = field(default_factory=list)
    closed: bool = False


class Disk:
    def __init__(self, directory: str) -> None:
        self._directory = Path(directory)
        self._files: dict[Path, _Seen] = {}

    def find(self, needles: list[tuple[bytes, str]]) -> tuple[str | None, list[str]]:
        """The mark of the first needle that lies within one message, and what was unreadable."""
        errors = self._refresh()
        payloads = [p for seen in self._files.values() for p in reversed(seen.payloads)]
        for needle, mark in needles:
            if any(needle in payload for payload in payloads):
                return mark, errors
        return None, errors

    def _refresh(self) -> list[str]:
        errors = []
        paths = set(self._directory.rglob("*.mcap"))
        for gone in self._files.keys() - paths:
            del self._files[gone]
        for path in sorted(paths):
            try:
                self._files[path] = _scan(path, self._files.get(path, _Seen()))
            except FileNotFoundError:
                continue  # renamed meanwhile
            except Exception as error:  # noqa: BLE001 - whatever is wrong belongs into the log
                errors.append(f"{path.name}: {error!r}")
        return errors


def _scan(path: Path, seen: _Seen) -> _Seen:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size == seen.size:
            return seen
        if size < seen.size or seen.closed:
            seen = _Seen()
        was_open = seen.offset > 0
        _read_on(file, seen)
        if seen.closed and was_open:  # the CRC of the data section needs one pass from the start
            seen = _Seen()
            _read_on(file, seen)
        seen.size = size
        return seen


def _read_on(file: BinaryIO, seen: _Seen) -> None:
    """A tail that is still being written ends the pass; it is read again next time."""
    file.seek(seen.offset)
    skip_magic = seen.offset > 0
    reader = StreamReader(file, skip_magic=skip_magic, emit_chunks=True, validate_crcs=True)
    try:
        for record in reader.records:
            inner = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else []
            found = [item.data for item in (record, *inner) if isinstance(item, Message)]
            seen.payloads += found
            seen.offset = file.tell()
            seen.closed = isinstance(record, Footer)
    except (EndOfFile, struct.error):
        pass

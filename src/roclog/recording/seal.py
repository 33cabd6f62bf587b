"""Turn a hot segment into a file that every MCAP tool opens: compressed, indexed, with a summary.

Idempotent: the sealed file appears whole under its name or not at all, and the hot one goes only
afterwards. What the hot one cannot give back (a torn tail) is counted in the sealed one.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import IO, TYPE_CHECKING, Final

from mcap.records import Channel, Header, Message, Metadata, Schema

from roclog.errors import DamagedFile
from roclog.recording.entries import intact, protected
from roclog.recording.scan import MAGIC, Scan
from roclog.recording.sealed_file import SealedFile
from roclog.recording.segment import sync_directory

if TYPE_CHECKING:
    from pathlib import Path

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


def _copy(hot: Path, file: IO[bytes], metadata: dict[str, dict[str, str]]) -> None:
    """Schemas and channels keep their numbers; whatever a crash repeated is taken once."""
    sealed: SealedFile | None = None
    known: set[tuple[type, int]] = set()
    for found in Scan(hot):
        record = found.record
        if isinstance(record, Header):
            sealed = SealedFile(file, record.library)
            for name, values in metadata.items():
                sealed.add_metadata(name, values)
        elif sealed is None:
            raise DamagedFile(hot, found.offset, "records before the header")
        elif isinstance(record, Message):
            sealed.add_message(record)
        elif isinstance(record, Schema | Channel) and (type(record), record.id) not in known:
            known.add((type(record), record.id))
            if isinstance(record, Schema):
                sealed.add_schema(record)
            else:
                sealed.add_channel(record)
    if sealed is None:
        raise DamagedFile(hot, len(MAGIC), "no header")
    sealed.finish()


def _sealed_name(opened_at: int, number: int) -> str:
    opened = datetime.fromtimestamp(opened_at // 10**9, UTC)
    return f"{opened:%Y/%m/%d}/{opened:%Y%m%dT%H%M%SZ}-{number:08d}.mcap"

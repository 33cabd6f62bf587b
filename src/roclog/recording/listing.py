"""Which files a recording consists of, and in which order they are read.

The order is that of the segment numbers of one logger, loggers by their first segment; files of
other programs follow in order of their names. Copies of one segment stand together, the sealed one
first.
"""

from __future__ import annotations

import glob
from collections.abc import Callable
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mcap.records import Channel as ChannelRecord
from mcap.records import Message, Metadata
from mcap.records import Schema as SchemaRecord

from roclog.errors import DamagedFile
from roclog.recording.entries import intact
from roclog.recording.records import Segment
from roclog.recording.scan import Scan
from roclog.recording.seal import SEGMENT_METADATA
from roclog.recording.summary import is_finished, read_metadata, read_summary

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from roclog.recording.summary import Summary

HOT: Final = "hot"
_SUFFIX: Final = ".mcap"
_STATES: Final = ("sealed", HOT, "unfinished", "unreadable")
_ATTEMPTS: Final = 10


Define = Callable[[ChannelRecord, SchemaRecord | None], None]
"""Told every channel found, with its schema."""


def list_segments(
    paths: Iterable[Path | str], known: Mapping[Path, Segment], define: Define
) -> list[Segment]:
    """Segments in reading order. ``known`` sealed ones are not looked at again.

    A hot segment that is sealed while this looks is found in its new place.

    Raises:
        ValueError: a path does not exist, or no file is found.
        DamagedFile: a file named by itself is not MCAP, or cannot be read.
    """
    wanted = list(paths)
    for _ in range(_ATTEMPTS):
        segments: list[Segment] = []
        for path, named in _files(wanted).items():
            segment = known.get(path)
            if segment is None or segment.state != "sealed":
                segment = _look(path, define, named=named)
            if segment is None:
                break
            segments.append(segment)
        else:
            return sorted(segments, key=_Order(segments))
    raise ValueError(f"{wanted[0]}: files come and go faster than they can be listed")


def _files(wanted: list[Path | str]) -> dict[Path, bool]:
    """Each file once; True where the user named the very file."""
    files: dict[Path, bool] = {}
    for name in wanted:
        found: list[Path] = []
        path = Path(name)
        named = path.is_file()
        if named:
            found = [path]
        elif path.is_dir():
            found = list(_below(path))
        elif glob.has_magic(str(name)):
            for match in _matches(str(name)):
                found += _below(match) if match.is_dir() else [match]
        else:
            raise ValueError(f"{name}: no such file or directory")
        if not found:
            raise ValueError(f"{name}: no recording here (no {_SUFFIX} file)")
        for one in found:
            files.setdefault(one.absolute(), named)
    return files


def _matches(pattern: str) -> list[Path]:
    """Looked for twice: a hot segment may be sealed after its new folder was passed."""
    found = {match for _ in range(2) for match in glob.glob(pattern, recursive=True)}  # noqa: PTH207
    return sorted(map(Path, found))


def _below(folder: Path) -> Iterator[Path]:
    """Hot segments are listed first: each is somewhere, whenever it is sealed meanwhile."""
    found = sorted(folder.rglob(f"{HOT}/*{_SUFFIX}"))
    found += sorted(folder.rglob(f"*{_SUFFIX}"))
    yield from (path for path in found if not path.name.startswith(".") and not path.is_dir())


def _look(path: Path, define: Define, *, named: bool) -> Segment | None:
    """None: the file has gone.

    Raises:
        DamagedFile: the file was ``named`` and nothing of it can be read.
    """
    try:
        summary = read_summary(path)
        if summary is not None:
            return _look_behind(path, summary, define)
        return _look_through(path, define)
    except FileNotFoundError:
        return None
    except OSError as error:
        problem = DamagedFile(path, 0, f"cannot be read ({error.strerror or error})")
        if named:
            raise problem from error
    except DamagedFile:
        if named:
            raise
    return Segment(path=path, size=0, state="unreadable")


def _look_behind(path: Path, summary: Summary, define: Define) -> Segment:
    facts: Mapping[str, str] = {}
    for name, offset in summary.metadata:
        if name == SEGMENT_METADATA:
            record = read_metadata(path, offset)
            if record is not None and record.name == name and intact(record.metadata):
                facts = record.metadata
    for channel in summary.channels.values():
        define(channel, summary.schemas.get(channel.schema_id))
    return _segment(path, "sealed", facts, summary.span)


def _look_through(path: Path, define: Define) -> Segment:
    """Of a file without a summary: our segments have all at their beginning, others may not."""
    facts: Mapping[str, str] = {}
    schemas: dict[int, SchemaRecord] = {}
    scan = Scan(path)
    for found in scan:
        match found.record:
            case Metadata(name=name, metadata=values) if name == SEGMENT_METADATA:
                facts = values if intact(values) else facts
            case SchemaRecord() as schema:
                schemas.setdefault(schema.id, schema)
            case ChannelRecord() as channel:
                define(channel, schemas.get(channel.schema_id))
            case Message() if scan.ours:
                break
    state = HOT if path.parent.name == HOT else "unfinished"
    return _segment(path, "sealed" if is_finished(path) else state, facts, None)


def _segment(
    path: Path, state: str, facts: Mapping[str, str], span: tuple[int, int] | None
) -> Segment:
    return Segment(
        path=path,
        size=path.stat().st_size,
        state=state,
        number=_number(facts.get("number")),
        logger=facts.get("logger", ""),
        run=facts.get("run", ""),
        version=facts.get("version", ""),
        opened_at=_number(facts.get("opened_at")),
        span=span,
    )


def _number(text: str | None) -> int | None:
    return int(text) if text is not None and text.isascii() and text.isdigit() else None


class _Order:
    """Sort key of a segment among ``segments``."""

    def __init__(self, segments: Iterable[Segment]) -> None:
        loggers: dict[str, int] = {}
        for segment in segments:
            if segment.number is not None:
                opened = segment.opened_at or 0
                loggers[segment.logger] = min(opened, loggers.get(segment.logger, opened))
        ranked = sorted(loggers.items(), key=itemgetter(1, 0))
        self._ranks = {logger: rank for rank, (logger, _) in enumerate(ranked)}

    def __call__(self, segment: Segment) -> tuple[int, int, int, str]:
        if segment.number is None:
            return len(self._ranks), 0, 0, str(segment.path)
        state = _STATES.index(segment.state)
        return self._ranks[segment.logger], segment.number, state, str(segment.path)

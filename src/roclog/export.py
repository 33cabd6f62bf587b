"""One file for each channel, as CSV (RFC 4180) or NDJSON.

Rows go to temporary files, which get their names when all of them are complete.
"""

from __future__ import annotations

import csv
import math
import os
import re
from contextlib import ExitStack
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Final, Literal, Protocol

from roclog.errors import StorageError
from roclog.quantities import format_instant
from roclog.recording.objects import TIME_FIELDS, as_line, fields_of, to_json
from roclog.recording.records import Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from roclog.recording.reader import Recording
    from roclog.recording.records import Channel, Record

Format = Literal["csv", "ndjson"]
TimeFormat = Literal["iso", "ns"]
_FIRST: Final = ("log_time", "device_time", "seq", "origin")
_LAST: Final = ("previous_read_at", "redelivered", "doubtful", "time_flags")
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_-]+")
_MOST: Final = 100
_EACH: Final = 1000


class TargetExistsError(ValueError):
    """Nothing was written; the path is the first of the files that stand in the way."""


@dataclass(frozen=True, slots=True)
class Style:
    """How values become text.

    raw_text: text that a spreadsheet would run as a formula stays as it is.
    """

    times: TimeFormat = "iso"
    raw_text: bool = False

    def cell(self, value: object) -> str:
        """Absent and not-a-number values are empty."""
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return ""
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, int | float):
            return repr(value)
        if isinstance(value, bytes):
            return value.hex()
        return self.text(to_json(value) if isinstance(value, list | dict) else str(value))

    def instant(self, nanoseconds: int | None) -> str:
        """As an integer where the calendar does not reach."""
        if nanoseconds is None:
            return ""
        if self.times == "ns":
            return str(nanoseconds)
        try:
            return format_instant(nanoseconds)
        except (ValueError, OverflowError, OSError):
            return str(nanoseconds)

    def text(self, value: str) -> str:
        """With an apostrophe before what Excel and LibreOffice take for a formula."""
        return f"'{value}" if value.startswith(_FORMULA) and not self.raw_text else value


@dataclass(frozen=True, slots=True)
class Written:
    """One file and its records."""

    path: Path
    records: int


def no_progress(done: int, total: int) -> None:
    """Octets of segments done, and of all: told to nobody."""
    del done, total


def export(
    recording: Recording,
    folder: Path,
    *,
    form: Format = "csv",
    channels: Iterable[str] | None = None,
    start: int | str | None = None,
    end: int | str | None = None,
    style: Style | None = None,
    force: bool = False,
    progress: Callable[[int, int], None] = no_progress,
) -> list[Written]:
    """Write each channel that can be decoded; a channel without records has a header row only.

    Args:
        recording: what to write.
        folder: made if it is not there.
        form: csv or ndjson.
        channels: topics or globs; None = all.
        start: earliest log_time, included.
        end: log_time from which on nothing is written.
        style: of times and text in CSV.
        force: replace files that exist.
        progress: called with octets of segments done, and of all.

    Raises:
        ValueError: no such channel, a text that is not an instant.
        TargetExistsError: without ``force``; nothing was written.
        StorageError: the folder cannot be written.
    """
    patterns = None if channels is None else list(channels)
    parts = recording.by_segment(patterns, start=start, end=end)
    chosen = recording.chosen_channels(patterns)
    targets = _targets(chosen, folder, form)
    existing = [path for path in targets.values() if path.exists()]
    if existing and not force:
        raise TargetExistsError(f"{existing[0]} exists already; nothing was written")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            sheets = {
                topic: _Sheet(channel, targets[topic], form, style or Style(), stack)
                for topic, channel in chosen.items()
            }
            done, total = 0, sum(segment.size for segment in recording.segments)
            for segment, records in parts:
                for count, record in enumerate(records, start=1):
                    sheets[record.topic].write(record)
                    if count % _EACH == 0:
                        progress(done, total)
                done += segment.size
                progress(done, total)
            return [sheet.finish() for sheet in sheets.values()]
    except OSError as error:
        where = folder if error.filename is None else error.filename
        raise StorageError(folder, f"{where}: {error.strerror or error}") from error


class _Sheet:
    """One file on its way; removed again unless ``finish`` was called."""

    def __init__(
        self, channel: Channel, target: Path, form: Format, style: Style, stack: ExitStack
    ) -> None:
        self._target = target
        self._temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
        self._count = 0
        stack.callback(self._temporary.unlink, missing_ok=True)
        self._file: IO[str] = stack.enter_context(
            self._temporary.open("w", encoding="utf-8", errors="backslashreplace", newline="")
        )
        self._write: Callable[[Record], object]
        if form == "ndjson":
            self._write = lambda record: self._file.write(as_line(record) + "\n")
        else:
            self._write = _CsvRows(channel, self._file, style).write

    def write(self, record: Record) -> None:
        self._count += 1
        self._write(record)

    def finish(self) -> Written:
        self._file.close()
        self._temporary.replace(self._target)
        return Written(self._target, self._count)


class _Rows(Protocol):
    def writerow(self, row: list[str], /) -> object: ...


class _CsvRows:
    def __init__(self, channel: Channel, file: IO[str], style: Style) -> None:
        self._style = style
        self._fields = [name for name in channel.fields if name != "raw"]
        self._is_sample = channel.kind == "sample"
        self._rows: _Rows = csv.writer(file, lineterminator="\r\n")
        first, last = (_FIRST, _LAST) if self._is_sample else (_FIRST[:1], ())
        self._before, self._behind = [""] * (len(first) - 1), [""] * len(last)
        self._rows.writerow([*first, *self._fields, *last])

    def write(self, record: Record) -> None:
        log_time = self._style.instant(record.log_time)
        values = fields_of(record)
        if isinstance(record, Sample):
            row = [self._style.cell(values.get(name)) for name in self._fields]
        else:
            row = [self._field(name, values.get(name)) for name in self._fields]
        before, behind = self._before, self._behind
        if isinstance(record, Sample) and self._is_sample:
            before = [self._style.instant(record.device_time), str(record.seq), record.origin]
            behind = [
                self._style.instant(record.previous_read_at),
                self._style.cell(record.redelivered),
                self._style.text(" ".join(record.doubtful)),
                " ".join(record.time_flags),
            ]
        self._rows.writerow([log_time, *before, *row, *behind])

    def _field(self, name: str, value: object) -> str:
        if name in TIME_FIELDS and isinstance(value, int):
            return self._style.instant(value)
        return self._style.cell(value)


def _targets(channels: dict[str, Channel], folder: Path, form: Format) -> dict[str, Path]:
    """A path for each topic. Names come out of files, so nothing in them may lead elsewhere."""
    taken: set[str] = set()
    targets: dict[str, Path] = {}
    for topic, channel in channels.items():
        parts = [_UNSAFE.sub("_", part) for part in (channel.device, channel.block) if part]
        base = ".".join(parts)[:_MOST] or "channel"
        name, number = base, 1
        while name.casefold() in taken:
            number += 1
            name = f"{base}-{number}"
        taken.add(name.casefold())
        targets[topic] = folder / f"{name}.{form}"
    return targets

"""Reading recordings without the logger: the official library, or the files the exporter wrote."""

from __future__ import annotations

import csv
import struct
from dataclasses import dataclass
from datetime import datetime
from decimal import Decimal
from typing import TYPE_CHECKING, Any

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_protobuf.decoder import DecoderFactory

from bench.recorder import roclog

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

Row = dict[str, str]


@dataclass(frozen=True)
class Item:
    """One message: ``values`` is the decoded protobuf message."""

    topic: str
    log_time: int
    sequence: int
    data: bytes
    values: Any
    publish_time: int


@dataclass(frozen=True)
class Gap:
    """UTC nanoseconds; ``expected`` samples. possible: the recorder says that it cannot tell.

    block: empty for the whole device.
    """

    since: int
    to: int
    expected: int
    reason: str
    possible: bool
    block: str


def stream(path: Path) -> Iterator[Item]:
    """Messages of a hot or a sealed file in file order; a torn tail ends it."""
    factory = DecoderFactory()
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            if channel.id not in decoders:
                schema = schemas[channel.schema_id]
                decoder = factory.decoder_for(channel.message_encoding, schema)
                assert decoder is not None, channel
                decoders[channel.id] = decoder
            values = decoders[channel.id](record.data)
            times = record.log_time, record.publish_time
            yield Item(channel.topic, times[0], record.sequence, record.data, values, times[1])


def _records(path: Path) -> Iterator[object]:
    with path.open("rb") as file:
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True)
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    yield from breakup_chunk(record, validate_crc=True)
                else:
                    yield record
        except (EndOfFile, struct.error):
            return


def is_finished(path: Path) -> bool:
    return any(isinstance(record, Footer) for record in _records(path))


def metadata(path: Path) -> dict[str, dict[str, str]]:
    return {r.name: dict(r.metadata) for r in _records(path) if isinstance(r, Metadata)}


def indexed(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, log time and octets of every message of a sealed file, through its index."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = reader.iter_messages(log_time_order=False)
        return [(channel.topic, item.log_time, item.data) for _, channel, item in found]


def files(directory: Path) -> list[Path]:
    """Sealed segments in order of their numbers, then hot ones."""
    sealed = directory.glob("[0-9]*/*/*/*.mcap")
    hot = (directory / "hot").glob("*.mcap")
    return sorted([*sealed, *hot], key=lambda path: path.stem.rpartition("-")[2])


def items(directory: Path, topic: str) -> list[Item]:
    return [item for path in files(directory) for item in stream(path) if item.topic == topic]


def gaps(directory: Path, device: str) -> list[Gap]:
    found = []
    for item in items(directory, f"/{device}/gap"):
        m = item.values
        names = m.DESCRIPTOR.fields_by_name["reason"].enum_type.values_by_number
        reason = names[m.reason].name.lower()
        found.append(Gap(getattr(m, "from"), m.to, m.expected, reason, m.possible, m.block))
    return list(dict.fromkeys(found))


def events(directory: Path, name: str) -> list[str]:
    """Texts of the ``/log`` events of that name."""
    return [i.values.message for i in items(directory, "/log") if i.values.name == name]


def export(directory: Path, out: Path) -> str:
    """Write CSV files with the command under test; returns what it said."""
    done = roclog("export", directory, "--format", "csv", "--out", out)
    assert done.returncode == 0, done.stderr
    return done.stderr


def read_csv(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def csv_rows(directory: Path, out: Path, device: str = "roc1") -> list[Row]:
    table = out / f"{device}.sample.csv"
    if not table.exists():
        said = export(directory, out)
        assert table.exists(), f"no {table}: {said}"
    return read_csv(table)


def number(text: str) -> Decimal:
    """A cell as an exact number; truth values as 0 and 1."""
    return Decimal({"true": "1", "false": "0"}.get(text.lower(), text))


def nanoseconds(text: str) -> int:
    """UTC nanoseconds of an ISO 8601 cell."""
    assert text.endswith("Z"), text
    whole, _, fraction = text[:-1].partition(".")
    return int(datetime.fromisoformat(whole + "+00:00").timestamp()) * 10**9 + int(
        fraction.ljust(9, "0") or 0
    )

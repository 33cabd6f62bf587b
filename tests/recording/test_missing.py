"""A measurement that is missing is absent in every reading, whatever kind of number it has."""

from __future__ import annotations

import csv
import json
import math
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import pytest
from mcap.writer import Writer

from roclog.clock import Instant
from roclog.export import export
from roclog.recording.entries import block_channel
from roclog.recording.reader import open_recording
from roclog.register_map import Block, Point, Table, ValidWhen, WordOrder, WordType
from roclog.samples import Reading, SampleMaker
from roclog.schema import Origin

if TYPE_CHECKING:
    from pathlib import Path

GOOD = ValidWhen(point="status", values=(0,))
BLOCK = Block(
    name="tank",
    table=Table.INPUT_REGISTERS,
    address=0,
    count=8,
    points=(
        Point(name="status", offset=0, type=WordType.U16),
        Point(name="level", offset=1, type=WordType.U16, scale=Decimal("0.1"), valid_when=GOOD),
        Point(name="flow", offset=2, type=WordType.F32, valid_when=GOOD),
        Point(
            name="mode",
            offset=4,
            type=WordType.U16,
            valid_when=GOOD,
            bits=((0, "open"),),
            parts=((4, 4, "step"),),
        ),
        Point(name="total", offset=5, type=WordType.BCD32),
        Point(name="last", offset=7, type=WordType.S16, sentinels=((Decimal(-1), "none"),)),
    ),
)
THERE = [0, 123, 0x41F4, 0x7AE1, 0x31, 0x0123, 0x4567, 5]
AWAY = [2, 123, 0x41F4, 0x7AE1, 0x31, 0x0123, 0x45A7, 0xFFFF]
NAMES = ["status", "level", "flow", "mode", "open", "step", "total", "last"]


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A file of two samples: one with all measurements, one with none."""
    maker = SampleMaker("site", "registers", BLOCK, WordOrder.ABCD, b"e" * 16)
    info = block_channel("site", "registers", BLOCK, maker.kind)
    path = tmp_path / "r.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(maker.kind.name, "protobuf", maker.kind.descriptor_set)
        channel = writer.register_channel(maker.topic, "protobuf", schema, dict(info.metadata))
        for number, words in enumerate((THERE, AWAY), start=1):
            now = Instant(1_795_000_000 * 10**9 + number, number)
            entry = maker.message(
                Reading(tuple(words), now, now, now, 0), number, Origin.CYCLIC, {}
            )
            writer.add_message(channel, entry.log_time, entry.data, entry.publish_time, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_reading(recorded: Path) -> None:
    there, away = open_recording(recorded).samples()
    whole = [0, 12.3, pytest.approx(30.56), 0x31, True, 3, 1234567, 5]
    assert list(there.values) == NAMES
    assert list(there.values.values()) == whole
    assert away.values == {**dict.fromkeys(NAMES), "status": 2}
    assert away.raw == b"".join(word.to_bytes(2) for word in AWAY)
    assert away.doubtful == ("total",)


def test_csv(recorded: Path, tmp_path: Path) -> None:
    recording = open_recording(recorded)
    export(recording, tmp_path)
    with (tmp_path / "site.tank.csv").open(newline="") as file:
        there, away = csv.DictReader(file)
    assert (there["level"], there["total"], there["open"]) == ("12.3", "1234567", "true")
    assert {name: away[name] for name in NAMES} == {**dict.fromkeys(NAMES, ""), "status": "2"}
    assert "missing" not in away


def test_ndjson(recorded: Path, tmp_path: Path) -> None:
    export(open_recording(recorded), tmp_path, form="ndjson")
    lines = (tmp_path / "site.tank.ndjson").read_text().splitlines()
    found: dict[str, Any] = json.loads(lines[1])["values"]
    assert found == {**dict.fromkeys(NAMES), "status": 2}


def test_other_readers_see_the_mask_and_no_number(recorded: Path) -> None:
    """Floats are NaN; integers stay what the device said, and the mask says that they are none."""
    from mcap.reader import make_reader  # noqa: PLC0415
    from mcap_protobuf.decoder import DecoderFactory  # noqa: PLC0415

    with recorded.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        there, away = (message for *_, message in reader.iter_decoded_messages())
    assert (there.missing, away.missing) == (0, 0b111110)
    assert math.isnan(away.level)
    assert math.isnan(away.flow)
    assert (away.mode, away.last) == (0x31, -1)

"""Samples come back as they were written, in the order in which they were recorded."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import mcapfiles as files
import pytest
from mcap.writer import CompressionType
from mcapfiles import SECOND, T0

import roclog
from roclog.devices.hiac_roc import SAMPLE as ROC_BLOCK
from roclog.recording.reader import open_recording
from roclog.schema import sample_type

if TYPE_CHECKING:
    from pathlib import Path

CONTENT = [
    files.event(T0),
    *(files.sample(seq) for seq in range(1, 6)),
    files.clear(5, T0 + 5 * SECOND + 1),
    files.gap(T0 + 6 * SECOND, T0, T0 + SECOND),
    files.link(T0 + 7 * SECOND),
]


def seqs(recording: Any, **which: Any) -> list[int]:
    return [sample.seq for sample in recording.samples(**which)]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_field_of_a_sealed_segment(tmp_path: Path, compression: CompressionType) -> None:
    path = files.write_sealed(tmp_path / "a.mcap", CONTENT, compression=compression)
    with roclog.open(path) as recording:
        samples = list(recording)
    second = samples[1]
    assert len(samples) == 5
    assert second == roclog.Sample(
        topic="/roc1/sample",
        device="roc1",
        block="sample",
        log_time=T0 + 2 * SECOND,
        publish_time=T0 + 2 * SECOND,
        seq=2,
        epoch=files.EPOCH,
        origin="flag",
        redelivered=False,
        asked_at=T0 + 2 * SECOND - 10_000_000,
        read_at=T0 + 2 * SECOND,
        read_at_monotonic=5 * SECOND + 2,
        previous_read_at=T0 + SECOND,
        device_time=T0 - SECOND,
        raw=bytes.fromhex("0002 0007 00fa"),
        values={
            "count_1": 2.25,
            "count_2": 0.02,
            "iso_code_1": 15.5,
            "nas_class": -2,
            "temperature": 25.1,
            "alarms": 2,
            "laser_low": False,
        },
    )
    assert list(second.values) == [*files.POINTS.split(","), "laser_low"]
    assert (samples[0].device_time, samples[0].previous_read_at) == (None, None)
    assert recording.damage == []


def test_what_stands_beside_the_samples(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", CONTENT))
    (gap,), (clear,), (link,), (event,) = (
        list(recording.gaps()),
        list(recording.clears()),
        list(recording.links()),
        list(recording.events()),
    )
    assert (gap.start, gap.end, gap.expected, gap.reason) == (T0, T0 + SECOND, 2, "downtime")
    assert (clear.seq, clear.epoch, clear.result, clear.guarded) == (5, files.EPOCH, "done", True)
    assert (link.values, link.end) == ({"requests": 60, "round_trip_mean": 0.02}, T0 + 7 * SECOND)
    assert (event.device, event.kind, event.level, event.text) == (
        "roc1",
        "baseline",
        "info",
        "first block",
    )
    assert event.time == T0
    assert recording.devices["roc1"].identity == {"manufacturer": "HIAC", "serial_number": "1234"}
    kinds = [type(record).__name__ for record in recording.records()]
    assert kinds == ["Event", *["Sample"] * 5, "Clear", "Gap", "Link"]


def test_gaps_of_files_that_say_whose_samples_are_missing(tmp_path: Path) -> None:
    gaps = [files.gap_of_block(T0 + SECOND, T0, T0 + 5, block) for block in ("sample", "")]
    path = files.write_sealed(tmp_path / "a.mcap", gaps, topics=files.WITH_BLOCKS)
    assert [gap.block for gap in open_recording(path).gaps()] == ["sample", ""]
    old = files.write_sealed(tmp_path / "b.mcap", CONTENT)
    assert [gap.block for gap in open_recording(old).gaps()] == [""]


def test_hot_and_sealed_read_the_same(tmp_path: Path) -> None:
    hot = files.write_hot(tmp_path / "hot" / "00000001.mcap", [[item] for item in CONTENT])
    sealed = files.write_sealed(tmp_path / "a.mcap", CONTENT)
    assert list(open_recording(hot).records()) == list(open_recording(sealed).records())
    assert [s.state for s in open_recording(hot).segments] == ["hot"]
    assert [s.state for s in open_recording(sealed).segments] == ["sealed"]


def test_own_encoder_and_official_runtime_agree(tmp_path: Path) -> None:
    """Octets packed by schema.MessageType, read through the descriptor that it embeds."""
    kind = sample_type("hiac-roc", ROC_BLOCK)
    values: list[Any] = [9, files.EPOCH, 2, True, T0 - 5, T0, 77, T0 - 9, 0, 1, 0b1001, bytes(54)]
    numbers = {
        f.name: (n % 2 == 0 if f.kind.name == "BOOL" else n) for n, f in enumerate(kind.fields)
    }
    values += [numbers[f.name] for f in kind.fields[12:]]
    metadata = {"points": ",".join(p.name for p in ROC_BLOCK.points), "payload": "[[5,1],[8,18]]"}
    topic = files.Topic("/roc1/sample", files.SAMPLE, metadata, schema=kind.descriptor_set)
    renamed = dataclasses.replace(topic, kind=_Named(kind.name))
    item = files.Item("/roc1/sample", T0, kind.pack(iter(values)), 9, T0)
    (sample,) = open_recording(files.write_sealed(tmp_path / "a.mcap", [item], topics=[renamed]))
    assert sample.values == {f.name: numbers[f.name] for f in kind.fields[13:]}
    assert (sample.seq, sample.epoch, sample.origin) == (9, files.EPOCH, "changed")
    assert sample.redelivered
    assert sample.doubtful == ("count_1", "count_4")
    assert sample.time_flags == ("no_time",)


class _Named:
    """Stands for a message class of which only the name is wanted."""

    def __init__(self, full_name: str) -> None:
        self.DESCRIPTOR = type("Descriptor", (), {"full_name": full_name})


def test_start_is_included_and_end_is_not(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", CONTENT))
    assert seqs(recording, start=T0 + 2 * SECOND, end=T0 + 4 * SECOND) == [2, 3]
    assert seqs(recording, start=T0 + 2 * SECOND + 1) == [3, 4, 5]
    assert seqs(recording, start="2026-11-18T11:06:43Z") == [3, 4, 5]
    assert seqs(recording, end="2026-11-18") == []


@pytest.mark.parametrize("chunk_size", [1, 300, 10**6])
def test_time_filters_do_not_depend_on_chunks(tmp_path: Path, chunk_size: int) -> None:
    path = files.write_sealed(tmp_path / "a.mcap", CONTENT, chunk_size=chunk_size)
    recording = open_recording(path)
    assert seqs(recording, start=T0 + 3 * SECOND, end=T0 + 5 * SECOND) == [3, 4]


def test_topics_globs_and_devices(tmp_path: Path) -> None:
    second = {**files.FLAGGED, "device": "roc2"}
    topics = [*files.TOPICS, files.Topic("/roc2/sample", files.SAMPLE, second)]
    items = [*CONTENT, files.sample(8, "/roc2/sample")]
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", items, topics=topics))
    assert seqs(recording, channel="/roc2/*") == [8]
    assert seqs(recording, channel=["/roc2/sample", "/roc1/sample"]) == [1, 2, 3, 4, 5, 8]
    assert seqs(recording, device="roc1") == [1, 2, 3, 4, 5]
    assert len(list(recording.gaps(device="roc1"))) == 1
    assert list(recording.gaps(device="roc2")) == []
    assert [type(r).__name__ for r in recording.records("/roc1/[gc]*")] == ["Clear", "Gap"]


def test_a_topic_that_is_not_there_names_those_that_are(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", CONTENT))
    with pytest.raises(ValueError, match=r"no channel matches '/roc9/\*'.*/log, /roc1/clear"):
        recording.samples("/roc9/*")
    with pytest.raises(ValueError, match="no device 'roc9'; there are: roc1"):
        recording.samples(device="roc9")
    with pytest.raises(ValueError, match="not an instant"):
        recording.samples(start="yesterday")


def test_paths_that_hold_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such file"):
        open_recording(tmp_path / "nothing")
    with pytest.raises(ValueError, match="no recording"):
        open_recording(tmp_path)
    with pytest.raises(ValueError, match="no recording"):
        open_recording(tmp_path / "*.mcap")
    with pytest.raises(ValueError, match="no path"):
        open_recording()
    (tmp_path / "text.mcap").write_text("not a recording")
    with pytest.raises(roclog.DamagedFile, match="not an MCAP file"):
        open_recording(tmp_path / "text.mcap")


def test_segments_in_order_of_their_numbers_whatever_their_names(tmp_path: Path) -> None:
    for name, number in (("a", 30), ("b", 4), ("c", 100)):
        files.write_sealed(
            tmp_path / f"{name}.mcap",
            [files.sample(number, at=T0 - number)],
            metadata=files.facts(number),
        )
    assert seqs(open_recording(tmp_path)) == [4, 30, 100]
    assert seqs(open_recording(tmp_path / "[ac].mcap")) == [30, 100]
    assert seqs(open_recording(tmp_path / "c.mcap", tmp_path / "a.mcap")) == [30, 100]


def test_a_second_reading_starts_anew(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", CONTENT))
    assert list(recording) == list(recording)
    assert recording.dropped == 0


def test_doubtful_points_have_their_names(tmp_path: Path) -> None:
    items = [files.sample(1, doubtful=0b100010, time_flags=1 << 31 | 0b11)]
    (sample,) = open_recording(files.write_sealed(tmp_path / "a.mcap", items))
    assert sample.doubtful == ("count_2", "alarms")
    assert sample.time_flags == ("no_time", "date_invalid", "bit_31")


def test_samples_cannot_be_changed_by_accident(tmp_path: Path) -> None:
    sample = next(iter(open_recording(files.write_sealed(tmp_path / "a.mcap", CONTENT))))
    with pytest.raises(dataclasses.FrozenInstanceError):
        sample.seq = 3  # type: ignore[misc]
    assert not hasattr(sample, "__dict__")


def test_fields_of_all_maps_that_a_device_has_had(tmp_path: Path) -> None:
    grown = files.message_class(
        "roclog.test_device.Sample", f"{files.SIGNATURE}, {files._POINTS}, flow 23 double"
    )
    files.write_sealed(tmp_path / "a.mcap", [files.sample(1)])
    topics = [files.Topic("/roc1/sample", grown, files.FLAGGED)]
    files.write_sealed(
        tmp_path / "b.mcap", [files.sample(2)], topics=topics, metadata=files.facts(2)
    )
    recording = open_recording(tmp_path)
    assert recording.channels["/roc1/sample"].fields[-2:] == ("laser_low", "flow")
    assert ["flow" in sample.values for sample in recording] == [False, True]

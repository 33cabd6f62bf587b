"""A sample is given once; only what is equal in key and payload counts as a copy."""

from __future__ import annotations

import shutil
import struct
import tracemalloc
from typing import TYPE_CHECKING, Any

import mcapfiles as files
import pytest
from mcapfiles import SECOND, T0

from roclog.recording.dedupe import Finding, SeenSamples, digest
from roclog.recording.reader import open_recording
from roclog.recording.records import Conflict

if TYPE_CHECKING:
    from pathlib import Path

ITEMS = [
    files.event(T0),
    *(files.sample(seq) for seq in range(1, 6)),
    files.clear(5, T0 + 9 * SECOND),
]


def again(seq: int, temperature: int = 250, **values: Any) -> files.Item:
    """Read once more after a restart; the temperature is live, so it is no part of the payload."""
    raw = struct.pack(">3H", seq % 65536, 7, temperature)
    return files.sample(seq, at=T0 + 100 * SECOND, redelivered=True, raw=raw, **values)


def test_a_redelivered_sample_is_dropped_though_live_words_have_changed(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", ITEMS)
    files.write_sealed(tmp_path / "b.mcap", [again(5, 260)], metadata=files.facts(2))
    recording = open_recording(tmp_path)
    assert [(s.seq, s.redelivered) for s in recording] == [(n, False) for n in range(1, 6)]
    assert (recording.dropped, recording.conflicts) == (1, [])


def test_another_payload_under_the_same_key_is_kept_and_told(tmp_path: Path) -> None:
    other = files.sample(5, at=T0 + 100 * SECOND, raw=b"\0\x06\0\x07\0\xfa")
    files.write_sealed(tmp_path / "a.mcap", ITEMS)
    files.write_sealed(tmp_path / "b.mcap", [other], metadata=files.facts(2))
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1, 2, 3, 4, 5, 5]
    assert recording.conflicts == [Conflict("/roc1/sample", files.EPOCH, 5, T0 + 100 * SECOND)]
    assert recording.dropped == 0


def test_conflicting_samples_are_each_given_once_if_the_recording_is_given_twice(
    tmp_path: Path,
) -> None:
    other = files.sample(5, at=T0 + 100 * SECOND, raw=b"\0\x06\0\x07\0\xfa")
    for folder in ("one", "two"):
        files.write_sealed(tmp_path / folder / "a.mcap", [*ITEMS, other])
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1, 2, 3, 4, 5, 5]
    assert (recording.dropped, len(recording.conflicts)) == (6, 1)


def test_another_epoch_is_another_sample(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", [*ITEMS, files.sample(5, epoch=bytes(16))])
    assert [s.seq for s in open_recording(tmp_path)] == [1, 2, 3, 4, 5, 5]


def test_without_a_flag_all_octets_are_the_payload(tmp_path: Path) -> None:
    """Two cyclic reads of the same registers are two samples, whatever their numbers say."""
    metadata = {k: v for k, v in files.FLAGGED.items() if k != "payload"}
    topics = [files.Topic("/roc1/sample", files.SAMPLE, metadata)]
    items = [files.sample(1), files.sample(1, at=T0 + 5 * SECOND), files.sample(1)]
    path = files.write_sealed(tmp_path / "a.mcap", items, topics=topics)
    recording = open_recording(path)
    assert len(list(recording)) == 2
    assert (recording.dropped, len(recording.conflicts)) == (1, 1)


@pytest.mark.parametrize("order", [("a", "b"), ("b", "a")])
def test_the_same_recording_twice(tmp_path: Path, order: tuple[str, str]) -> None:
    for folder in order:
        files.write_sealed(tmp_path / folder / "x.mcap", ITEMS)
    recording = open_recording(*(tmp_path / folder for folder in order))
    once = open_recording(tmp_path / "a")
    assert list(recording.records()) == list(once.records())
    assert recording.dropped == 5


def test_partial_copies_complete_each_other(tmp_path: Path) -> None:
    """As two recovered copies of one damaged segment may."""
    whole = files.hot_octets([[item] for item in ITEMS])
    head = len(files.hot_octets([[item] for item in ITEMS[:3]]))
    spoiled = bytearray(whole)
    spoiled[head + 90] ^= 1
    (tmp_path / "a.mcap").write_bytes(spoiled)
    (tmp_path / "b.mcap").write_bytes(whole[:-10])
    recording = open_recording(tmp_path)
    assert sorted(s.seq for s in recording) == [1, 2, 3, 4, 5]
    assert recording.dropped == 4


def test_hot_and_sealed_copy_both_listed(tmp_path: Path) -> None:
    files.write_hot(tmp_path / "hot" / "1.mcap", [[item] for item in ITEMS])
    files.write_sealed(tmp_path / "2026" / "1.mcap", ITEMS)
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1, 2, 3, 4, 5]
    assert len(list(recording.events())) == 1
    assert recording.dropped == 0


def test_hot_copy_helps_where_the_sealed_one_is_damaged(tmp_path: Path) -> None:
    files.write_hot(tmp_path / "hot" / "1.mcap", [[item] for item in ITEMS])
    path = files.write_sealed(tmp_path / "2026" / "1.mcap", ITEMS, chunk_size=1)
    octets = bytearray(path.read_bytes())
    octets[octets.rindex(b"\x28\xb5\x2f\xfd") + 20] ^= 1
    path.write_bytes(octets)
    recording = open_recording(tmp_path)
    assert len(list(recording.records())) == len(ITEMS)
    assert recording.damage


def test_copies_of_events_in_the_segment_that_a_failing_disk_made_necessary(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", ITEMS)
    files.write_sealed(tmp_path / "b.mcap", ITEMS, metadata=files.facts(2))
    recording = open_recording(tmp_path)
    assert len(list(recording.events())) == len(list(recording.clears())) == 1


def test_a_redelivered_sample_is_dropped_in_every_slice(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", ITEMS)
    files.write_sealed(
        tmp_path / "b.mcap",
        [again(5), files.sample(6, at=T0 + 101 * SECOND)],
        metadata=files.facts(2),
    )
    recording = open_recording(tmp_path)
    first = [s.seq for s in recording.samples(end=T0 + 50 * SECOND)]
    second = [s.seq for s in recording.samples(start=T0 + 50 * SECOND)]
    assert first + second == [1, 2, 3, 4, 5, 6]
    assert recording.dropped == 1


def test_a_redelivered_sample_whose_first_copy_is_lost_is_kept(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "b.mcap", [again(5)])
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording.samples(start=T0 + 50 * SECOND)] == [5]
    assert [s.seq for s in recording] == [5]


def test_recovered_copy_by_the_official_writer(tmp_path: Path) -> None:
    """`mcap recover` writes the same messages into other chunks, under its own library name."""
    original = files.write_hot(tmp_path / "hot" / "1.mcap", [[item] for item in ITEMS])
    files.write_sealed(tmp_path / "r.mcap", ITEMS, library="mcap go v1.7.0", chunk_size=10)
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1, 2, 3, 4, 5]
    shutil.copy(original, tmp_path / "copy.mcap")
    assert [s.seq for s in open_recording(tmp_path)] == [1, 2, 3, 4, 5]


def test_missing_numbers() -> None:
    seen = SeenSamples()
    for seq in (*range(1, 130), 131, *range(500, 700)):
        seen.add("/a", b"e", seq, digest(b"x"))
    assert list(seen.holes()) == [("/a", b"e", 130, 130), ("/a", b"e", 132, 499)]


def test_order_does_not_matter() -> None:
    seen = SeenSamples()
    assert seen.add("/a", b"e", 2**64 - 1, 5) is Finding.NEW
    assert seen.add("/a", b"e", 0, 5) is Finding.NEW
    assert seen.add("/a", b"e", 2**64 - 1, 5) is Finding.COPY
    assert seen.add("/a", b"e", 0, 6) is Finding.CONFLICT
    assert seen.add("/a", b"e", 0, 6) is Finding.COPY
    assert seen.add("/a", b"e", 0, 5) is Finding.COPY


def test_the_index_takes_about_nine_octets_a_sample() -> None:
    seen = SeenSamples()
    tracemalloc.start()
    for seq in range(100_000):
        seen.add("/a", b"e", seq, seq + 1)
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert size < 12 * 100_000

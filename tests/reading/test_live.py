"""Reading while the recorder writes, rotates and seals."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import mcapfiles as files
from mcapfiles import T0

from roclog.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

ITEMS = [files.event(T0), *(files.sample(seq) for seq in range(1, 6))]


def test_a_growing_segment_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = files.write_hot(tmp_path / "hot" / "1.mcap", [[ITEMS[1]]])
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1]
    samples = recording.samples()
    files.write_hot(path, [[ITEMS[1]], [ITEMS[2]]])
    assert [s.seq for s in samples] == [1, 2]
    with path.open("ab") as file:
        file.write(files.hot_octets([[ITEMS[3]]])[len(files.hot_octets([])) :])
    assert [s.seq for s in recording] == [1, 2, 3]
    assert recording.damage == []


def test_a_record_that_is_only_being_written_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = files.hot_octets([[ITEMS[1]], [ITEMS[2]]])
    path = tmp_path / "hot" / "1.mcap"
    path.parent.mkdir()
    path.write_bytes(whole[:-5])
    recording = open_recording(tmp_path)

    def others_write(_: float) -> None:
        path.write_bytes(whole)

    monkeypatch.setattr(time, "sleep", others_write)
    assert [s.seq for s in recording] == [1]
    assert recording.damage == []


def test_a_record_cut_off_by_a_crash_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "hot" / "1.mcap"
    path.parent.mkdir()
    path.write_bytes(files.hot_octets([[ITEMS[1]], [ITEMS[2]]])[:-5])
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1]
    assert "of the last record" in str(recording.damage[0])


def test_a_segment_that_does_not_exist_yet_in_full(tmp_path: Path) -> None:
    files.write_hot(tmp_path / "hot" / "1.mcap", [[ITEMS[1]]])
    (tmp_path / "hot" / "2.mcap").write_bytes(b"")
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1]


def test_sealed_between_listing_and_reading(tmp_path: Path) -> None:
    hot = files.write_hot(tmp_path / "hot" / "1.mcap", [[item] for item in ITEMS[:3]])
    files.write_hot(
        tmp_path / "hot" / "2.mcap", [[item] for item in ITEMS[3:]], metadata=files.facts(2)
    )
    recording = open_recording(tmp_path)
    records = recording.records()
    files.write_sealed(tmp_path / "2026" / "11" / "18" / "1.mcap", ITEMS[:3])
    hot.unlink()
    assert [getattr(r, "seq", None) for r in records] == [None, 1, 2, 3, 4, 5]
    assert recording.damage == []
    assert [getattr(r, "seq", None) for r in recording.records()] == [None, 1, 2, 3, 4, 5]


def test_sealed_while_it_is_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from roclog.recording import listing  # noqa: PLC0415

    hot = files.write_hot(tmp_path / "hot" / "1.mcap", [[item] for item in ITEMS])
    look = listing._look

    def seal_first(*arguments: Any, **named: Any) -> Any:
        if hot.exists():
            files.write_sealed(tmp_path / "2026" / "1.mcap", ITEMS)
            hot.unlink()
        return look(*arguments, **named)

    monkeypatch.setattr(listing, "_look", seal_first)
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1, 2, 3, 4, 5]
    assert [s.state for s in recording.segments] == ["sealed"]


def test_deleted_by_retention_between_listing_and_reading(tmp_path: Path) -> None:
    old = files.write_sealed(tmp_path / "a.mcap", ITEMS[:3])
    files.write_sealed(tmp_path / "b.mcap", ITEMS[3:], metadata=files.facts(2))
    recording = open_recording(tmp_path)
    samples = recording.samples()
    old.unlink()
    assert [s.seq for s in samples] == [3, 4, 5]
    assert "removed before it was read" in str(recording.damage[0])


def test_segments_added_later_are_found_by_the_next_reading(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", ITEMS[:3])
    recording = open_recording(tmp_path)
    assert [s.seq for s in recording] == [1, 2]
    files.write_sealed(tmp_path / "b.mcap", ITEMS[3:], metadata=files.facts(2))
    assert [s.seq for s in recording] == [1, 2, 3, 4, 5]

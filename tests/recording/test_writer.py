"""Commit, rotation, and a disk that says no: faults are injected at the system calls."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from mcap.records import Metadata
from recording_bench import MAKER, START, Bench, ManualClock, open_bench, sample

import roclog
from roclog.errors import StorageError
from roclog.recording.entries import gap_entry, in_order, log_entry
from roclog.recording.retention import Retention
from roclog.recording.scan import Scan
from roclog.recording.sealer import Sealer
from roclog.recording.segment import HotSegment
from roclog.recording.writer import Limits
from roclog.schema import Reason

if TYPE_CHECKING:
    from collections.abc import Callable


def counts(root: Path) -> list[float]:
    with roclog.open(root) as recording:
        return [float(str(s.values["count_1"])) for s in recording.samples()]


class FailingDisk:
    """Lets ``after`` calls of a system call through, then fails ``times`` of them."""

    def __init__(self, call: Callable[..., int | None], after: int, times: int, code: int) -> None:
        self.call = call
        self.left = after
        self.times = times
        self.code = code
        self.failed = 0

    def __call__(self, *arguments: object) -> int | None:
        if self.left > 0:
            self.left -= 1
        elif self.failed < self.times:
            self.failed += 1
            raise OSError(self.code, os.strerror(self.code))
        return self.call(*arguments)


def test_a_commit_is_readable_before_it_returns(bench: Bench) -> None:
    for number in range(1, 6):
        bench.commit(number)
        assert counts(bench.root) == [n / 100 for n in range(1, number + 1)]


def test_close_seals_and_a_restart_goes_on_with_the_numbers(tmp_path: Path) -> None:
    clock = ManualClock()
    for run in range(3):
        bench = open_bench(tmp_path, clock)
        assert bench.inheritance.carry.get("/roc1/sample", {}).get("seq", 0) == run
        bench.commit(run + 1)
        bench.close()
        assert not list(bench.directory.hot.iterdir())
    assert counts(tmp_path) == [0.01, 0.02, 0.03]
    assert [s.number for s in roclog.open(tmp_path).segments] == [1, 2, 3]


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC])
@pytest.mark.parametrize("name", ["fsync", "write"])
@pytest.mark.parametrize("after", range(4))
def test_one_failure_costs_a_segment_and_no_sample(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, name: str, after: int, code: int
) -> None:
    bench.commit(1)
    disk = FailingDisk(getattr(os, name), after, 1, code)
    monkeypatch.setattr(os, name, disk)
    for number in range(2, 6):
        bench.commit(number)
    monkeypatch.undo()
    assert disk.failed == 1
    assert counts(bench.root) == [0.01, 0.02, 0.03, 0.04, 0.05]


def test_a_failed_fsync_is_never_followed_by_another_on_the_same_file(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.commit(1)
    synced: list[tuple[str, bool]] = []
    failing = iter([True])

    def fsync(fd: int) -> None:
        path = str(Path(f"/proc/self/fd/{fd}").readlink())
        bad = next(failing, False)
        synced.append((path, bad))
        if bad:
            raise OSError(errno.EIO, "injected")

    monkeypatch.setattr(os, "fsync", fsync)
    bench.commit(2)
    monkeypatch.undo()
    failed = [path for path, bad in synced if bad]
    assert len(failed) == 1
    assert [path for path, _ in synced].count(failed[0]) == 1
    assert counts(bench.root) == [0.01, 0.02]


def test_a_dead_disk_fails_the_commit_and_a_living_one_takes_it_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.commit(1)
    disk = FailingDisk(os.write, 0, 10**6, errno.ENOSPC)
    monkeypatch.setattr(os, "write", disk)
    for number in (2, 3):
        with pytest.raises(StorageError, match="No space left on device"):
            bench.commit(number)
    assert disk.failed >= 4
    assert len(list(bench.directory.hot.iterdir())) <= 1
    monkeypatch.undo()
    bench.commit(2)
    assert counts(bench.root) == [0.01, 0.02]


def test_what_is_learnt_while_the_disk_takes_nothing_is_in_the_next_segment(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the writer does not even try, since it has failed just now."""
    bench.commit(1)
    monkeypatch.setattr(os, "write", FailingDisk(os.write, 0, 10**6, errno.ENOSPC))
    with pytest.raises(StorageError):
        bench.commit(2)
    begun = bench.writer.begin(
        "roclog.device.roc1", {"unit": "9"}, {MAKER.topic: None, "/roc1": {"seq": 0, "who": "B"}}
    )
    with pytest.raises(StorageError):
        begun.result(10)
    monkeypatch.undo()
    bench.commit(2)
    newest = max(bench.directory.hot_segments(), key=lambda path: path.name)
    records = [found.record for found in Scan(newest)]
    said = {record.name: record.metadata for record in records if isinstance(record, Metadata)}
    assert said["roclog.device.roc1"]["unit"] == "9"
    assert json.loads(said["roclog.state"]["state"]) == {"/roc1": {"seq": 0, "who": "B"}}
    assert bench.directory.inherit().carry["/roc1"]["who"] == "B"


def test_what_was_only_noted_is_written_again_with_the_next_segment(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.writer.note([log_entry(START, "info", "noted", "text")]).result(10)
    monkeypatch.setattr(os, "fsync", FailingDisk(os.fsync, 0, 1, errno.EIO))
    bench.commit(1)
    monkeypatch.undo()
    newest = max(bench.directory.hot_segments(), key=lambda path: path.name)
    with roclog.open(newest) as recording:
        assert [event.kind for event in recording.events()] == ["noted"]


def test_rotation_by_size_and_by_age(tmp_path: Path, clock: ManualClock) -> None:
    bench = open_bench(tmp_path, clock, Limits(duration=10 * 10**9, size=6000))
    for number in range(1, 41):
        bench.commit(number)
    bench.close()
    with roclog.open(tmp_path) as recording:
        assert len(recording.segments) > 4
        assert [s.seq for s in recording.samples()] == list(range(1, 41))
        assert not recording.missing


def test_wall_clock_back_begins_a_new_segment(tmp_path: Path, clock: ManualClock) -> None:
    bench = open_bench(tmp_path, clock)
    bench.commit(1)
    clock.utc -= 3600 * 10**9
    bench.commit(2)
    bench.commit(3)
    clock.utc += 86400 * 10**9
    bench.commit(4)
    bench.close()
    with roclog.open(tmp_path) as recording:
        samples = list(recording.samples())
        assert [s.seq for s in samples] == [1, 2, 3, 4]
        assert samples[1].log_time < samples[0].log_time
        assert len(recording.segments) == 2


def test_log_time_is_levelled_by_milliseconds_only(bench: Bench) -> None:
    early = sample(2, bench.clock)
    bench.clock.advance(5_000_000)
    bench.writer.commit([sample(1, bench.clock)]).result(10)
    bench.writer.commit([early]).result(10)
    with roclog.open(bench.root) as recording:
        first, second = recording.samples()
    assert second.log_time == first.log_time
    assert second.read_at == START


def test_a_second_recorder_is_told(bench: Bench) -> None:
    with pytest.raises(StorageError, match="another roclog is recording"):
        open_bench(bench.root, bench.clock)


def test_a_deleted_folder_fails_the_commit_and_is_made_again(bench: Bench) -> None:
    bench.commit(1)
    shutil.rmtree(bench.root)
    bench.commit(2)
    assert counts(bench.root) == [0.02]


def test_a_failing_disk_is_not_littered(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.commit(1)
    append = HotSegment.append

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "injected")

    monkeypatch.setattr(HotSegment, "append", refuse)
    for number in range(2, 60):
        with pytest.raises(StorageError):
            bench.commit(number)
    monkeypatch.setattr(HotSegment, "append", append)
    bench.clock.advance(10 * 10**9)
    bench.commit(2)
    bench.sealer.close()
    assert counts(bench.root) == [0.01, 0.02]
    assert len(bench.directory.sealed_segments()) + len(bench.directory.hot_segments()) <= 3


def test_messages_that_wait_together_are_in_order_of_time(bench: Bench) -> None:
    first = sample(1, bench.clock)
    bench.clock.advance(20 * 10**9)
    second = sample(2, bench.clock)
    assert in_order([[second], [first]]) == [first, second]


def test_one_devices_messages_keep_their_order_when_the_clock_is_set_back(bench: Bench) -> None:
    first = sample(1, bench.clock)
    bench.clock.utc -= 3600 * 10**9
    second = sample(2, bench.clock)
    bench.writer.commit([first, second]).result(10)
    with roclog.open(bench.root) as recording:
        assert [s.seq for s in recording.samples()] == [1, 2]
    assert bench.inheritance.carry["/roc1/sample"]["seq"] == 2


def test_a_killed_run_was_read_until_its_last_request(tmp_path: Path) -> None:
    """Not until the end of the answer: a sample may have completed while that was on its way."""
    clock = ManualClock()
    bench = open_bench(tmp_path / "one", clock)
    asked = clock.now()
    clock.advance(300_000_000)
    bench.writer.commit([sample(1, clock, asked)]).result(10)
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    next_run = open_bench(tmp_path / "two", clock)
    carried = next_run.inheritance.carry["/roc1/sample"]
    assert (carried["seq"], carried["read_at"]) == (1, asked.utc)
    assert carried["sampled_at"] == clock.now().utc
    next_run.close()
    bench.close()


def test_a_run_killed_behind_its_last_gaps_has_told_them(tmp_path: Path) -> None:
    """No sample says so of them, and another run would tell the same spell once more."""
    clock = ManualClock()
    bench = open_bench(tmp_path / "one", clock)
    bench.commit(1)
    told = clock.now().utc + 60 * 10**9
    gap = gap_entry("roc1", START, told, 3, Reason.UNREAD, block="sample", now=told, possible=True)
    carry = {**bench.inheritance.carry["/roc1/sample"], "read_at": told}
    bench.writer.commit([gap._replace(carry=carry, carry_topic="/roc1/sample")]).result(10)
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    next_run = open_bench(tmp_path / "two", clock)
    carried = next_run.inheritance.carry["/roc1/sample"]
    assert (carried["seq"], carried["read_at"]) == (1, told)
    next_run.close()
    bench.close()


def test_retention_goes_by_number_and_leaves_foreign_files(tmp_path: Path) -> None:
    clock = ManualClock()
    names = ("2026/01/01/20260101T000000Z-00000001", "1970/01/01/19700101T000000Z-00000002")
    paths = [tmp_path / f"{name}.mcap" for name in (*names, "2026/01/02/20260102T000000Z-00000003")]
    foreign = tmp_path / "2026/01/01/holiday.mcap"
    for path in (*paths, foreign):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(1000))
    assert list(Retention(clock, None, 2000).apply(tmp_path)) == [paths[0]]
    assert foreign.exists()


def test_a_segment_that_a_crash_left_without_a_head_is_not_in_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sealer sets it aside when it comes to it, which may be later."""
    first = open_bench(tmp_path, ManualClock())
    first.commit(1)
    first.close()
    headless = tmp_path / "hot" / "00000002.mcap"
    headless.write_bytes(b"")
    monkeypatch.setattr(Sealer, "seal", lambda *_: None)
    second = open_bench(tmp_path, ManualClock())
    second.commit(2)
    names = [path.name for path in second.directory.hot_segments()]
    second.close()
    assert names == ["00000002.mcap", "00000003.mcap"]
    assert headless.read_bytes() == b""

"""A full disk, a failing fsync, and a kill at the N-th fsync."""

from __future__ import annotations

import os
import shutil
import subprocess
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from bench.judge import check_gaps, compare
from bench.needs import need
from bench.peer import Roc
from bench.recorder import Recorder, roclog
from bench.recording import csv_rows, events, gaps

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

DEVICE = 'poll = "50ms"\ncycle = "200ms"'


@contextmanager
def small_disk(place: Path, size: str) -> Iterator[None]:
    need("root", os.geteuid() == 0)
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
    mounted = subprocess.run(command, capture_output=True, text=True, check=False)
    need("mounting a tmpfs", mounted.returncode == 0)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


def fill(ballast: Path) -> None:
    with ballast.open("wb") as file:
        while True:
            os.write(file.fileno(), bytes(512))


@pytest.mark.root
def test_a_full_disk(tmp_path: Path) -> None:
    """Recording goes on when space returns; until then nothing is cleared."""
    disk = tmp_path / "disk"
    with small_disk(disk, "96k"), Roc(tmp_path, samples=10**6) as roc:
        ballast = disk / "ballast"
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE), directory=disk / "recordings")
        with recorder.start() as child:
            child.while_it_runs(lambda: len(roc.truth.cleared) > 5, "some clears")
            with pytest.raises(OSError, match="No space"):
                fill(ballast)
            child.while_it_runs(lambda: "nothing is cleared" in child.talk(), "a complaint")
            cleared, made = len(roc.truth.cleared), len(roc.truth.made)
            child.while_it_runs(lambda: len(roc.truth.made) > made + 10, "ten more samples")
            assert len(roc.truth.cleared) == cleared
            ballast.unlink()
            child.while_it_runs(lambda: len(roc.truth.cleared) > cleared + 5, "clears again")
            assert child.stop() == 0, child.talk()
        truth = roc.end()
        comparison = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
        assert comparison.clean
        assert set(truth.cleared) <= set(comparison.found)
        lost = [k for k in comparison.missing if k < comparison.found[-1]]
        assert check_gaps(lost, truth, gaps(recorder.directory, "roc1")).uncovered == []
        assert "recording again" in events(recorder.directory, "roc1.storage")


@pytest.mark.root
def test_a_directory_on_a_read_only_disk(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    with small_disk(disk, "96k"), Roc(tmp_path, samples=1) as roc:
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE), directory=disk / "recordings")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        done = roclog("record", recorder.config, "--quiet")
        assert done.returncode == 6
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert str(disk) in done.stderr


def strace(log: Path, injection: str) -> list[str]:
    need("strace", shutil.which("strace") is not None)
    allowed = subprocess.run(["strace", "-o", "/dev/null", "true"], check=False).returncode == 0
    need("tracing a process", allowed)
    trace = ["-e", "trace=fsync", "-e", f"inject=fsync:{injection}"]
    return ["strace", "-f", "-qq", "-o", str(log), *trace]


@pytest.mark.parametrize("number", [8, 9, 15])
def test_an_fsync_that_fails(tmp_path: Path, number: int) -> None:
    """A new segment, nothing lost, nothing cleared on the strength of the failed one."""
    log = tmp_path / "strace"
    with Roc(tmp_path, samples=10**6, check_disk=tmp_path / "recordings") as roc:
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE))
        under = strace(log, f"error=EIO:when={number}")
        with recorder.start(under=under) as child:
            child.while_it_runs(lambda: len(roc.truth.cleared) > 12, "some clears")
            assert child.stop() == 0, child.talk()
        truth = roc.end()
    assert "INJECTED" in log.read_text()
    comparison = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
    assert comparison.clean
    assert set(truth.cleared) <= set(comparison.found)
    assert all(line["on_disk"] for line in truth.of("clear"))
    assert comparison.missing == [k for k in truth.made if k > comparison.found[-1]]
    assert len(recorder.sealed()) >= 2


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6, 7, 9, 12])
def test_a_kill_at_an_fsync(tmp_path: Path, number: int) -> None:
    log = tmp_path / "strace"
    with Roc(tmp_path, samples=10**6) as roc:
        recorder = Recorder(tmp_path, roc.toml(device=DEVICE))
        with recorder.start(under=strace(log, f"signal=SIGKILL:when={number}")) as child:
            child.wait()
        assert "killed by SIGKILL" in log.read_text()
        cleared = roc.truth.cleared
        with recorder.start() as child:
            child.while_it_runs(lambda: len(roc.truth.cleared) > len(cleared) + 2, "more clears")
            assert child.stop() == 0, child.talk()
        truth = roc.end()
    comparison = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
    assert comparison.clean
    assert set(truth.cleared) <= set(comparison.found)
    assert recorder.hot() == []

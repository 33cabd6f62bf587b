"""Every state a power cut can leave of a hot segment: commits are read, wrong data never.

The writes and fsyncs that HotSegment really makes are recorded; then, for every instant, each
sector written since the last fsync may have reached the disk, not, or hold garbage, and the file
may have any length in between.
"""

from __future__ import annotations

import os
import random
from typing import TYPE_CHECKING

from recording_bench import CHANNELS, ManualClock, sample

import roclog
from roclog.errors import DamagedFile
from roclog.recording.segment import HotSegment

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import pytest

SECTOR = 512
FACTS = {
    "number": "1",
    "logger": "l",
    "run": "r",
    "boot_id": "b",
    "version": "0",
    "opened_at": "0",
    "opened_at_monotonic": "0",
}
Operation = tuple[str, int, bytes]


def recorded(path: Path, monkeypatch: pytest.MonkeyPatch, samples: int) -> list[Operation]:
    """What the segment does to its file: writes with their offsets, and successful fsyncs."""
    done: list[Operation] = []
    real_write, real_sync, at = os.write, os.fsync, 0

    def write(fd: int, octets: bytes) -> int:
        nonlocal at
        half = len(octets) // 2 or len(octets)  # the system may take less than it is given
        count = real_write(fd, octets[:half])
        done.append(("write", at, bytes(octets[:count])))
        at += count
        return count

    def fsync(fd: int) -> None:
        real_sync(fd)
        done.append(("fsync", 0, b""))

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(os, "fsync", fsync)
    clock = ManualClock()
    hot = HotSegment(path, "roclog test", CHANNELS, {"roclog.segment": FACTS})
    for number in range(1, samples + 1):
        clock.advance(10**9)
        hot.append([sample(number, clock)], sync=True)
        done.append(("committed", number, b""))
    hot.close()
    monkeypatch.undo()
    return done


def states(done: list[Operation], rng: random.Random, each: int) -> Iterator[tuple[int, bytes]]:
    """(number of committed samples, contents) after a cut behind any operation."""
    for end in range(len(done) + 1):
        past = done[:end]
        committed = max((n for kind, n, _ in past if kind == "committed"), default=0)
        synced = max((i for i, (kind, _, _) in enumerate(past) if kind == "fsync"), default=-1)
        base = b"".join(octets for kind, _, octets in past[: synced + 1] if kind == "write")
        loose = b"".join(octets for kind, _, octets in past[synced + 1 :] if kind == "write")
        for _ in range(each if loose else 1):
            tail = bytearray(loose)
            for start in range(0, len(tail), SECTOR):
                sector = slice(start, start + SECTOR)
                fate = rng.random()
                if fate < 0.25:
                    tail[sector] = bytes(len(tail[sector]))
                elif fate < 0.5:
                    tail[sector] = rng.randbytes(len(tail[sector]))
            length = rng.choice((0, len(tail), rng.randint(0, len(tail))))
            yield committed, base + bytes(tail[:length])


def test_no_crash_state_loses_a_commit_or_invents_a_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = random.Random(1)
    done = recorded(tmp_path / "hot.mcap", monkeypatch, samples=6)
    path = tmp_path / "state.mcap"
    explored = 0
    for committed, contents in states(done, rng, each=60):
        explored += 1
        path.write_bytes(contents)
        try:
            with roclog.open(path) as recording:
                found = [(s.seq, s.values["count_1"]) for s in recording.samples()]
        except DamagedFile:
            found = []
        numbers = [seq for seq, _ in found]
        assert numbers == list(range(1, len(found) + 1))
        assert len(found) >= committed
        assert all(value == seq / 100 for seq, value in found)
    assert explored > 700

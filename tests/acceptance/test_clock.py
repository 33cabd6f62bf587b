"""The wall clock set back an hour and forward a day while recording."""

from __future__ import annotations

import shutil
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest
from bench.judge import compare
from bench.needs import need
from bench.peer import Roc
from bench.recorder import Recorder
from bench.recording import csv_rows, events, items, stream

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bench.process import Child

_LIBRARY = "libfaketimeMT.so.1"


def faketime() -> str:
    found = [str(place) for place in Path("/usr/lib").glob(f"**/faketime/{_LIBRARY}")]
    need("libfaketime", bool(found) and shutil.which("faketime") is not None)
    return found[0]


def told(child: Child, steps: int) -> bool:
    return child.talk().count("was stepped") >= steps


def cleared(roc: Roc, goal: int) -> bool:
    return len(roc.truth.cleared) >= goal


@pytest.fixture
def quick() -> Iterator[Path]:
    """A folder in memory: every look at the clock opens a file, on a disk that others may sync."""
    memory = Path("/dev/shm")
    with TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        yield Path(name)


def test_steps_of_the_wall_clock(tmp_path: Path, quick: Path) -> None:
    offset = quick / "offset"

    def step(seconds: int) -> None:
        new = quick / "offset.new"
        new.write_text(f"{seconds:+d}")
        new.replace(offset)

    environment = {
        "LD_PRELOAD": faketime(),
        "FAKETIME_TIMESTAMP_FILE": str(offset),
        "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
    }
    step(0)
    with Roc(tmp_path, cycle=2.0, samples=10**6) as roc:
        recorder = Recorder(tmp_path, roc.toml(device='poll = "100ms"\ncycle = "2s"'))
        with recorder.start(environment=environment) as child:
            for number, seconds in enumerate((0, -3600, 86400), start=1):
                step(seconds)
                goal = len(roc.truth.cleared) + 4
                child.while_it_runs(partial(told, child, number - 1), "the step")
                child.while_it_runs(partial(cleared, roc, goal), "clears")
            assert child.stop() == 0
        truth = roc.end()
    comparison = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
    assert comparison.clean
    assert comparison.found == list(range(1, comparison.found[-1] + 1))
    assert set(truth.cleared) <= set(comparison.found)
    steps = events(recorder.directory, "clock")
    assert len(steps) == 2, steps
    stepped = [float(step.split(" by ")[1].removesuffix(" s")) for step in steps]
    assert stepped == pytest.approx([-3600, 90000], abs=0.2)  # the file is read a little later
    for path in recorder.sealed():
        times = [item.log_time for item in stream(path)]
        assert times == sorted(times), path
    reads = [i.values.read_at_monotonic for i in items(recorder.directory, "/roc1/sample")]
    spacing = [(b - a) / 1e9 for a, b in pairwise(reads)]
    assert min(spacing) > 1
    assert max(spacing) < 3

"""Sealed and hot files in the hands of other MCAP libraries: the same values as in the CSV."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bench.judge import compare
from bench.needs import need
from bench.peer import Roc
from bench.recorder import Recorder
from bench.recording import csv_rows, files, nanoseconds, number

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bench.recording import Row

HERE = Path(__file__).parent
LETTERS = {"flag": "FLAG", "changed": "CHANGED"}


@pytest.fixture(scope="module")
def recorder(tmp_path_factory: pytest.TempPathFactory) -> Recorder:
    """Some sealed segments, and a hot one that a kill has left."""
    folder: Path = tmp_path_factory.mktemp("others")
    with Roc(folder, samples=10**6, race_every=4) as roc:
        recorder = Recorder(folder, roc.toml(device='poll = "50ms"\ncycle = "200ms"'), segment="2s")
        with recorder.start() as child:

            def enough() -> bool:
                return len(recorder.sealed()) >= 2 and bool(recorder.hot())

            child.while_it_runs(enough, "two sealed segments")
            goal = len(roc.truth.cleared) + 3
            child.while_it_runs(lambda: len(roc.truth.cleared) >= goal, "three more clears")
            child.send(signal.SIGKILL)
            child.wait()
        truth = roc.end()
    assert recorder.hot()
    comparison = compare(csv_rows(recorder.directory, folder / "csv"), truth)
    assert comparison.clean
    assert set(truth.acknowledged) <= set(comparison.found)
    return recorder


def rows_of(recorder: Recorder) -> list[Row]:
    return csv_rows(recorder.directory, recorder.folder / "csv")


def lines(command: list[str]) -> Iterator[dict[str, Any]]:
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    return (json.loads(line) for line in done.stdout.splitlines())


def same(found: list[dict[str, Any]], rows: list[Row]) -> None:
    samples = [line for line in found if line["topic"] == "/roc1/sample"]
    assert len(samples) == len(rows) > 10
    names = list(rows[0])
    points = names[names.index("count_1") : names.index("channel_4_alarm") + 1]
    for sample, row in zip(samples, rows, strict=True):
        value = sample["value"]
        assert int(sample["logTime"]) == nanoseconds(row["log_time"])
        assert int(value["seq"]) == int(row["seq"])
        assert value["origin"] == LETTERS[row["origin"]]
        for name in points:
            assert number(str(value[name])) == number(row[name]), (name, row)


def test_python_without_the_logger(recorder: Recorder) -> None:
    script = HERE / "python" / "read.py"
    paths = map(str, files(recorder.directory))
    same(list(lines([sys.executable, "-I", str(script), *paths])), rows_of(recorder))


def test_typescript_library(recorder: Recorder, tmp_path: Path) -> None:
    npm = shutil.which("npm")
    need("npm and node", npm is not None and shutil.which("node") is not None)
    for name in ("package.json", "read.mjs"):
        shutil.copy(HERE / "node" / name, tmp_path)
    install = [str(npm), "install", "--no-audit", "--no-fund", "--ignore-scripts"]
    done = subprocess.run(install, cwd=tmp_path, capture_output=True, timeout=100, check=False)
    need("access to the npm packages of tests/acceptance/node", done.returncode == 0)
    paths = map(str, files(recorder.directory))
    same(list(lines(["node", str(tmp_path / "read.mjs"), *paths])), rows_of(recorder))

"""Months in minutes: memory and open files of the recorder while samples and segments go by."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from bench.judge import Comparison, compare
from bench.peer import Roc
from bench.recorder import Recorder
from bench.recording import csv_rows

SAMPLES_A_DAY = 5760
"""At 15 s."""
_HOUR = SAMPLES_A_DAY // 24


@dataclass(frozen=True)
class Measure:
    seconds: float
    made: int
    segments: int
    resident: int
    """Octets."""
    files: int


@dataclass
class Report:
    measures: list[Measure] = field(default_factory=list)
    comparison: Comparison = field(default_factory=Comparison)
    code: int = -1

    def growth_a_day(self) -> float:
        """Octets in a simulated day, by least squares over all but the first hour."""
        points = [(m.made / SAMPLES_A_DAY, m.resident) for m in self.settled()]
        mean_x = sum(x for x, _ in points) / len(points)
        mean_y = sum(y for _, y in points) / len(points)
        spread = sum((x - mean_x) ** 2 for x, _ in points)
        return sum((x - mean_x) * (y - mean_y) for x, y in points) / spread

    def settled(self) -> list[Measure]:
        return [m for m in self.measures if m.made > _HOUR]

    def files_seen(self) -> list[int]:
        return sorted({m.files for m in self.settled()})


def run(folder: Path, samples: int, *, cycle: float, poll: str, segment: str) -> Report:
    report = Report()
    with Roc(folder, cycle=cycle, samples=10**7) as roc:
        device = f'poll = "{poll}"\ncycle = "{round(cycle * 1000)}ms"'
        recorder = Recorder(folder, roc.toml(device=device), segment=segment)
        begin = time.monotonic()
        truth = _Tail(folder / "roc1.truth.jsonl")
        with recorder.start() as child:
            recorder.wait_for_hot(child)
            while truth.made() < samples:
                assert child.code is None, child.talk()
                sealed = len(recorder.sealed())
                resident, files = _resident(child.pid), _open_files(child.pid)
                since = time.monotonic() - begin
                report.measures.append(Measure(since, truth.made(), sealed, resident, files))
                time.sleep(1)  # between measures; nothing waits for it
            report.code = child.stop()
        end = roc.end()
    report.comparison = compare(csv_rows(recorder.directory, folder / "csv"), end)
    return report


class _Tail:
    """Number of samples made, without reading the whole log again."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._made = 0

    def made(self) -> int:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            text = file.read()
        text = text[: text.rfind(b"\n") + 1]
        self._offset += len(text)
        self._made += text.count(b'"event": "made"')
        return self._made


def _resident(pid: int) -> int:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024
    raise AssertionError(f"process {pid} is gone")


def _open_files(pid: int) -> int:
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))

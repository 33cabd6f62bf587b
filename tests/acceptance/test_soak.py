"""A short soak: segments come and go, open files do not grow. The long one is campaigns/soak.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.soak import run

if TYPE_CHECKING:
    from pathlib import Path


def test_memory_and_open_files_stay(tmp_path: Path) -> None:
    report = run(tmp_path, 400, cycle=0.02, poll="5ms", segment="1s")
    assert report.code == 0
    assert report.comparison.clean
    last = report.measures[-1]
    assert last.segments >= 4
    files = [m.files for m in report.measures[1:]]
    assert max(files) - min(files) <= 3  # the sealer's, while it works
    assert last.resident - report.measures[len(report.measures) // 2].resident < 4_000_000

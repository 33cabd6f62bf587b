"""kill -9 at any instant, on two lines at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.killing import run

if TYPE_CHECKING:
    from pathlib import Path


def test_nothing_that_was_cleared_is_missing_after_kills(tmp_path: Path) -> None:
    report = run(tmp_path, kills=6, seed=3)
    print(report.summary())
    assert report.violations == []
    assert all(report.cleared.values()), report
    assert all(report.downtimes.values()), report

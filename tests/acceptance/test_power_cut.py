"""Power cuts on a real file system, and the control that shows that they are real."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from bench.needs import need
from bench.power import possible, run

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.root
def test_nothing_that_was_cleared_is_missing_after_power_cuts(tmp_path: Path) -> None:
    need("root, loop devices or mkfs.ext4", possible())
    report = run(tmp_path, cuts=2, seed=5)
    assert report.violations == []
    assert report.cleared >= 2


@pytest.mark.root
def test_without_fsync_the_same_cut_loses_samples(tmp_path: Path) -> None:
    need("root, loop devices or mkfs.ext4", possible())
    need("eatmydata", shutil.which("eatmydata") is not None)
    report = run(tmp_path, cuts=1, seed=5, under=["eatmydata"], segment="1h")
    assert report.lost > 0, report

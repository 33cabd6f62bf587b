"""A device is lost and comes back twice, in each way; the long version is campaigns/outages.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from bench.needs import need
from bench.outage_cases import CASES, namespaces_possible
from bench.outages import run

if TYPE_CHECKING:
    from pathlib import Path


def check(folder: Path, case: str) -> None:
    report = run(folder, case, 2)
    assert report.violations == []
    assert len(report.answered) == 2
    assert report.files[0] == report.files[1]
    # Who resets is back at once; every other outage lasts longer than a cycle.
    assert report.missing > 0 or case == "reset"


@pytest.mark.parametrize(
    "case",
    [name for name, case in CASES.items() if not case.needs_root],
)
def test_goes_on_after_outages(tmp_path: Path, case: str) -> None:
    check(tmp_path, case)


@pytest.mark.root
@pytest.mark.parametrize("case", [name for name, case in CASES.items() if case.needs_root])
def test_goes_on_after_outages_of_the_network(tmp_path: Path, case: str) -> None:
    need("root and network namespaces", namespaces_possible())
    check(tmp_path, case)

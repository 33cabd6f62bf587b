"""A serial line that loses, spoils and delays answers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from bench.steady import run

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("busy", ["queue", "deaf"])
def test_no_wrong_value_and_every_loss_is_told(tmp_path: Path, busy: str) -> None:
    outcome = run(
        tmp_path,
        line="pty",
        cycle=1.0,
        samples=40,
        poll="100ms",
        connection='timeout = "500ms"',
        late=0.1,
        late_by=0.8,
        corrupt=0.05,
        drop=0.05,
        garbage=0.05,
        busy=busy,
        seed=7,
    )
    assert outcome.comparison.wrong == []
    assert outcome.comparison.twice == []
    assert outcome.gaps.uncovered == []
    assert outcome.gaps.empty == []
    assert outcome.comparison.found[-1] >= 39
    assert outcome.code == 0

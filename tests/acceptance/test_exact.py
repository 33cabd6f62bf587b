"""Every sample of an independent device, to the last digit, in order, once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.steady import run

if TYPE_CHECKING:
    from pathlib import Path


def test_races_lose_nothing_and_every_clear_finds_its_sample_on_disk(tmp_path: Path) -> None:
    outcome = run(tmp_path, samples=60, race_every=5, check_disk=True)
    truth = outcome.truth
    assert outcome.comparison.wrong == []
    assert outcome.comparison.twice == []
    assert outcome.comparison.missing == []
    assert outcome.comparison.found[-1] >= 60
    assert [int(row["seq"]) for row in outcome.rows] == outcome.comparison.found
    assert outcome.gaps.clean, outcome.gaps
    assert truth.count("clear") > 40
    assert all(line["on_disk"] is True for line in truth.of("clear"))
    assert sum(line["raced"] for line in truth.of("clear")) > 5
    assert {row["origin"] for row in outcome.rows} == {"flag", "changed"}
    assert outcome.code == 0

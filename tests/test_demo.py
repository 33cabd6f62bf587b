"""What the demo compares: a lost, an invented and a changed value are each found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from roclog.demo import compare_reads

if TYPE_CHECKING:
    from pathlib import Path

TRUTH = """answer,block,name,value
1,relays,relay_1,1
2,channel_1,status,0
2,channel_1,ph,7.50
3,channel_1,status,2
3,channel_1,ph,
"""
RELAYS = "log_time,relay_1\nt,true\n"


@pytest.mark.parametrize(
    ("rows", "equal"),
    [
        ("t,0,7.5\nt,2,\n", 3),
        ("t,0,7.5\n", 2),
        ("t,2,\nt,0,7.5\n", 1),
        ("t,0,7.51\nt,2,\n", 2),
        ("t,0,7.5\nt,2,7.5\n", 2),
    ],
)
def test_answers_against_rows(tmp_path: Path, rows: str, equal: int) -> None:
    (tmp_path / "truth.csv").write_text(TRUTH)
    (tmp_path / "basin.relays.csv").write_text(RELAYS)
    (tmp_path / "basin.channel_1.csv").write_text("log_time,status,ph\n" + rows)
    assert compare_reads(tmp_path / "truth.csv", tmp_path, "basin") == (3, equal)


def test_a_block_without_a_file(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text(TRUTH)
    assert compare_reads(tmp_path / "truth.csv", tmp_path, "basin") == (3, 0)

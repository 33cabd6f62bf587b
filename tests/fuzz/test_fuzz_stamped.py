"""A fixed number of the cases of fuzz_stamped.py; the script itself runs for as long as wanted."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).with_name("fuzz_stamped.py")


def test_both_parsers_agree() -> None:
    one_case = runpy.run_path(str(SCRIPT))["one_case"]
    for number in range(5_000):
        one_case(number)


def test_the_script_runs_by_itself() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "0.2", "100000"], capture_output=True, text=True, check=True
    )
    assert "cases from 100000, both parsers agree" in done.stdout

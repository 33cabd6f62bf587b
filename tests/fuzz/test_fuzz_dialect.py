"""A fixed number of the cases of fuzz_dialect.py; the script itself runs for as long as wanted."""

from __future__ import annotations

import runpy
from pathlib import Path


def test_cases_end_as_documented() -> None:
    one_case = runpy.run_path(str(Path(__file__).with_name("fuzz_dialect.py")))["one_case"]
    for number in range(5_000):
        one_case(number)

"""The link whose other end is a function, the loop without waiting, and independent frames."""

import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS / "polling" / "lib"), str(TESTS / "bus" / "lib"), str(TESTS / "peers")]

"""Helpers of these tests, and ``wire`` with its own frames and its checksum bit by bit."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent / "lib"), str(Path(__file__).parents[1] / "peers")]

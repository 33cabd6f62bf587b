"""The bus's fakes, and frames that nothing of roclog has made."""

import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS / "bus/lib"), str(TESTS / "peers")]

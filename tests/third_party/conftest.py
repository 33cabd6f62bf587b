"""These tests use the bench of the acceptance tests and the registers of the independent device."""

import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS / "acceptance/lib"))
sys.path.insert(0, str(TESTS / "peers"))

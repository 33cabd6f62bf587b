"""``wire`` forms frames with a checksum of its own, bit by bit."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "peers"))

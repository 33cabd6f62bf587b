"""``stamp_oracle``: a second decoder, written from the paper and the zones' clocks."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "lib"))

"""The bench is a package of its own, so that the long campaigns can use it as well."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "lib"))

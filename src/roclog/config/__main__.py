"""``python -m roclog.config``: the JSON Schema of the configuration, for editors."""

from __future__ import annotations

import json
import sys

from roclog.config.tables import json_schema

sys.stdout.write(json.dumps(json_schema(), indent=2) + "\n")

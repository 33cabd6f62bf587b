"""The truth log: one JSON object per line, flushed per line."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path
from typing import TextIO


class Truth:
    """Without a path the lines are only kept in `lines`, else only in the file."""

    def __init__(self, path: str | None) -> None:
        self.lines: list[dict[str, object]] = []
        self.counts: Counter[str] = Counter()
        self._file: TextIO | None = None
        self._closed = False
        if path:
            self._file = Path(path).open("w", encoding="utf-8")  # noqa: SIM115 - see `close`

    def log(self, event: str, **facts: object) -> None:
        """Wall time is UTC, both times are nanoseconds; after `close` nothing is true."""
        if self._closed:
            return
        self.counts[event] += 1
        times = {"wall_ns": time.time_ns(), "mono_ns": time.monotonic_ns()}
        line = {"event": event, **times, **facts}
        if self._file is None:
            self.lines.append(line)
        else:
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()

    def close(self) -> None:
        self._closed = True
        if self._file is not None:
            self._file.close()

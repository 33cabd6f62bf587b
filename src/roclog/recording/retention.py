"""Deleting the oldest sealed segments, only under an explicit ``keep`` setting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from roclog.clock import Clock


@dataclass(frozen=True, slots=True)
class Retention:
    """age: nanoseconds since a segment was sealed. size: octets of all sealed segments."""

    clock: Clock
    age: int | None
    size: int | None

    def apply(self, root: Path) -> Iterator[Path]:
        """Delete what the limits no longer allow, oldest first; yields each deleted path."""
        paths = sorted(root.glob("[0-9]*/[0-9]*/[0-9]*/*.mcap"), key=lambda path: path.name)
        facts = [(path, path.stat()) for path in paths]
        total = sum(stat.st_size for _, stat in facts)
        now = self.clock.now().utc
        for path, stat in facts[:-1]:
            too_old = self.age is not None and now - stat.st_mtime_ns > self.age
            too_big = self.size is not None and total > self.size
            if not (too_old or too_big):
                return
            path.unlink()
            total -= stat.st_size
            yield path

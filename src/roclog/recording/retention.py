"""Deleting the oldest sealed segments, only under an explicit ``keep`` setting."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from roclog.clock import Clock

_SEALED: Final = re.compile(r"\d{8}T\d{6}Z-(\d{8,})\.mcap")
"""Names that sealing gives; the number at the end only grows, whatever the clock said."""


@dataclass(frozen=True, slots=True)
class Retention:
    """age: nanoseconds since a segment was sealed. size: octets of all sealed segments."""

    clock: Clock
    age: int | None
    size: int | None

    def apply(self, root: Path) -> Iterator[Path]:
        """Delete what the limits no longer allow, oldest first, never the newest.

        Files that roclog did not seal are left alone and not counted. Raises OSError.
        """
        found = [
            (int(match[1]), path)
            for path in root.glob("[0-9]*/[0-9]*/[0-9]*/*.mcap")
            if (match := _SEALED.fullmatch(path.name)) is not None
        ]
        facts = [(path, path.stat()) for _, path in sorted(found)]
        total = sum(stat.st_size for _, stat in facts)
        now = self.clock.now().utc
        for path, stat in facts[:-1]:
            too_old = self.age is not None and now - stat.st_mtime_ns > self.age
            too_big = self.size is not None and total > self.size
            if not (too_old or too_big):
                return
            path.unlink(missing_ok=True)
            total -= stat.st_size
            yield path

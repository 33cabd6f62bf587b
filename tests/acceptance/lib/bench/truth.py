"""What a ROC says really happened."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Line = dict[str, Any]


class Truth:
    """The truth log of one device, as far as it is written."""

    def __init__(self, path: Path) -> None:
        text = path.read_text() if path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        self.lines: list[Line] = [json.loads(line) for line in whole.splitlines()]

    def of(self, event: str) -> Iterator[Line]:
        return (line for line in self.lines if line["event"] == event)

    def count(self, event: str) -> int:
        return sum(1 for _ in self.of(event))

    @property
    def made(self) -> dict[int, Line]:
        return {line["k"]: line for line in self.of("made")}

    @property
    def variants(self) -> dict[int, list[list[int]]]:
        """Registers of each sample while it stood there: alarms and temperature may be live."""
        found = {k: [line["registers"]] for k, line in self.made.items()}
        for line in self.of("live"):
            found.setdefault(line["k"], []).append(line["registers"])
        return found

    @property
    def cleared(self) -> list[int]:
        """Samples whose flag fell because the logger asked for it."""
        return [line["k"] for line in self.of("clear") if line["k"]]

    @property
    def delivered(self) -> set[int]:
        """Samples that a client was sent in one piece, intact and in time."""
        return {line["k"] for line in self.of("read") if line["k"] and line["fate"] == "ok"}

    @property
    def acknowledged(self) -> list[int]:
        """Samples that stood there when a clear arrived; another may have come just before it."""
        return [line["arrived_k"] for line in self.of("clear") if line["arrived_k"]]

    @property
    def ended(self) -> bool:
        return bool(self.lines) and self.lines[-1]["event"] == "summary"

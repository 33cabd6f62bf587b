"""What a simulated device has told, answer by answer, for whoever compares."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterable

COLUMNS: Final = ("answer", "block", "name", "value")


class Truth:
    """CSV with one row for each value that an answer tells; answers are numbered from 1.

    file: gets a header now and is flushed after each answer; None keeps nothing.
    """

    def __init__(self, file: TextIO | None) -> None:
        self._file = file
        self._answers = 0
        if file is not None:
            file.write(",".join(COLUMNS) + "\n")
            file.flush()

    def tell(self, values: Iterable[tuple[str, str, str]]) -> None:
        """(block, name, value) of one answer; a value without a measurement is empty."""
        self._answers += 1
        if self._file is not None:
            lines = (f"{self._answers},{','.join(cells)}\n" for cells in values)
            self._file.write("".join(lines))
            self._file.flush()

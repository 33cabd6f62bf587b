"""What goes wrong with single requests of a device while others are answered."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.outbox import Outbox


class Fault(Enum):
    """Kind of the event, what is said of it, and what when it is over."""

    REFUSED = "refused", "refused, asked for all the same", "answered again"
    LAYOUT = "layout", "answers in another shape than its layout", "answered in its layout"
    SILENT = "silent", "is not answered for, though the device answers", "answered again"


_IN_A_ROW: Final = 2


class Complaints:
    """Tells of each request once, and once more when the fault is over.

    A single fault is counted in the link's minute only, the second in a row may be for ever. The
    first refusal of a request is told at once, since it often is; later ones are like the others,
    so that a request that fails now and then does not fill the log.

    names: of the requests, by their numbers.
    """

    def __init__(self, outbox: Outbox, names: Sequence[str]) -> None:
        self._outbox = outbox
        self._names = names
        self._in_a_row: Counter[tuple[int, Fault]] = Counter()
        self._told: set[tuple[int, Fault]] = set()
        self._refused_before: set[int] = set()

    def is_due(self, number: int, fault: Fault) -> bool:
        """Count a fault of a request; whether it is to be told now."""
        self._in_a_row[number, fault] += 1
        is_first = fault is Fault.REFUSED and number not in self._refused_before
        if fault is Fault.REFUSED:
            self._refused_before.add(number)
        is_enough = is_first or self._in_a_row[number, fault] >= _IN_A_ROW
        return is_enough and (number, fault) not in self._told

    def tell(self, number: int, fault: Fault, why: str) -> None:
        self._told.add((number, fault))
        kind, what, _ = fault.value
        self._outbox.event("warning", kind, f"{self._names[number]} {what}: {why}")

    def end(self, number: int) -> None:
        """The request was answered as it should be."""
        for fault in Fault:
            self._in_a_row.pop((number, fault), None)
            if (number, fault) in self._told:
                self._told.discard((number, fault))
                kind, _, over = fault.value
                self._outbox.event("info", kind, f"{self._names[number]} {over}")

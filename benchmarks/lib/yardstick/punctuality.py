"""How far polls were from their schedule, as the devices saw it and as the recording says it."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from yardstick.report import median, quantile

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

IN_TIME: Final = 50_000_000
"""Nanoseconds."""


@dataclass
class Punctuality:
    """late: nanoseconds of every poll but the first of a device. missing: polls that never came."""

    late: list[int] = field(default_factory=list)
    missing: int = 0

    @property
    def share_in_time(self) -> float:
        """Of all polls that should have been; one that never came is not in time."""
        in_time = sum(0 <= late <= IN_TIME for late in self.late)
        return in_time / (len(self.late) + self.missing)

    def late_ms(self, share: float) -> float:
        return quantile(self.late, share) / 1e6


def read_arrivals(file: Path) -> dict[str, list[int]]:
    """Nanoseconds by device, from the devices' own clock."""
    lines = (line.split() for line in file.read_text().splitlines())
    return {device: [int(instant) for instant in instants] for device, *instants in lines}


def seen_by_devices(arrivals: Iterable[Sequence[int]], period: int) -> Punctuality:
    """Requests against a grid of exactly one period through the earliest of each device.

    A device does not know when its logger meant to ask; but no request comes before it is due, so
    the earliest one, seen against the grid, is the best a device can know. The grid has the exact
    period: a schedule that drifts shows as lateness that grows.
    """
    found = Punctuality()
    for instants in arrivals:
        later = instants[1:]  # the first may have waited for its connection
        if len(later) < 2:
            found.missing += 1
            continue
        numbers = [round((instant - later[0]) / period) for instant in later]
        offsets = [i - n * period for i, n in zip(later, numbers, strict=True)]
        phase = min(offsets)
        found.late += [offset - phase for offset in offsets]
        found.missing += numbers[-1] + 1 - len(numbers)
    return found


def drift_ppm(arrivals: Iterable[Sequence[int]], period: int) -> float:
    """How fast schedules run away from the exact period: median over the devices, in millionths.

    The middle of a device's requests on the grid in the last half, against that in the first half.
    """
    drifts = []
    for instants in arrivals:
        half = len(instants) // 2
        if half < 3:
            continue
        start = instants[1]
        offsets = [i - start - round((i - start) / period) * period for i in instants[1:]]
        moved = median(offsets[half:]) - median(offsets[:half])
        drifts.append(moved / (half * period) * 1e6)
    return median(drifts) if drifts else 0.0


def said_by_recording(
    turns: Sequence[tuple[int, int]], asked: Sequence[int], period: int
) -> Punctuality:
    """Recorded ``asked_at`` against the instant the logger's own schedule had for that poll.

    turns: (due, begun) of every poll of a device. asked: monotonic nanoseconds, from its samples.
    """
    found = Punctuality()
    begun = [instant for _, instant in turns]
    dues = [due for due, _ in turns]
    answered = {bisect_right(begun, instant) - 1: instant for instant in asked}
    found.late = [instant - dues[number] for number, instant in answered.items() if number > 0]
    due_polls = (dues[-1] - dues[1]) // period + 1 if len(dues) > 1 else 0
    found.missing = max(0, due_polls - len(found.late))
    return found

"""Rows against truth: what is wrong, what is missing, what a gap record says of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

from bench.document import decode, identity
from bench.recording import number

if TYPE_CHECKING:
    from collections.abc import Iterable
    from decimal import Decimal

    from bench.document import Values
    from bench.recording import Gap, Row
    from bench.truth import Truth

_TOLERANCE = 0.01
"""Part of a cycle by which the recorder lets a device be early or late."""
_NEAR = 10
"""Cycles for which a slip of the device may confuse the count."""
_MARGIN = 20_000_000
"""Nanoseconds by which two processes may disagree on when something happened."""


@dataclass
class Comparison:
    """Numbers are those of the device's samples."""

    found: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
    twice: list[int] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    @property
    def clean(self) -> bool:
        return not self.twice and not self.wrong


def compare(rows: Iterable[Row], truth: Truth) -> Comparison:
    """Every row must be a sample, whole and exact, in order, none twice."""
    result = Comparison()
    variants = {k: [decode(r) for r in options] for k, options in truth.variants.items()}
    numbers: dict[tuple[Decimal, ...], list[int]] = {}
    for k in truth.made:
        numbers.setdefault(identity(variants[k][0]), []).append(k)
    columns = next(iter(variants.values()))[0] if variants else {}
    last = 0
    for row in rows:
        values = {name: number(row[name]) for name in columns}
        candidates = numbers.get(identity(values), [])
        later = [k for k in candidates if k > last]
        if not later:
            if candidates:
                result.twice.append(candidates[-1])
            else:
                result.wrong.append(f"no such sample: {row}")
            continue
        k = last = later[0]
        result.found.append(k)
        if not any(_equal(values, option) for option in variants[k]):
            result.wrong.append(f"sample {k}: {row}")
    kept = set(result.found)
    result.missing = [k for k in truth.made if k not in kept]
    return result


def _equal(values: Values, expected: Values) -> bool:
    return all(values[name] == expected[name] for name in expected)


@dataclass
class GapCheck:
    """uncovered: missing samples that no gap record speaks of. empty: gap records without one.

    idle: records of gaps that were only possible, and were none. excused: findings near a sample
    for which the device itself, on a busy host, was more than the promised tolerance late.
    """

    uncovered: list[int] = field(default_factory=list)
    empty: list[Gap] = field(default_factory=list)
    expected: int = 0
    """Sum over the gap records that are certain and not downtime."""
    idle: int = 0
    downtimes: int = 0
    excused: int = 0

    @property
    def clean(self) -> bool:
        return not self.uncovered and not self.empty


def check_gaps(missing: Iterable[int], truth: Truth, gaps: Iterable[Gap]) -> GapCheck:
    result = GapCheck()
    lost = {k: int(truth.made[k]["wall_ns"]) for k in missing}
    told = list(gaps)
    for k, at in lost.items():
        if not any(_contains(gap, at) for gap in told):
            result.uncovered.append(k)
    for gap in told:
        if gap.reason == "downtime":
            result.downtimes += 1
            continue
        result.expected += 0 if gap.possible else gap.expected
        if not any(_contains(gap, at) for at in lost.values()):
            result.idle += gap.possible
            if not gap.possible:
                result.empty.append(gap)
    return result


def excuse(check: GapCheck, truth: Truth, cycle: float) -> None:
    """Take away what a device with an irregular cycle has brought about; it is counted."""
    made = sorted((int(line["mono_ns"]), int(line["wall_ns"])) for line in truth.of("made"))
    slips = [
        wall
        for (before, _), (after, wall) in pairwise(made)
        if abs((after - before) / 1e9 / cycle - 1) > _TOLERANCE
    ]

    def near(at: int) -> bool:
        return any(abs(at - slip) < _NEAR * cycle * 1e9 for slip in slips)

    walls = {k: int(line["wall_ns"]) for k, line in truth.made.items()}
    uncovered = [k for k in check.uncovered if not near(walls[k])]
    empty = [gap for gap in check.empty if not near(gap.since)]
    check.excused = len(check.uncovered) + len(check.empty) - len(uncovered) - len(empty)
    check.uncovered, check.empty = uncovered, empty


def _contains(gap: Gap, at: int) -> bool:
    return gap.since - _MARGIN <= at <= gap.to + _MARGIN

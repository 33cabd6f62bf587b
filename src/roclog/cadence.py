"""When does the device complete its samples? The timing guard and the count of missed ones.

All times are monotonic nanoseconds. A sample that a read shows has completed after the request of
the latest read that did not show it, and before the end of the answer that does. Where the cycle is
known, these windows narrow from sample to sample, and the number of samples between two kept ones
follows. Where two counts are possible, both are carried until later reads rule one out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from statistics import median
from typing import Final

TOLERANCE: Final = 0.01
"""Part of a cycle by which a device may be early or late in one cycle."""
_COUNTABLE: Final = 20
"""Cycles; across a longer blind spell the count of missed samples is an estimate."""
_PATIENCE: Final = 4
"""Samples read in time after a blind spell; what they did not decide stays possible."""


@dataclass(frozen=True, slots=True)
class _Guess:
    """The last kept sample completed between ``low`` and ``high``, ``missed`` others before it."""

    low: float
    high: float
    missed: int


@dataclass(frozen=True, slots=True)
class Missed:
    """Samples that completed between two instants and were never read.

    possible: no later read could decide; there may be fewer, or none.
    """

    after: int
    before: int
    count: int
    possible: bool = False


class Cadence:
    """Follows the completions of one block.

    cycle: nanoseconds between samples as configured or as the device says; None = unknown, then
    nothing is guarded and nothing counted.
    """

    def __init__(self, cycle: int | None) -> None:
        self.cycle = cycle
        self._guesses: list[_Guess] = []
        self._spacings: deque[tuple[int, int]] = deque(maxlen=8)
        self._shortest: deque[int] = deque(maxlen=32)
        self._previous: tuple[int, int] | None = None
        self._blind_from: int | None = None
        self._spell: tuple[int, int] | None = None
        self._reported = 0
        self._calm = 0

    def quiet(self, asked_at: int) -> Missed | None:
        """A read that showed no news was asked for at ``asked_at``. Returns as ``completed``."""
        self._blind_from = asked_at
        cycle = self.effective_cycle
        if not self._guesses or cycle is None:
            return None
        floor = asked_at - cycle * (1 + TOLERANCE)
        alive = [
            _Guess(max(guess.low, floor), guess.high, guess.missed)
            for guess in self._guesses
            if guess.high >= floor
        ]
        if not alive:  # later than any regular device
            missed = self.close()
            self._guesses = []
            return missed
        self._guesses = alive
        return self._settle(min(guess.missed for guess in alive))

    def completed(self, asked_at: int, read_at: int) -> Missed | None:
        """A read showed a new sample. Returns what is now known to have been missed."""
        since = self._blind_from
        self._blind_from = asked_at
        cycle = self.effective_cycle
        if cycle is None:
            return None
        if since is None:  # it may have waited for long; what was before is not ours
            low = asked_at - cycle * (1 + TOLERANCE)
            self._note_spacing((int(low), read_at))
            self._guesses = [_Guess(low, read_at, 0)]
            return None
        self._note_spacing((since, read_at))
        self._calm += 1
        if read_at - since >= cycle * (1 - TOLERANCE):
            self._calm = 0
            self._spell = (self._spell[0] if self._spell else since, read_at)
        guesses = self._step(self._guesses, since, asked_at, read_at, cycle)
        if not guesses:  # no phase yet, or none that fits
            self._reported -= max((guess.missed for guess in self._guesses), default=0)
            guesses = self._fresh(since, asked_at, read_at, cycle)
        self._guesses = guesses
        missed = self._settle(min(guess.missed for guess in guesses))
        return self.close() if missed is None and self._calm >= _PATIENCE else missed

    def close(self) -> Missed | None:
        """What may have been missed and could not be ruled out."""
        if not self._guesses:
            return None
        certain = len(self._guesses) == 1
        most = max(guess.missed for guess in self._guesses)
        low, high = min(g.low for g in self._guesses), max(g.high for g in self._guesses)
        self._guesses = [_Guess(low, high, most)]
        missed = self._settle(most)
        return missed if missed is None or certain else replace(missed, possible=True)

    def forget(self) -> Missed | None:
        """The device restarted: its phase is unknown. Returns as ``close`` does."""
        missed = self.close()
        self._guesses = []
        self._previous = None
        self._blind_from = None
        return missed

    @property
    def last_completed(self) -> int | None:
        """By this instant the last kept sample had completed."""
        return None if self._previous is None else self._previous[1]

    @property
    def effective_cycle(self) -> int | None:
        """The configured cycle, or the observed one where most spacings contradict the former."""
        if self.cycle is None:
            return None
        slack = self.cycle * TOLERANCE
        against = [
            (low + high) // 2
            for low, high in self._spacings
            if not low - slack <= self.cycle <= high + slack
        ]
        if len(against) >= 4 and 2 * len(against) > len(self._spacings):
            return max(1, int(median(against)))
        return self.cycle

    def guarded_until(self) -> int | None:
        """Before this instant no sample after the last kept one can have completed."""
        if self.cycle is None or self._previous is None:
            return None
        shortest = min(self.cycle, self.effective_cycle or self.cycle, *self._shortest)
        return int(self._previous[0] + shortest * 0.95)

    def overdue(self, asked_at: int) -> bool:
        """Whether a sample should have shown by ``asked_at``, by more than half a cycle."""
        cycle = self.effective_cycle
        if cycle is None or self._previous is None:
            return False
        return asked_at > self._previous[1] + 1.5 * cycle

    def _note_spacing(self, window: tuple[int, int]) -> None:
        if self._previous is not None and self.cycle is not None:
            low, high = window[0] - self._previous[1], window[1] - self._previous[0]
            if window[1] - window[0] < self.cycle:
                self._spacings.append((max(0, low), high))
            if high < self.cycle * (1 - TOLERANCE):
                self._shortest.append(max(0, low))
        self._previous = window

    def _step(
        self, guesses: list[_Guess], since: int, asked_at: int, read_at: int, cycle: int
    ) -> list[_Guess]:
        """The guesses after a read that showed a sample: those that fit it."""
        early, late = cycle * (1 - TOLERANCE), cycle * (1 + TOLERANCE)
        if read_at - since > cycle * _COUNTABLE:
            return []
        found: dict[int, _Guess] = {}
        for guess in guesses:
            for n in range(1, int((read_at - since) / early) + 2):
                low = max(guess.low + n * early, since, asked_at - late)
                high = min(guess.high + n * late, read_at)
                if low <= high:
                    missed = guess.missed + n - 1
                    other = found.get(missed, _Guess(low, high, missed))
                    found[missed] = _Guess(min(low, other.low), max(high, other.high), missed)
        return list(found.values())

    def _fresh(self, since: int, asked_at: int, read_at: int, cycle: int) -> list[_Guess]:
        """As ``_step``, where only this is known: one completed in the cycle before ``since``."""
        late = cycle * (1 + TOLERANCE)
        if read_at - since > cycle * _COUNTABLE:
            return [_Guess(asked_at - late, read_at, int((asked_at - since) / cycle) - 1)]
        return self._step([_Guess(since - late, since, 0)], since, asked_at, read_at, cycle)

    def _settle(self, certain: int) -> Missed | None:
        count, self._reported = certain - self._reported, certain
        spell = self._spell
        if len(self._guesses) == 1:
            self._guesses = [_Guess(self._guesses[0].low, self._guesses[0].high, 0)]
            self._reported = 0
            self._spell = None
        return Missed(spell[0], spell[1], count) if count > 0 and spell is not None else None

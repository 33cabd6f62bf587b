"""How far is a device's clock from the host's? Pure; nothing here is ever applied to data.

Each trusted stamp says: this was the device's time somewhere between two instants of the host. That
bounds the difference between device time and the host's monotonic time, and bounds intersect. A
clock wanders, so bounds widen with time by what a clock may wander; a stamp outside of them means
that the clock was set, and is believed when others agree with it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from roclog.clock import Instant

MAX_DRIFT_PPM: Final = 200
"""A clock that gains or loses more (17 s a day) runs away; quartz clocks keep within 100."""
STILL_AFTER: Final = 10 * 10**9
"""A clock that advances less than a tenth of at least this time stands still."""
CONFIRMATIONS: Final = 3
"""Stamps that must agree before a clock counts as set; fewer are taken for strays."""
_SPACING: Final = 60 * 10**9
_SPANS: Final = (1, 2, 5, 10, 30)
"""The rate is judged over two spans in a row of this many spacings: 1 min to half an hour."""
_CALM: Final = 3600 * 10**9
"""A clock that ran away is steady when for this long nothing has shown it."""
_DRIFT_SPACING: Final = 600 * 10**9
_DRIFT_POINTS: Final = 145
"""Drift is measured against the bounds of up to a day ago."""
_TOLD_PPM: Final = 20
"""Drift is given when it is known to this, plus or minus."""


class ClockEvent(StrEnum):
    """What happened to a device's clock."""

    STANDS_STILL = "stands-still"
    RUNS_AWAY = "runs-away"
    STEPPED = "stepped"
    STEADY = "steady"
    """It stood still or ran away, and no longer does."""


@dataclass(frozen=True, slots=True)
class ClockFact:
    """Something that a person should know about a device's clock.

    amount: STEPPED: nanoseconds by which it was set forward; RUNS_AWAY: ppm that it gains, at the
    least (STANDS_STILL, STEADY: 0).
    """

    event: ClockEvent
    amount: int
    text: str


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Device less host, in nanoseconds, and how well that is known.

    uncertainty: the true offset is within plus or minus this.
    drift: ppm that the device gains on the host's monotonic clock, within drift_uncertainty; None
    where it is not known to 20 ppm.
    """

    offset: int
    uncertainty: int
    drift: float | None = None
    drift_uncertainty: float | None = None


def _wander(span: int) -> int:
    """Nanoseconds that a clock may gain or lose in that time."""
    return span * MAX_DRIFT_PPM // 10**6 + 1


@dataclass(frozen=True, slots=True)
class _Stamped:
    """The device's time was ``device`` between two instants of the monotonic clock."""

    device: int
    earliest: int
    latest: int

    def rate(self, later: _Stamped) -> tuple[float, float] | None:
        """Least and greatest rate of the device's clock in between, 1 = right; None = unknown."""
        least, greatest = later.earliest - self.latest, later.latest - self.earliest
        if least <= 0:
            return None
        advance = later.device - self.device
        low, high = advance / greatest, advance / least
        return (low, high) if advance >= 0 else (high, low)


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Device time less monotonic time is from ``low`` to ``high`` at monotonic time ``at``."""

    at: int
    low: int
    high: int

    def moved(self, at: int) -> _Bounds:
        slack = _wander(abs(at - self.at))
        return _Bounds(at, self.low - slack, self.high + slack)

    def joined(self, other: _Bounds) -> _Bounds | None:
        """Both together, at the time of the other; None where they exclude each other."""
        moved = self.moved(other.at)
        low, high = max(moved.low, other.low), min(moved.high, other.high)
        return _Bounds(other.at, low, high) if low <= high else None


class DeviceClock:
    """The clock of one device.

    Give it every trusted stamp: of an explicit clock read with the instants of request and answer,
    of a change with the instants of the read before it and of the read that showed it.
    """

    def __init__(self) -> None:
        self._trouble: ClockEvent | None = None
        self._away_until = 0
        self._plateau: _Stamped | None = None
        self._recent: deque[_Stamped] = deque(maxlen=2 * max(_SPANS) + 1)
        self._bounds: _Bounds | None = None
        self._rival: _Bounds | None = None
        self._agreeing = 0
        self._past: deque[_Bounds] = deque(maxlen=_DRIFT_POINTS)

    def note(self, device_time: int, earliest: Instant, latest: Instant) -> list[ClockFact]:
        """A stamp, ns UTC, taken by the device between two instants. Returns what became known.

        Raises:
            ValueError: no device time, or ``latest`` is before ``earliest``.
        """
        if device_time <= 0:
            raise ValueError("a stamp without device time says nothing about a clock")
        if latest.monotonic < earliest.monotonic:
            raise ValueError("the latest instant of a stamp is before its earliest")
        stamped = _Stamped(device_time, earliest.monotonic, latest.monotonic)
        trouble, gain = self._judge_rate(stamped)
        facts = self._trouble_facts(trouble, gain)
        slack = _wander(stamped.latest - stamped.earliest)
        low, high = device_time - stamped.latest - slack, device_time - stamped.earliest + slack
        found = _Bounds(stamped.latest, low, high)
        if self._trouble is not None:
            self._restart(found)
        else:
            facts += self._narrow(found)
        return facts

    def offset(self, now: Instant) -> ClockOffset | None:
        """The offset at an instant; None before the first stamp."""
        if self._bounds is None:
            return None
        bounds = self._bounds.moved(now.monotonic)
        centre = (bounds.low + bounds.high) // 2
        offset = centre - (now.utc - now.monotonic)
        return ClockOffset(offset, (bounds.high - bounds.low + 1) // 2, *self._drift())

    def _narrow(self, found: _Bounds) -> list[ClockFact]:
        if self._bounds is None:
            self._restart(found)
            return []
        joined = self._bounds.joined(found)
        if joined is not None:
            self._bounds = joined
            self._rival = None if self._rival is None else self._rival.joined(found)
            if joined.at - self._past[-1].at >= _DRIFT_SPACING:
                self._past.append(joined)
            return []
        rival = None if self._rival is None else self._rival.joined(found)
        self._rival, self._agreeing = (found, 1) if rival is None else (rival, self._agreeing + 1)
        if self._agreeing < CONFIRMATIONS:
            return []
        before, after = self._bounds.moved(self._rival.at), self._rival
        step = (after.low + after.high - before.low - before.high) // 2
        self._restart(after)
        direction = "forward" if step > 0 else "back"
        text = f"the device's clock was set {direction} by {abs(step) / 10**9:.3f} s"
        return [ClockFact(ClockEvent.STEPPED, step, text)]

    def _restart(self, bounds: _Bounds) -> None:
        self._bounds, self._rival, self._agreeing = bounds, None, 0
        self._past.clear()
        self._past.append(bounds)

    def _drift(self) -> tuple[float, float] | tuple[None, None]:
        if self._bounds is None:
            return None, None
        best: tuple[float, float] | tuple[None, None] = None, None
        for past in self._past:
            span = self._bounds.at - past.at
            if span < _DRIFT_SPACING:
                break
            low, high = self._bounds.low - past.high, self._bounds.high - past.low
            uncertainty = (high - low) / span / 2 * 10**6
            if uncertainty <= _TOLD_PPM and (best[1] is None or uncertainty < best[1]):
                best = (low + high) / span / 2 * 10**6, uncertainty
        return best

    def _judge_rate(self, stamped: _Stamped) -> tuple[ClockEvent | None, int]:
        """What is wrong with the clock's rate, and at least how much it gains, in ppm."""
        if self._stands_still(stamped):
            return ClockEvent.STANDS_STILL, 0
        recent = self._recent
        if not recent or stamped.latest - recent[-1].latest >= _SPACING:
            recent.append(stamped)
        for span in _SPANS:
            if len(recent) <= 2 * span:
                break
            first, middle, last = recent[-1 - 2 * span], recent[-1 - span], recent[-1]
            before, after = first.rate(middle), middle.rate(last)
            if before is None or after is None:
                continue
            slowest, fastest = min(before[0], after[0]) - 1, max(before[1], after[1]) - 1
            if max(before[0], after[0]) > min(before[1], after[1]):
                continue  # it was set in between
            if max(slowest, -fastest) * 10**6 > MAX_DRIFT_PPM:
                self._away_until = stamped.latest + _CALM
                return ClockEvent.RUNS_AWAY, int((slowest if slowest > 0 else fastest) * 10**6)
        if self._trouble is ClockEvent.RUNS_AWAY and stamped.latest < self._away_until:
            return ClockEvent.RUNS_AWAY, 0
        return None, 0

    def _stands_still(self, stamped: _Stamped) -> bool:
        plateau = self._plateau
        if plateau is not None:
            advance = stamped.device - plateau.device
            if 0 <= advance <= (stamped.latest - plateau.earliest) // 10:
                return advance <= (stamped.earliest - plateau.latest) // 10 and (
                    stamped.earliest - plateau.latest >= STILL_AFTER
                )
        self._plateau = stamped
        return False

    def _trouble_facts(self, trouble: ClockEvent | None, gain: int) -> list[ClockFact]:
        if trouble is self._trouble:
            return []
        before, self._trouble = self._trouble, trouble
        if trouble is None:
            assert before is not None
            text = "the device's clock runs as it should again"
            return [ClockFact(ClockEvent.STEADY, 0, text)]
        text = "the device's clock stands still"
        if trouble is ClockEvent.RUNS_AWAY:
            verb = "gains" if gain > 0 else "loses"
            text = f"the device's clock runs away: it {verb} {abs(gain)} ppm or more"
        return [ClockFact(trouble, gain, text)]

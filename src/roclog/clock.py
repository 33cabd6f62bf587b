"""The two clocks every sample carries, behind one small interface so that tests pass their own."""

from __future__ import annotations

import time
from typing import NamedTuple, Protocol


class Instant(NamedTuple):
    """One moment on both clocks, integer nanoseconds."""

    utc: int
    monotonic: int


class Clock(Protocol):
    """Wall time may step; monotonic time never does. Schedules use monotonic time only."""

    def now(self) -> Instant:
        """Both clocks, read one right after the other."""
        ...

    def pause(self, nanoseconds: int) -> None:
        """Hold this thread, event loop and all; for less than the loop's timers can tell apart."""
        ...


class SystemClock:
    """CLOCK_REALTIME and CLOCK_MONOTONIC of this host."""

    def now(self) -> Instant:
        return Instant(time.time_ns(), time.monotonic_ns())

    def pause(self, nanoseconds: int) -> None:
        time.sleep(nanoseconds / 1e9)

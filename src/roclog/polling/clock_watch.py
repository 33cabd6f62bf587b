"""The clock of one device beside the host's: followed, told when it misbehaves, never applied."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roclog.device_clock import ClockEvent, DeviceClock
from roclog.recording.entries import Entry
from roclog.schema import CLOCK_OFFSET

if TYPE_CHECKING:
    from roclog.clock import Instant
    from roclog.outbox import Outbox


class ClockWatch:
    """Shared by everything that reads stamps of one device."""

    def __init__(self, device: str, outbox: Outbox) -> None:
        self._topic = f"/{device}/clock_offset"
        self._outbox = outbox
        self._clock = DeviceClock()

    def note(self, device_time: int, earliest: Instant, latest: Instant) -> None:
        """A stamp, ns UTC, that the device took between two instants."""
        for fact in self._clock.note(device_time, earliest, latest):
            level = "info" if fact.event is ClockEvent.STEADY else "warning"
            self._outbox.event(level, "clock", fact.text)

    def restart(self) -> None:
        """Another device, another clock."""
        self._clock = DeviceClock()

    def report(self, now: Instant) -> None:
        """Record the offset, where it is known."""
        known = self._clock.offset(now)
        if known is None:
            return
        nan = float("nan")
        drift = nan if known.drift is None else known.drift
        within = nan if known.drift_uncertainty is None else known.drift_uncertainty
        values = (known.offset / 1e9, known.uncertainty / 1e9, drift, within)
        data = CLOCK_OFFSET.pack(iter(values))
        self._outbox.note(Entry(self._topic, now.utc, now.utc, 0, data))

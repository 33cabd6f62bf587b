"""One device on its schedule: facts first, then each of its pollers at every period, for ever."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from roclog.errors import DeviceError, ExceptionAnswer, LinkDown
from roclog.polling.facts import device_metadata, read_facts
from roclog.polling.refusal import described
from roclog.samples import link_entry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Clock
    from roclog.config.settings import Device
    from roclog.decode import Value
    from roclog.outbox import Outbox
    from roclog.polling.clock_watch import ClockWatch
    from roclog.polling.flagged_block import FlaggedBlock
    from roclog.polling.poller import Poller
    from roclog.recording.writer import Writer

_LINK_PERIOD: Final = 60 * 10**9
_PATIENCE: Final = 3
"""Failures in a row that are not yet held against a device that has answered before."""
_FACTS_PAUSE: Final = 60 * 10**9
_FACTS_POSTPONED: Final = 3
_LONGEST_PAUSE: Final = 30 * 10**9
_ABSENT: Final = 60 * 10**9
"""After this long without an answer another device may stand there: the facts are read again."""


class PolledDevice:
    """Reads one device until it is told to stop.

    pollers: what is read of it, one after the other. flagged: the one among them that has a flag.
    phase: nanoseconds from the start to the first poll, so that devices do not all come at once.
    """

    def __init__(
        self,
        *,
        device: Device,
        bus: Bus,
        tally: Tally,
        pollers: Sequence[Poller],
        flagged: FlaggedBlock | None,
        outbox: Outbox,
        writer: Writer,
        clock: Clock,
        clock_watch: ClockWatch,
        phase: int = 0,
    ) -> None:
        self.device = device
        self.outbox = outbox
        self.pollers = pollers
        self.facts: dict[str, dict[str, Value]] = {}
        self._bus = bus
        self._tally = tally
        self._flagged = flagged
        self._writer = writer
        self._clock = clock
        self._clock_watch = clock_watch
        self._phase = phase
        self._facts_due = True
        self._facts_after = 0
        self._facts_failures = 0
        self._facts_postponed = 0
        self._are_calls = device.profile.dialect.has_functions
        self._trouble = ""
        self._failures = 0
        self._has_answered = False
        self._silent_since: int | None = None
        self._link_since = clock.now()
        self._stopping = False
        self._sleeper: asyncio.Future[None] | None = None
        self._set_cycle()

    @property
    def samples(self) -> int:
        """Samples so far; earlier runs count."""
        return sum(poller.samples for poller in self.pollers)

    async def run(self) -> None:
        """Poll without drift until ``stop``. What is late by less than a period goes at once."""
        start = self._now() + self._phase
        due = [start] * len(self.pollers)
        await self._sleep_until(start)
        while not self._stopping:
            index = due.index(min(due))
            busy = self._tally.busy
            await self._poll(self.pollers[index], due[index])
            now = self._now()
            self._report_link(now)
            due[index] = self._next_due(due[index], self.pollers[index].period, now)
            rest = self._pause(self._tally.busy - busy)
            if rest:
                due = [max(instant, now + rest) for instant in due]
            await self._sleep_until(min(due))

    def stop(self) -> None:
        """Have ``run`` return after the poll in hand."""
        self._stopping = True
        if self._sleeper is not None and not self._sleeper.done():
            self._sleeper.set_result(None)

    def close(self) -> None:
        """The end of a run: what is still open is said."""
        for poller in self.pollers:
            poller.close()
        self._report_link(self._now(), at_last=True)

    def _now(self) -> int:
        return self._clock.now().monotonic

    async def _sleep_until(self, instant: int) -> None:
        left = instant - self._now()
        if left <= 0 or self._stopping:
            await asyncio.sleep(0)
            return
        loop = asyncio.get_running_loop()
        self._sleeper = sleeper = loop.create_future()
        alarm = loop.call_later(left / 1e9, _wake, sleeper)
        try:
            await sleeper
        finally:
            alarm.cancel()

    def _next_due(self, due: int, period: int, now: int) -> int:
        """One period on; never a burst: turns that are over a period late are left out."""
        due += period
        if now - due > period:
            skipped = (now - due) // period
            self._tally.skipped += skipped
            due += skipped * period
        return due

    def _pause(self, cost: int) -> int:
        """Rest after a failure, so that silent devices together take a quarter of a shared line.

        cost: what the failure took of the line. Where nobody answers there is nobody to spare.
        """
        failing = self._bus.failing
        if self._failures < (_PATIENCE if self._has_answered else 1):
            failing.discard(self.device.name)
            return 0
        failing.add(self.device.name)
        if len(failing) == self._bus.devices:
            return 0
        return min((4 * len(failing) - 1) * cost, _LONGEST_PAUSE)

    async def _poll(self, poller: Poller, due: int) -> None:
        """One attempt; a device that does not answer costs one time-out."""
        self._tally.polls += 1
        try:
            if self._facts_due and self._now() >= self._facts_after and not self._gives_way():
                await self._read_facts(due)
            await poller.turn(due)
        except DeviceError as error:
            self._tell_trouble(error)
            return
        self._tell_recovery()
        if self._flagged is not None and self._flagged.powered_up:
            self._flagged.powered_up = False
            self._facts_due = True

    def _gives_way(self) -> bool:
        """At the start all want their facts: where others wait, they wait for a few polls."""
        self._facts_postponed += 1
        return self._bus.has_queue and self._facts_postponed <= _FACTS_POSTPONED

    async def _read_facts(self, due: int) -> None:
        """Identity and configuration; after a failure the next poll goes without them.

        A device that answers samples but not these is asked for them once a minute; where reading
        them is calling functions, never more often.
        """
        self._facts_failures += 1
        is_late = self._facts_failures > _PATIENCE or self._are_calls
        pause = _FACTS_PAUSE if is_late else 1.5 * self.device.poll
        self._facts_after = self._now() + int(pause)
        for block in self.device.profile.facts:
            try:
                found = await read_facts(block, self.device, self._bus, self._tally, due)
                self.facts[block.name] = found
            except ExceptionAnswer as refusal:
                unit, dialect = self.device.unit, self.device.profile.dialect
                why = await described(refusal, unit, self._bus, self._tally, dialect)
                self.outbox.event("warning", "facts", f"{block.name} block: {why}")
        self._facts_due = False
        self._facts_postponed = 0
        self._facts_failures = 0
        self._facts_after = self._facts_after if self._are_calls else 0
        self._set_cycle()
        metadata = device_metadata(self.device, self.facts)
        self._writer.describe(f"roclog.device.{self.device.name}", metadata)

    def _set_cycle(self) -> None:
        if self._flagged is None:
            return
        cycle = self.device.cycle
        source = self.device.profile.cycle
        if cycle is None and source is not None and source[0] in self.facts:
            seconds = [self.facts[source[0]][name] for name in source[1]]
            cycle = int(sum(float(value) for value in seconds) * 1e9) or None
        self._flagged.cadence.cycle = cycle

    def _tell_trouble(self, error: DeviceError) -> None:
        """A single failure is counted; the second in a row, or a lost link, is an event."""
        self._failures += 1
        if self._silent_since is None:
            self._silent_since = self._now()
        if isinstance(error, LinkDown):
            self._facts_due = True
        elif self._failures < 2:
            return
        kind = type(error).__name__
        if kind != self._trouble:
            self._trouble = kind
            self.outbox.event("warning", "link", str(error))

    def _tell_recovery(self) -> None:
        self._has_answered = True
        if self._silent_since is None:
            return
        silent = self._now() - self._silent_since
        if silent > _ABSENT:
            self._facts_due = True
        if self._trouble:
            self.outbox.event("info", "link", f"answers again after {silent / 1e9:.1f} s")
        self._silent_since = None
        self._failures = 0
        self._trouble = ""

    def _report_link(self, now: int, *, at_last: bool = False) -> None:
        if now - self._link_since.monotonic < _LINK_PERIOD and not at_last:
            return
        instant = self._clock.now()
        self.outbox.note(link_entry(self.device.name, self._link_since, instant, self._tally))
        self._clock_watch.report(instant)
        self._link_since = instant
        self._tally.reset()


def _wake(sleeper: asyncio.Future[None]) -> None:
    if not sleeper.done():
        sleeper.set_result(None)

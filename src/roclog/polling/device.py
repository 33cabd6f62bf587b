"""One device on its schedule: facts first, then each of its pollers at every period, for ever."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from roclog.errors import DeviceError, LinkDown
from roclog.polling.facts import device_metadata
from roclog.polling.flagged_block import FlaggedBlock
from roclog.polling.introduction import ABSENT, Introduction
from roclog.samples import link_entry, replaced_entry

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Clock, Instant
    from roclog.config.settings import Device
    from roclog.decode import Value
    from roclog.outbox import Outbox
    from roclog.polling.clock_watch import ClockWatch
    from roclog.polling.identity import Succession
    from roclog.polling.poller import Poller
    from roclog.recording.writer import Writer

    Carried = Mapping[str, object]

_LINK_PERIOD: Final = 60 * 10**9
_PATIENCE: Final = 3
"""Failures in a row that are not yet held against a device that has answered before."""
_LONGEST_PAUSE: Final = 30 * 10**9


class PolledDevice:
    """Reads one device until it is told to stop.

    make_pollers: what is read of it, one after the other, given what earlier runs left of each
    topic: ``carried`` at first, nothing once another device answers in its place.
    answered_at: UTC ns, when it was last read in an earlier run, 0 = not known.
    phase: nanoseconds from the start to the first poll, so that devices do not all come at once.
    """

    def __init__(
        self,
        *,
        device: Device,
        bus: Bus,
        tally: Tally,
        make_pollers: Callable[[Mapping[str, Carried]], Sequence[Poller]],
        carried: Mapping[str, Carried],
        answered_at: int,
        succession: Succession,
        outbox: Outbox,
        writer: Writer,
        clock: Clock,
        clock_watch: ClockWatch,
        phase: int = 0,
    ) -> None:
        self.device = device
        self.outbox = outbox
        self.pollers = make_pollers(carried)
        self.facts: dict[str, dict[str, Value | None]] = {}
        self._bus = bus
        self._tally = tally
        self._make_pollers = make_pollers
        self._succession = succession
        self._is_replaced = False
        self._samples_before = 0
        self._answered_at = answered_at
        self._writer = writer
        self._clock = clock
        self._clock_watch = clock_watch
        self._phase = phase
        self._introduction = Introduction(device, bus, tally, outbox, clock)
        self._described: Mapping[str, str] = {}
        self._heard_at: int | None = None
        self._trouble = _Trouble()
        self._troubles = [_Trouble() for _ in self.pollers]
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
        return self._samples_before + sum(poller.samples for poller in self.pollers)

    @property
    def _flagged(self) -> FlaggedBlock | None:
        first = self.pollers[0]
        return first if isinstance(first, FlaggedBlock) else None

    async def run(self) -> None:
        """Poll without drift until ``stop``. What is late by less than a period goes at once."""
        start = self._now() + self._phase
        due = [start] * len(self.pollers)
        await self._sleep_until(start)
        while not self._stopping:
            index = due.index(min(due))
            busy = self._tally.busy
            await self._poll(index, due[index])
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
        if not self._is_replaced:  # else they were, when another device answered
            self._close_pollers()
        self._report_link(self._now(), at_last=True)

    def _close_pollers(self, *, is_end: bool = True) -> None:
        now = self._clock.now()
        for poller in self.pollers:
            poller.close(now, is_end=is_end)

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

    async def _poll(self, index: int, due: int) -> None:
        """One attempt; a device that does not answer costs one time-out."""
        introduction, tally = self._introduction, self._tally
        tally.polls += 1
        introduction.watch_link()
        began, heard = None, 0
        try:
            if introduction.is_due and introduction.may_ask(
                self._failures, is_known=self._succession.is_known
            ):
                self._meet(await introduction.ask(due))
            if not self._is_replaced or await self._hand_over():
                began, heard = self._clock.now(), tally.heard
                await self.pollers[index].turn(due)
        except DeviceError as error:
            if began is None:
                self.pollers[index].expect(due)
            elif tally.heard > heard:
                self._note_heard(began)
            self._tell_trouble(index, error)
            return
        if began is not None and tally.heard > heard:
            self._note_heard(began)
        self._tell_recovery(index)
        if self._flagged is not None and self._flagged.powered_up:
            self._flagged.powered_up = False
            introduction.demand()

    def _note_heard(self, began: Instant) -> None:
        """A turn that failed in the end may have heard the device all the same."""
        self._heard_at = began.monotonic
        if not self._introduction.is_due:  # else nobody knows yet who it was
            self._answered_at = began.utc

    def _meet(self, found: dict[str, dict[str, Value | None]]) -> None:
        """The device has told who it is and how it is set."""
        changed = self._succession.see(found)
        self.facts = found if changed else {**self.facts, **found}
        if changed:
            self._end_of_last(changed)
        elif not self._is_replaced:
            self._set_cycle()
            self._describe()

    def _describe(self) -> None:
        """Into the segment, and every later one; not again where nothing is new."""
        metadata = device_metadata(self.device, self.facts)
        if metadata != self._described:
            self._described = metadata
            self._writer.describe(f"roclog.device.{self.device.name}", metadata)

    def _end_of_last(self, changed: str) -> None:
        """Another device answers than before."""
        text = f"another device answers: {changed}; a new epoch begins"
        self.outbox.event("warning", "identity", text)
        if not self._is_replaced:
            self._is_replaced = True
            self._close_pollers(is_end=False)

    async def _hand_over(self) -> bool:
        """The next device begins when everything of the last one is on disk; False = not yet.

        So is the gap between the two: were the process killed in between, the next run would notice
        the other device once more, and tell a second one.
        """
        for poller in self.pollers:
            await poller.outbox.flush()
        if not all(poller.outbox.empty for poller in self.pollers):
            return False
        now = self._clock.now().utc
        since, self._answered_at = min(self._answered_at or now, now), now
        outbox = self.pollers[0].outbox
        outbox.add(replaced_entry(self.device.name, since, now))
        if not await outbox.flush():
            return False
        self._is_replaced = False
        self._described = device_metadata(self.device, self.facts)
        self._succession.begin(self._described)
        self._samples_before = self.samples
        self.pollers = self._make_pollers({})
        self._set_cycle()
        self._clock_watch.restart()
        return True

    def _set_cycle(self) -> None:
        if self._flagged is None:
            return
        cycle = self.device.cycle
        source = self.device.profile.cycle
        if cycle is None and source is not None and source[0] in self.facts:
            seconds = [self.facts[source[0]][name] or 0 for name in source[1]]  # never missing
            cycle = int(sum(float(value) for value in seconds) * 1e9) or None
        self._flagged.cadence.cycle = cycle

    def _tell_trouble(self, index: int, error: DeviceError) -> None:
        """A single failure is counted; the second in a row, or a lost link, is an event.

        It is the device's, or that of one poller while the others get answers.
        """
        self._failures += 1
        if self._silent_since is None:
            self._silent_since = self._now()
        since = self._silent_since if self._heard_at is None else self._heard_at
        if isinstance(error, LinkDown) or self._now() - since > ABSENT:
            self._introduction.want()
        own = self._troubles[index]
        own.failures += 1
        if own.failures < 2 and not isinstance(error, LinkDown):
            return
        is_alone = any(other.failures == 0 for other in self._troubles)
        trouble, whose = self._trouble, ""
        if is_alone and own.failures > 1:
            trouble, whose = own, f"{self.pollers[index].name}: "
        if trouble.is_news(error):
            self.outbox.event("warning", "link", f"{whose}{error}")

    def _tell_recovery(self, index: int) -> None:
        self._has_answered = True
        self._introduction.go_without()
        if self._silent_since is not None:
            silent = self._now() - self._silent_since
            if self._trouble.told:
                self.outbox.event("info", "link", f"answers again after {silent / 1e9:.1f} s")
            self._silent_since = None
            self._failures = 0
            self._trouble.end()
        if self._troubles[index].told:
            self.outbox.event("info", "link", f"{self.pollers[index].name}: answered again")
        self._troubles[index].end()

    def _report_link(self, now: int, *, at_last: bool = False) -> None:
        if now - self._link_since.monotonic < _LINK_PERIOD and not at_last:
            return
        instant = self._clock.now()
        self.outbox.note(link_entry(self.device.name, self._link_since, instant, self._tally))
        self._clock_watch.report(instant)
        self._link_since = instant
        self._tally.reset()


class _Trouble:
    """Failures in a row, and the kinds of them that were told."""

    def __init__(self) -> None:
        self.failures = 0
        self.told: set[type[DeviceError]] = set()

    def is_news(self, error: DeviceError) -> bool:
        """Once for each kind."""
        known, kind = self.told.copy(), type(error)
        self.told.add(kind)
        return kind not in known

    def end(self) -> None:
        self.failures = 0
        self.told.clear()


def _wake(sleeper: asyncio.Future[None]) -> None:
    if not sleeper.done():
        sleeper.set_result(None)

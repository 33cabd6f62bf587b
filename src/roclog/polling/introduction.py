"""When a device is asked who it is and how it is set, and what it answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.errors import ExceptionAnswer, LinkDown
from roclog.polling.facts import read_facts
from roclog.polling.refusal import described, is_refusal

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Clock
    from roclog.config.settings import Device
    from roclog.decode import Value
    from roclog.outbox import Outbox

ABSENT: Final = 5 * 10**9
"""Nobody puts another device in place of one that has told who it is in less time than this. After
as long without an answer, or when a link is opened again, it is asked again."""
_PATIENCE: Final = 3
"""Attempts in a row that may fail before it is asked once a minute only."""
_MINUTE: Final = 60 * 10**9
_POSTPONED: Final = 3
_FIRST: Final = 16
"""Who comes back is asked who it is before its samples are: in all but one poll of so many, for one
that does not tell any more."""


class Introduction:
    """The facts blocks of one device.

    is_due: it is to be asked; until it has answered, nobody knows who is there.
    """

    def __init__(
        self, device: Device, bus: Bus, tally: Tally, outbox: Outbox, clock: Clock
    ) -> None:
        self.is_due = True
        self._device = device
        self._bus = bus
        self._tally = tally
        self._outbox = outbox
        self._clock = clock
        self._are_calls = device.profile.dialect.has_functions
        self._comes_first = True
        self._after = 0
        self._read_at: int | None = None
        self._openings = 0
        self._failures = 0
        self._postponed = 0
        self._refused: set[str] = set()

    def demand(self) -> None:
        """Another device may have been put in place, or the same one was switched off."""
        self.is_due = self._comes_first = True

    def want(self) -> None:
        """As demand, unless it has told who it is just now."""
        if self._read_at is None or self._now() - self._read_at > ABSENT:
            self.demand()

    def watch_link(self) -> None:
        """Who is behind a link that was opened again?"""
        if not self._bus.is_open or self._bus.openings != self._openings:
            self.want()

    def may_ask(self, failures: int, *, is_known: bool) -> bool:
        """Whether this poll begins with the question.

        failures: polls in a row without an answer. is_known: it has told before who it is; then not
        even one poll after a silence comes first.
        """
        if failures and self._comes_first and is_known and not self._are_calls:
            return failures % _FIRST > 0
        return self._now() >= self._after and not self._gives_way()

    async def ask(self, due: int) -> dict[str, dict[str, Value | None]]:
        """What the device tells, by block; those that it refuses are left out.

        After a failure the next poll goes without. A device that answers samples but not this is
        asked once a minute; where asking is calling functions, never more often.

        Raises:
            DeviceError: as Bus.transact.
        """
        self._failures += 1
        is_late = self._failures > _PATIENCE or self._are_calls
        after, requests = self._after, self._tally.requests
        self._after = self._now() + (_MINUTE if is_late else 3 * self._device.poll // 2)
        try:
            found = await self._read(due)
        except LinkDown:
            if self._tally.requests == requests:
                self._after = after  # nothing was sent, and nothing was called
            raise
        self.is_due = self._comes_first = False
        self._read_at = self._now()
        self._openings = self._bus.openings
        self._postponed = self._failures = 0
        if not self._are_calls:
            self._after = 0
        return found

    def go_without(self) -> None:
        """It was read without having told who it is. If it does not soon, then once a minute."""
        if self.is_due and self._comes_first:
            self._comes_first = False
            self._openings = self._bus.openings
            if not self._are_calls:
                self._failures = self._after = 0

    def _now(self) -> int:
        return self._clock.now().monotonic

    def _gives_way(self) -> bool:
        """At the start all are asked: where others wait, this one waits for a few polls."""
        self._postponed += 1
        return self._bus.has_queue and self._postponed <= _POSTPONED

    async def _read(self, due: int) -> dict[str, dict[str, Value | None]]:
        found = {}
        for block in self._device.profile.facts:
            try:
                facts = await read_facts(block, self._device, self._bus, self._tally, due)
            except ExceptionAnswer as refusal:
                if not is_refusal(refusal):
                    raise
                await self._tell_refusal(block.name, refusal)
            else:
                self._refused.discard(block.name)
                found[block.name] = facts
        return found

    async def _tell_refusal(self, name: str, refusal: ExceptionAnswer) -> None:
        if name not in self._refused:
            self._refused.add(name)
            unit, dialect = self._device.unit, self._device.profile.dialect
            why = await described(refusal, unit, self._bus, self._tally, dialect)
            self._outbox.event("warning", "facts", f"{name} block: {why}")

"""One device with a new-data flag: read, judge, decode, write, commit, clear."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from roclog.bus.bus import TooLate
from roclog.cadence import Cadence, Missed
from roclog.errors import DeviceError, ExceptionAnswer
from roclog.handshake import Memory, Note, Seen, Verdict, after_clear, judge
from roclog.modbus.request import WriteRegister, words
from roclog.polling.block_watch import BlockWatch
from roclog.polling.refusal import is_refusal
from roclog.register_map import FlagAndClear
from roclog.request_plan import read_request
from roclog.samples import Reading, SampleMaker
from roclog.schema import ClearResult, Reason

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Clock, Instant
    from roclog.outbox import Outbox
    from roclog.recording.entries import Entry
    from roclog.register_map import Block

_SETTLE_MAX: Final = 250_000_000
"""Nanoseconds between the two reads that confirm a sample: a quarter of the cycle, at most this.
Longer than a device takes to update its block, short against its cycle."""
_LOOKS: Final = 4
"""Reads in one poll for a block that does not hold still, or of which every answer takes long."""
_REFUSED_PAUSE: Final = 60 * 10**9
"""Nanoseconds before a refused clear is tried again."""


class FlaggedBlock:
    """The straight path of one block. ``turn`` is called at every poll.

    acknowledge: whether the flag may be cleared; False leaves it to somebody else.
    read_until: UTC ns at which an earlier run last read the block, 0 = never. sampled_at: UTC ns at
    which its last sample was read.
    """

    def __init__(
        self,
        *,
        unit: int,
        bus: Bus,
        tally: Tally,
        maker: SampleMaker,
        memory: Memory,
        outbox: Outbox,
        clock: Clock,
        acknowledge: bool,
        period: int,
        read_until: int = 0,
        sampled_at: int = 0,
    ) -> None:
        block, trigger = maker.block, maker.block.trigger
        if not isinstance(trigger, FlagAndClear):
            raise TypeError(f"block {block.name} has no flag")
        self.block: Block = block
        self.period = period
        self.outbox = outbox
        self.cadence = Cadence(None)
        self.last: Reading | None = None
        self.powered_up = False
        self._trigger = trigger
        self._request = read_request(block)
        self._unit = unit
        self._bus = bus
        self._tally = tally
        self._maker = maker
        self._watch = BlockWatch(maker, outbox)
        self._memory = memory
        self._clock = clock
        self._acknowledge = acknowledge
        self._read_until = read_until
        self._known_until = read_until
        self._sampled_at = sampled_at
        self._due = self._read_due = self._began = 0
        self._quiet_at = 0
        self._clear_after = 0
        self._refused = False
        self._uncertain = False
        self._certain_before = 0
        self._overdue = False
        self._odd_flag_told = False

    @property
    def name(self) -> str:
        return self.block.name

    @property
    def samples(self) -> int:
        """Number of the last sample; earlier runs count."""
        return self._memory.seq

    def expect(self, due: int) -> None:
        if not self._began:
            self._began, self._read_due = due, due - self.period
        self._due = due

    async def turn(self, due: int) -> None:
        """One poll, up to the clear.

        Raises:
            DeviceError: a read failed; what was learnt before is kept.
        """
        self.expect(due)
        await self._converse()
        if self.last is not None:
            self._watch.see(self.last)

    async def _converse(self) -> None:
        looks, unsettled = 1, 0
        while True:
            verdict = await self._look()
            looks = 1 if verdict.news else looks
            if verdict.again:
                unsettled += 1
                if unsettled > _LOOKS:
                    return  # it does not hold still; the next poll goes on from here
                await asyncio.sleep(self._settle() / 1e9)
                continue
            if not verdict.clear or not self._may_clear():
                return
            until = self.cadence.guarded_until()
            guarded = until is not None and self._clock.now().monotonic < until
            if guarded or looks > _LOOKS or (looks > 1 and self._is_fresh()):
                try:
                    await self._clear(until if guarded else None)
                    return
                except TooLate:
                    pass
            looks += 1  # the guard does not hold: read once more right before the clear

    def close(self, now: Instant, *, is_end: bool = True) -> None:
        """Leave nothing unsaid at the end of a run, or of a device."""
        del is_end  # no turns are counted
        self._tell_missed(self.cadence.close(), now)
        known_until = self.last.seen_until if self.last is not None else 0
        candidate = self._memory.candidate
        if candidate is not None:
            raw = self._reading(candidate).raw.hex(" ")
            self._event("warning", "unconfirmed", f"stopped before a second read of {raw}")
            known_until = self._reading(candidate).known_until
        if self._due > self._read_due:
            since = known_until if candidate is not None else self._since(self.last, now)
            gap = self._unread(since, now)
            carry = self._maker.carry(self._memory, now.utc, self._sampled_at)
            self.outbox.add(gap._replace(carry=carry, carry_topic=self._maker.topic))
        elif self.last is not None and self.outbox.empty:
            carry = self._maker.carry(self._memory, known_until, self._sampled_at)
            self.outbox.checkpoint(self._maker.topic, carry)

    async def _look(self) -> Verdict:
        answer = await self._bus.transact(self._unit, self._request, self._tally, due=self._due)
        reading = Reading(
            words(answer.pdu), answer.asked, answer.began, answer.read, self._quiet_at
        )
        seen = self._seen(reading)
        candidate = self._memory.candidate
        if candidate is not None and candidate.payload != seen.payload:
            reading = reading._replace(previous=self._reading(candidate).seen_until)
            seen = replace(seen, reading=reading)
        self._memory, verdict = judge(self._memory, seen)
        self._tell_unread(reading.read)
        if self.cadence.cycle is not None or verdict.news:
            self._tell_downtime(reading.read)
        self._record(reading, verdict)
        self.last = reading
        if not verdict.again:
            self._quiet_at = reading.seen_until
        await self.outbox.flush()
        return verdict

    def _seen(self, reading: Reading) -> Seen:
        value = reading.words[self._trigger.flag]
        if value not in (self._trigger.new, self._trigger.clear) and not self._odd_flag_told:
            self._odd_flag_told = True
            register = self.block.address + self._trigger.flag
            self._event("warning", "flag", f"register {register} is {value}, which is undefined")
        raw = reading.raw
        payload = b"".join(raw[2 * a : 2 * (a + n)] for a, n in self._trigger.payload)
        return Seen(value == self._trigger.new, payload, reading)

    def _record(self, reading: Reading, verdict: Verdict) -> None:
        for note, seen in verdict.notes:
            self._tell_note(note, self._reading(seen), reading)
        for news in verdict.news:
            kept = self._reading(news.seen)
            if not news.redelivered:
                self._follow(kept, reading)
            self._known_until = kept.known_until
            self._sampled_at = kept.read.utc
            self.outbox.add(self._maker.sample(news, kept, self._memory))
        if not verdict.again and self._memory.candidate is None:
            self._tell_missed(self.cadence.quiet(reading.asked.monotonic), reading.read)
            self._watch_for_overdue(reading)

    def _follow(self, kept: Reading, reading: Reading) -> None:
        """Count what was missed before a new sample."""
        since = self.cadence.last_completed
        missed = self.cadence.completed(kept.asked.monotonic, kept.read.monotonic)
        self._tell_missed(missed, reading.read)
        if self._overdue and self._uncertain and since is not None:
            hidden = Missed(since, kept.read.monotonic, 1, possible=True)
            self._tell_missed(hidden, reading.read, Reason.UNGUARDED_CLEAR)
        self._uncertain = False
        self._overdue = False

    def _watch_for_overdue(self, reading: Reading) -> None:
        if reading.read.monotonic < self._certain_before:
            self._uncertain = False  # no further sample can have hidden behind the clear
        if not self._overdue and self.cadence.overdue(reading.asked.monotonic):
            self._overdue = True
            self._event("warning", "overdue", "no new sample for 1.5 cycles")

    def _is_fresh(self) -> bool:
        """What was read is so young that hardly a sample can have completed since."""
        if self.last is None:
            return False
        return self._clock.now().monotonic - self.last.asked.monotonic < self._settle()

    def _may_clear(self) -> bool:
        if not self._acknowledge or not self.outbox.empty:
            return False
        return self._clock.now().monotonic >= self._clear_after

    async def _clear(self, not_after: int | None) -> None:
        request = WriteRegister(self.block.address + self._trigger.flag, self._trigger.clear)
        asked = self._clock.now()
        code = 0
        try:
            await self._bus.transact(
                self._unit, request, self._tally, due=self._due, not_after=not_after
            )
            result = ClearResult.DONE
        except TooLate:
            raise
        except ExceptionAnswer as refusal:
            result, code = ClearResult.UNANSWERED, refusal.code
            if is_refusal(refusal):
                result = ClearResult.REFUSED
                self._tell_refusal(refusal)
        except DeviceError:  # it may have taken effect; the next read tells
            result = ClearResult.UNANSWERED
        if result is ClearResult.DONE and self._refused:
            self._refused = False
            self._event("info", "clear", "the device takes the clear again")
        self._memory = after_clear(self._memory, result)
        self._uncertain = not_after is None or result is ClearResult.UNANSWERED
        self._certain_before = not_after or 0
        ended = self._clock.now().utc
        guarded = not_after is not None
        note = self._maker.clear(
            self._memory,
            asked.utc,
            ended,
            result,
            code,
            guarded=guarded,
            read_at=self._known_until,
            sampled_at=self._sampled_at,
        )
        self.outbox.note(note)

    def _tell_refusal(self, refusal: ExceptionAnswer) -> None:
        self._clear_after = self._clock.now().monotonic + _REFUSED_PAUSE
        if not self._refused:
            self._refused = True
            self._event("warning", "clear", f"the device refuses the clear: {refusal}")

    def _tell_note(self, note: Note, seen: Reading, reading: Reading) -> None:
        raw = seen.raw.hex(" ")
        match note:
            case Note.BASELINE:
                self._event("info", "baseline", f"first block, flag down, not a sample: {raw}")
                carry = self._maker.carry(self._memory, reading.seen_until, self._sampled_at)
                self.outbox.checkpoint(self._maker.topic, carry)
            case Note.POWER_UP:
                self._tell_power_up(reading)
            case Note.TORN:
                self._event("warning", "torn", f"read in the middle of an update: {raw}")
            case Note.OVERTAKEN:
                self._event("warning", "overtaken", f"kept without its second read: {raw}")
            case Note.REDELIVERED:
                self._event("info", "redelivered", f"sample {self._memory.seq} is still flagged")

    def _tell_power_up(self, reading: Reading) -> None:
        """The block is zeros again. What was completed unseen before that is not known."""
        self.powered_up = True
        self._event("warning", "power-up", "the sample block is all zeros, the device restarted")
        cycle = self.cadence.effective_cycle
        missed = self.cadence.forget()
        if self.last is not None and cycle is not None:
            since = self.last.asked.monotonic
            blind = reading.read.monotonic - since
            if blind > cycle:
                missed = Missed(since, reading.read.monotonic, blind // cycle, possible=True)
        self._tell_missed(missed, reading.read)

    def _tell_missed(
        self, missed: Missed | None, now: Instant, reason: Reason = Reason.OVERWRITTEN
    ) -> None:
        if missed is None:
            return
        offset = now.utc - now.monotonic
        after, before = missed.after + offset, missed.before + offset
        gap = self._maker.gap(
            after, before, missed.count, reason, now.utc, possible=missed.possible
        )
        self.outbox.add(gap)

    def _tell_downtime(self, now: Instant) -> None:
        """The time between two runs is a gap, on disk no later than the first sample after it.

        So many cycles have passed for certain, and the last of their samples is there to be read.
        """
        since, self._read_until = min(self._read_until, now.utc), 0
        if since:
            cycle = self.cadence.cycle
            last = max(since, self._sampled_at)  # it was completed by then
            passed = max(0, now.utc - last) // cycle if cycle else 0
            expected, possible = max(0, passed - 1), passed <= 1
            self.outbox.add(
                self._maker.gap(
                    since, now.utc, expected, Reason.DOWNTIME, now.utc, possible=possible
                )
            )

    def _tell_unread(self, read: Instant) -> None:
        """Turns that brought nothing, where neither the cadence nor an earlier run bounds them."""
        unread, self._read_due = (self._due - self._read_due) // self.period - 1, self._due
        is_counted = self._read_until if self.last is None else self.cadence.cycle
        if unread > 0 and not is_counted:
            self.outbox.add(self._unread(self._since(self.last, read), read))

    def _since(self, last: Reading | None, until: Instant) -> int:
        """UTC ns of the last read, or from which on this run or an earlier one knows nothing."""
        if last is None and self._read_until:
            return min(self._read_until, until.utc)
        seen = self._began if last is None else last.asked.monotonic
        return until.utc - (until.monotonic - seen)

    def _unread(self, since: int, until: Instant) -> Entry:
        """What was completed in this time is not known."""
        is_first = self.last is None and self._read_until > 0
        reason = Reason.DOWNTIME if is_first else Reason.UNREAD
        cycle = self.cadence.cycle
        expected = (until.utc - since) // cycle if cycle else 0
        return self._maker.gap(since, until.utc, expected, reason, until.utc, possible=True)

    def _settle(self) -> int:
        cycle = self.cadence.effective_cycle
        return _SETTLE_MAX if cycle is None else min(cycle // 4, _SETTLE_MAX)

    def _event(self, level: str, kind: str, text: str) -> None:
        self.outbox.event(level, kind, text)

    @staticmethod
    def _reading(seen: Seen) -> Reading:
        if not isinstance(seen.reading, Reading):
            raise TypeError("news without its reading")
        return seen.reading

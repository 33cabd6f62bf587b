"""Blocks without a flag: read on schedule, each read a sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roclog.errors import ExceptionAnswer
from roclog.modbus.dialect import STANDARD
from roclog.modbus.request import ReadRegisters, words
from roclog.polling.refusal import described
from roclog.register_map import Counter
from roclog.request_plan import plan_requests
from roclog.samples import Reading
from roclog.schema import Reason
from roclog.triggers import Known, is_raised, judge

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.bus.bus import Answer, Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Instant
    from roclog.modbus.dialect import Dialect
    from roclog.outbox import Outbox
    from roclog.polling.clock_watch import ClockWatch
    from roclog.recording.entries import Entry
    from roclog.register_map import ClearOnRead
    from roclog.request_plan import Fetch
    from roclog.samples import SampleMaker
    from roclog.triggers import Finding, Note


class CyclicBlock:
    """Judges the reads of one block, numbers its samples and counts what was missed between them.

    period: nanoseconds between reads. known: what earlier runs leave; raw: octets of their last
    sample, where a trigger compares with it.
    read_until: UTC ns at which an earlier run last read the block, 0 = never.
    """

    def __init__(
        self,
        maker: SampleMaker,
        period: int,
        known: Known | None = None,
        read_until: int = 0,
        raw: bytes = b"",
    ) -> None:
        self.maker = maker
        self._period = period
        self._known = known or Known()
        self._read_until = read_until
        self._last: Instant | None = None
        self._raw = raw
        self._told: Note | None = None

    @property
    def seq(self) -> int:
        """Number of the last sample."""
        return self._known.seq

    def take(self, octets: bytes, answer: Answer, asked: Instant, outbox: Outbox) -> Entry | None:
        """One read, and its sample if it is one.

        asked: of its first request, where several were needed.
        """
        last, self._last = self._last, answer.read
        words = self.maker.words(octets)
        self._known, finding = judge(self.maker.block, self._known, words, self.maker.order)
        self._tell_missed(finding, last, answer.read, outbox)
        if finding.note is not self._told:
            self._told = finding.note
            if finding.note is not None:
                outbox.event(
                    "warning", "counter", f"{finding.note.name.lower()}: {octets.hex(' ')}"
                )
        if finding.origin is None:
            return None
        self._raw = octets
        previous = last.utc if last is not None else 0
        reading = Reading(words, asked, answer.began, answer.read, previous)
        carry = self._carry(answer.read)
        entry = self.maker.message(reading, self.seq, finding.origin, carry)
        outbox.add(entry)
        return entry

    def close(self, outbox: Outbox) -> None:
        """Let the next run know until when this one has read."""
        if self._last is not None:
            outbox.checkpoint(self.maker.topic, self._carry(self._last))

    def _tell_missed(
        self, finding: Finding, last: Instant | None, read: Instant, outbox: Outbox
    ) -> None:
        """Before the sample. Where the device numbers its samples, it tells; else time does."""
        since = read.utc - (read.monotonic - last.monotonic) if last is not None else 0
        counts = isinstance(self.maker.block.trigger, Counter)
        if finding.missed:
            start = since or self._read_until or read.utc
            gap = self.maker.gap(
                min(start, read.utc),
                read.utc,
                finding.missed,
                Reason.OVERWRITTEN if last is not None else Reason.DOWNTIME,
                read.utc,
                possible=finding.possible,
            )
            outbox.add(gap)
        if last is not None:
            unread = (read.utc - since + self._period // 2) // self._period - 1
            if unread > 0 and not counts:
                outbox.add(self._unread(since, read.utc, unread, Reason.UNREAD))
        elif self._read_until and not counts:
            since = min(self._read_until, read.utc)
            unread = (read.utc - since) // self._period
            outbox.add(self._unread(since, read.utc, unread, Reason.DOWNTIME))

    def _unread(self, since: int, until: int, count: int, reason: Reason) -> Entry:
        """Every read is a sample, or how many samples there were between two reads is not known."""
        if self.maker.block.trigger is None:
            return self.maker.gap(since, until, count, reason, until)
        return self.maker.gap(since, until, 0, reason, until, possible=True)

    def _carry(self, read: Instant) -> Mapping[str, object]:
        carry = {"epoch": self.maker.epoch.hex(), "seq": self.seq, "read_at": read.utc}
        return carry if self.maker.block.trigger is None else {**carry, "raw": self._raw.hex()}


class CyclicBlocks:
    """All blocks of a device that share a period, in as few requests as they allow."""

    def __init__(
        self,
        *,
        unit: int,
        bus: Bus,
        tally: Tally,
        blocks: Sequence[CyclicBlock],
        period: int,
        outbox: Outbox,
        clock_watch: ClockWatch,
        dialect: Dialect = STANDARD,
    ) -> None:
        self.period = period
        self.outbox = outbox
        self._unit = unit
        self._bus = bus
        self._tally = tally
        self._blocks = blocks
        self._clock_watch = clock_watch
        self._dialect = dialect
        self._plan = plan_requests([block.maker.block for block in blocks], dialect)
        self._halves: dict[int, tuple[Instant, bytes]] = {}
        self._refused: set[int] = set()

    @property
    def samples(self) -> int:
        return sum(block.seq for block in self._blocks)

    async def turn(self, due: int) -> None:
        """Read every block once; one that the device refuses keeps no other from being read.

        Raises:
            DeviceError: no answer, or a wrong one; the blocks read before it are kept.
        """
        self._tell_given_up()
        self._halves.clear()
        try:
            for number, fetch in enumerate(self._plan):
                try:
                    await self._fetch(fetch, due)
                except ExceptionAnswer as refusal:
                    await self._tell_refusal(number, refusal)
                else:
                    self._tell_acceptance(number)
        finally:
            self.outbox.flush_soon()

    async def _fetch(self, fetch: Fetch, due: int) -> None:
        if fetch.gate is not None and not await self._is_raised(fetch.gate, due):
            return
        answer = await self._bus.transact(self._unit, fetch.request, self._tally, due=due)
        for part in fetch.parts:
            block = self._blocks[part.block]
            asked, octets = self._halves.get(part.block, (answer.asked, b""))
            octets += answer.pdu[part.start : part.stop]
            self._halves[part.block] = asked, octets
            if len(octets) == block.maker.size:
                entry = block.take(octets, answer, asked, self.outbox)
                if block.maker.block.is_clock and entry is not None and answer.asked is asked:
                    self._follow_clock(entry, answer)

    def _follow_clock(self, entry: Entry, answer: Answer) -> None:
        """The device's clock was read between request and answer."""
        if entry.publish_time != entry.log_time:
            self._clock_watch.note(entry.publish_time, answer.asked, answer.read)

    async def _is_raised(self, gate: ClearOnRead, due: int) -> bool:
        """Whether a flag that lies outside its block says that the block is to be read."""
        request = ReadRegisters(gate.table.read_function, gate.address, 1)
        answer = await self._bus.transact(self._unit, request, self._tally, due=due)
        return is_raised(gate, words(answer.pdu)[0])

    def close(self) -> None:
        for block in self._blocks:
            block.close(self.outbox)

    def _tell_given_up(self) -> None:
        lost = self.outbox.take_given_up()
        if lost is not None:
            first, last, count = lost
            self.outbox.add(self._blocks[0].maker.gap(first, last, count, Reason.STORAGE, last))

    async def _tell_refusal(self, number: int, refusal: ExceptionAnswer) -> None:
        if number not in self._refused:
            self._refused.add(number)
            why = await described(refusal, self._unit, self._bus, self._tally, self._dialect)
            text = f"{self._names(number)} refused, asked for all the same: {why}"
            self.outbox.event("warning", "refused", text)

    def _tell_acceptance(self, number: int) -> None:
        if number in self._refused:
            self._refused.discard(number)
            self.outbox.event("info", "refused", f"{self._names(number)} answered again")

    def _names(self, number: int) -> str:
        names = [self._blocks[part.block].maker.block.name for part in self._plan[number].parts]
        return f"block {' and '.join(names)}"

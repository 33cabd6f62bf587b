"""Blocks without a flag: read on schedule, each read a sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roclog.errors import ExceptionAnswer
from roclog.polling.request_plan import plan_requests
from roclog.samples import Reading
from roclog.schema import Origin, Reason

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Instant
    from roclog.outbox import Outbox
    from roclog.samples import SampleMaker


class CyclicBlock:
    """Numbers the samples of one block, and counts the reads between them that failed.

    period: nanoseconds between reads. seq: of the last sample of an earlier run.
    read_until: UTC ns at which an earlier run last read the block, 0 = never.
    """

    def __init__(self, maker: SampleMaker, period: int, seq: int = 0, read_until: int = 0) -> None:
        self.maker = maker
        self.seq = seq
        self._period = period
        self._read_until = read_until
        self._last: Instant | None = None

    def take(self, words: tuple[int, ...], asked: Instant, read: Instant, outbox: Outbox) -> None:
        """One read: what was missed before it, then its sample."""
        last = self._last
        if last is not None:
            missed = (read.monotonic - last.monotonic + self._period // 2) // self._period - 1
            if missed > 0:
                since = read.utc - (read.monotonic - last.monotonic)
                outbox.add(self.maker.gap(since, read.utc, missed, Reason.UNREAD, read.utc))
        elif self._read_until:
            since = min(self._read_until, read.utc)
            missed = (read.utc - since) // self._period
            outbox.add(self.maker.gap(since, read.utc, missed, Reason.DOWNTIME, read.utc))
        self._last = read
        self.seq += 1
        reading = Reading(words, asked, read, last.utc if last is not None else 0)
        outbox.add(self.maker.message(reading, self.seq, Origin.CYCLIC, self._carry(read)))

    def close(self, outbox: Outbox) -> None:
        """Let the next run know until when this one has read."""
        if self._last is not None:
            outbox.checkpoint(self.maker.topic, self._carry(self._last))

    def _carry(self, read: Instant) -> Mapping[str, object]:
        return {"epoch": self.maker.epoch.hex(), "seq": self.seq, "read_at": read.utc}


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
    ) -> None:
        self.period = period
        self.outbox = outbox
        self._unit = unit
        self._bus = bus
        self._tally = tally
        self._blocks = blocks
        self._plan = plan_requests([block.maker.block for block in blocks])
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
        octets: dict[int, bytes] = {}
        asked: dict[int, Instant] = {}
        try:
            for number, fetch in enumerate(self._plan):
                try:
                    answer = await self._bus.transact(
                        self._unit, fetch.request, self._tally, due=due
                    )
                except ExceptionAnswer as refusal:
                    self._tell_refusal(number, refusal)
                    continue
                self._tell_acceptance(number)
                for part in fetch.parts:
                    block = self._blocks[part.block]
                    first = asked.setdefault(part.block, answer.asked)
                    data = octets.get(part.block, b"") + answer.pdu[part.start : part.stop]
                    octets[part.block] = data
                    if len(data) == block.maker.size:
                        words = block.maker.words(data)
                        block.take(words, first, answer.read, self.outbox)
        finally:
            self.outbox.flush_soon()

    def close(self) -> None:
        for block in self._blocks:
            block.close(self.outbox)

    def _tell_given_up(self) -> None:
        lost = self.outbox.take_given_up()
        if lost is not None:
            first, last, count = lost
            self.outbox.add(self._blocks[0].maker.gap(first, last, count, Reason.STORAGE, last))

    def _tell_refusal(self, number: int, refusal: ExceptionAnswer) -> None:
        if number not in self._refused:
            self._refused.add(number)
            text = f"{self._names(number)} refused, asked for all the same: {refusal}"
            self.outbox.event("warning", "refused", text)

    def _tell_acceptance(self, number: int) -> None:
        if number in self._refused:
            self._refused.discard(number)
            self.outbox.event("info", "refused", f"{self._names(number)} answered again")

    def _names(self, number: int) -> str:
        names = [self._blocks[part.block].maker.block.name for part in self._plan[number].parts]
        return f"block {' and '.join(names)}"

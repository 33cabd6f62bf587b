"""Blocks without a flag that share a period: read on schedule, in as few requests as they allow."""

from __future__ import annotations

from collections import Counter as Counts
from typing import TYPE_CHECKING

from roclog.errors import DeviceError, ExceptionAnswer, NoAnswer, WrongAnswer
from roclog.modbus.dialect import STANDARD
from roclog.polling.refusal import described, is_refusal
from roclog.request_plan import flag_request, plan_requests
from roclog.triggers import is_raised

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.bus.bus import Answer, Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Instant
    from roclog.modbus.dialect import Dialect
    from roclog.outbox import Outbox
    from roclog.polling.clock_watch import ClockWatch
    from roclog.polling.cyclic_block import CyclicBlock
    from roclog.recording.entries import Entry
    from roclog.register_map import ClearOnRead
    from roclog.request_plan import Fetch


class CyclicBlocks:
    """All blocks of a device that share a period."""

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
        self._first = 0
        self._latest: int | None = None
        self._halves: dict[int, tuple[Instant, bytes]] = {}
        self._refused: set[int] = set()
        self._wrong: Counts[int] = Counts()

    @property
    def samples(self) -> int:
        return sum(block.seq for block in self._blocks)

    def expect(self, due: int) -> None:
        if self._latest is None:
            for block in self._blocks:
                block.begin(due)
        self._latest = due

    async def turn(self, due: int) -> None:
        """Read every block once; one that the device refuses keeps no other from being read.

        Nor does a function whose answer is wrong: its layout may be.

        Raises:
            DeviceError: no answer, or a wrong one and no right one; what was read before is kept,
                and the next turn begins behind it, so that it keeps no other from being read.
        """
        self.expect(due)
        self._halves.clear()
        trouble: WrongAnswer | None = None
        is_fine = False
        numbers, begin = range(len(self._plan)), self._first
        self._first = 0
        try:
            for number in (*numbers[begin:], *numbers[:begin]) if begin else numbers:
                try:
                    await self._fetch(self._plan[number], due)
                except ExceptionAnswer as refusal:
                    if not is_refusal(refusal):
                        self._first = self._behind(number)
                        raise
                    await self._tell_refusal(number, refusal)
                except WrongAnswer as wrong:
                    if not self._dialect.has_functions:
                        self._first = self._behind(number)
                        raise
                    self._tell_wrong(number, wrong)
                    trouble = wrong
                except DeviceError:
                    self._first = self._behind(number)
                    raise
                else:
                    self._tell_acceptance(number)
                    is_fine = True
        finally:
            self.outbox.flush_soon()
        if trouble is not None and not is_fine:
            raise trouble

    def _behind(self, number: int) -> int:
        """The next request of the plan that does not go on with a block, else the first one."""
        blocks = [{part.block for part in fetch.parts} for fetch in self._plan]
        later = range(number + 1, len(blocks))
        return next((n for n in later if not blocks[n] & blocks[n - 1]), 0)

    async def _fetch(self, fetch: Fetch, due: int) -> None:
        if fetch.gate is not None and not await self._is_raised(fetch, fetch.gate, due):
            return
        try:
            try:
                answer = await self._bus.transact(self._unit, fetch.request, self._tally, due=due)
            except NoAnswer:
                if not self._may_repeat(fetch):
                    raise
                answer = await self._bus.transact(self._unit, fetch.request, self._tally, due=due)
        except DeviceError as error:
            if not is_refusal(error):
                for part in fetch.parts:
                    self._blocks[part.block].lose()
            raise
        for part in fetch.parts:
            block = self._blocks[part.block]
            asked, octets = self._halves.get(part.block, (answer.asked, b""))
            octets += answer.pdu[part.start : part.stop]
            self._halves[part.block] = asked, octets
            if len(octets) == block.maker.size:
                entry = block.take(octets, answer, asked, self.outbox, due=due)
                if block.maker.block.is_clock and entry is not None and answer.asked is asked:
                    self._follow_clock(entry, answer)

    def _may_repeat(self, fetch: Fetch) -> bool:
        """Where the answer was lost: if the map allows it and its turn has time."""
        blocks = (self._blocks[part.block].maker.block for part in fetch.parts)
        has_time = 2 * self._bus.timing.timeout <= self.period
        return has_time and all(block.repeatable for block in blocks)

    def _follow_clock(self, entry: Entry, answer: Answer) -> None:
        """The device's clock was read between request and answer."""
        if entry.publish_time != entry.log_time:
            self._clock_watch.note(entry.publish_time, answer.asked, answer.read)

    async def _is_raised(self, fetch: Fetch, gate: ClearOnRead, due: int) -> bool:
        """Whether a flag that lies outside its block says that the block is to be read."""
        request = flag_request(gate)
        answer = await self._bus.transact(self._unit, request, self._tally, due=due)
        word = int.from_bytes(answer.pdu[len(request.head) :])
        if is_raised(gate, word & 1 if gate.table.has_bits else word):
            return True
        for part in fetch.parts:
            self._blocks[part.block].skip(answer, self.outbox, due=due)
        return False

    def close(self, now: Instant) -> None:
        if not self.outbox.empty or self._latest is None:
            return  # what waits says itself how far it goes, once it is on disk
        for block in self._blocks:
            block.close(self._latest, now, self.outbox)

    async def _tell_refusal(self, number: int, refusal: ExceptionAnswer) -> None:
        if number not in self._refused:
            self._refused.add(number)
            why = await described(refusal, self._unit, self._bus, self._tally, self._dialect)
            text = f"{self._names(number)} refused, asked for all the same: {why}"
            self.outbox.event("warning", "refused", text)

    def _tell_wrong(self, number: int, wrong: WrongAnswer) -> None:
        """A single one is counted only; the second in a row may be for ever."""
        self._wrong[number] += 1
        if self._wrong[number] == 2:
            text = f"{self._names(number)} answers in another shape than its layout: {wrong}"
            self.outbox.event("warning", "layout", text)

    def _tell_acceptance(self, number: int) -> None:
        if self._wrong.pop(number, 0) > 1:
            self.outbox.event("info", "layout", f"{self._names(number)} answered in its layout")
        if number in self._refused:
            self._refused.discard(number)
            self.outbox.event("info", "refused", f"{self._names(number)} answered again")

    def _names(self, number: int) -> str:
        blocks = [self._blocks[part.block].maker.block for part in self._plan[number].parts]
        if self._dialect.has_functions:
            return " and ".join(f"function {block.address} ({block.name})" for block in blocks)
        return f"block {' and '.join(block.name for block in blocks)}"

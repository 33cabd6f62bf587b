"""Blocks without a flag that share a period: read on schedule, in as few requests as they allow."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.errors import DeviceError, ExceptionAnswer, LinkDown, NoAnswer, WrongAnswer
from roclog.modbus.dialect import STANDARD
from roclog.polling.complaints import Complaints, Fault
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

_MOST_NAMES: Final = 3


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
        self._is_heard = False
        self._wrong: DeviceError | None = None
        self._complaints = Complaints(outbox, [self._names(n) for n in range(len(self._plan))])

    @property
    def name(self) -> str:
        names = [block.maker.block.name for block in self._blocks]
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        return ", ".join(names[:_MOST_NAMES]) + more

    @property
    def samples(self) -> int:
        return sum(block.seq for block in self._blocks)

    def expect(self, due: int) -> None:
        if self._latest is None:
            for block in self._blocks:
                block.begin(due)
        self._latest = due

    async def turn(self, due: int) -> None:
        """Read every block once; what goes wrong with one keeps no other from being read.

        A device that did not answer at all in the last turn is given one attempt. One that did may
        leave two requests unanswered in a row; the next turn begins behind them.

        Raises:
            DeviceError: it answered nothing, or nothing right; or the connection was lost, and what
                was read before is kept.
        """
        self.expect(due)
        self._halves.clear()
        numbers, begin = range(len(self._plan)), self._first
        self._first = 0
        was_heard, self._is_heard = self._is_heard, False
        self._wrong = None
        silent: dict[int, DeviceError] = {}
        lost: set[int] = set()
        in_a_row = 0
        try:
            for number in (*numbers[begin:], *numbers[:begin]) if begin else numbers:
                fetch = self._plan[number]
                if lost and all(part.block in lost for part in fetch.parts):
                    continue  # the rest of a block of which a part is lost is of no use
                error = await self._try(number, due)
                if error is None:
                    in_a_row = 0
                    continue
                lost.update(part.block for part in fetch.parts)
                silent[number] = error
                in_a_row += 1
                if in_a_row > 1 or not (was_heard or self._is_heard):
                    self._first = self._behind(number)
                    break
        finally:
            self.outbox.flush_soon()
        trouble = next(iter(silent.values()), self._wrong)
        if trouble is not None and not self._is_heard:
            raise trouble
        for number, error in silent.items():
            if self._complaints.is_due(number, Fault.SILENT):
                self._complaints.tell(number, Fault.SILENT, str(error))

    async def _try(self, number: int, due: int) -> DeviceError | None:
        """One request; returns the error where the device was not heard.

        Raises:
            LinkDown: as Bus.transact; the next turn begins behind this request.
        """
        try:
            await self._fetch(self._plan[number], due)
        except LinkDown:
            self._first = self._behind(number)
            raise
        except DeviceError as error:
            fault = self._fault(error)
            if fault is None:
                return error
            if fault is Fault.LAYOUT:
                self._wrong = error  # it is not yet said that the device itself is all right
            else:
                self._is_heard = True
            if self._complaints.is_due(number, fault):
                self._complaints.tell(number, fault, await self._described(error))
            return None
        self._is_heard = True
        self._complaints.end(number)
        return None

    def _fault(self, error: DeviceError) -> Fault | None:
        """What an answer is a fault of; None where it need not be the device's.

        Where registers are functions, the layout of one may be wrong; elsewhere an answer that does
        not fit may come from another unit of the line.
        """
        if is_refusal(error):
            return Fault.REFUSED
        is_wrong = isinstance(error, WrongAnswer) and self._dialect.has_functions
        return Fault.LAYOUT if is_wrong else None

    async def _described(self, error: DeviceError) -> str:
        if not isinstance(error, ExceptionAnswer):
            return str(error)
        return await described(error, self._unit, self._bus, self._tally, self._dialect)

    def _behind(self, number: int) -> int:
        """The next request of the plan that does not go on with a block, else the first one."""
        blocks = [{part.block for part in fetch.parts} for fetch in self._plan]
        later = range(number + 1, len(blocks))
        return next((n for n in later if not blocks[n] & blocks[n - 1]), 0)

    async def _fetch(self, fetch: Fetch, due: int) -> None:
        if fetch.gate is not None and not await self._is_raised(fetch, fetch.gate, due):
            return
        sent = self._tally.requests
        try:
            try:
                answer = await self._bus.transact(self._unit, fetch.request, self._tally, due=due)
            except NoAnswer:
                if not self._may_repeat(fetch):
                    raise
                answer = await self._bus.transact(self._unit, fetch.request, self._tally, due=due)
        except DeviceError as error:
            if self._tally.requests > sent and not is_refusal(error):
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

    def close(self, now: Instant, *, is_end: bool = True) -> None:
        """What waits for the disk says itself how far it goes, but for what was not read behind."""
        if self._latest is not None:
            for block in self._blocks:
                block.close(self._latest, now, self.outbox, is_end=is_end)

    def _names(self, number: int) -> str:
        blocks = [self._blocks[part.block].maker.block for part in self._plan[number].parts]
        if self._dialect.has_functions:
            return " and ".join(f"function {block.address} ({block.name})" for block in blocks)
        return f"block {' and '.join(block.name for block in blocks)}"

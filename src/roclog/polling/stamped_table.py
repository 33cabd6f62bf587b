"""Inputs that carry the time of their last change: every change of every input is a message."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.changes import Change, ChangeKind, ChangeMemory
from roclog.clock import Instant
from roclog.errors import DeviceError, ExceptionAnswer
from roclog.modbus.stamped import Layout, LayoutProbe, parse, plausible_layout, split
from roclog.polling.refusal import is_refusal
from roclog.schema import Reason
from roclog.stamps import StampDecoder, parse_zone
from roclog.stamps.decoder import TOLERANCE
from roclog.time_flags import TimeFlag, is_trusted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.bus.bus import Answer, Bus
    from roclog.bus.tally import Tally
    from roclog.modbus.request import ReadStamped
    from roclog.outbox import Outbox
    from roclog.polling.clock_watch import ClockWatch
    from roclog.recording.entries import Entry
    from roclog.register_map import StampedInputs, StampRules
    from roclog.stamped_messages import StampedMaker
    from roclog.stamps import Stamp

_DAY: Final = 86_400 * 10**9
_PROBED_PAIRS: Final = 8
_ENOUGH: Final = 500
"""Changes that are committed before the next request: an outbox holds 1000 messages, and a long
list that is read for the first time has more."""
_RESOLUTION: Final = 10**6
"""Nanoseconds: a stamp names the millisecond in which the event fell."""


def oldest_baseline(read_at: int) -> int:
    """UTC ns from which on a state is taken to be that was there at the first read."""
    return read_at - _DAY + 2 * TOLERANCE


def stamp_decoder(rules: StampRules) -> StampDecoder:
    """For the stamps of a device with these rules."""
    return StampDecoder(parse_zone(rules.zone), year_pivot=rules.year_pivot, lenient=rules.lenient)


class _Piece:
    """One request of a list, its last answer in this run, and when the turn with it was due."""

    def __init__(self, request: ReadStamped, layout: Layout | None) -> None:
        self.request = request
        self.layout = layout
        self.last: Answer | None = None
        self.due = 0


class StampedTable:
    """All lists of one table of a device.

    memory: the states on disk. read_until: UTC ns up to which an earlier run saw every input, 0 =
    none did.
    """

    def __init__(
        self,
        *,
        unit: int,
        bus: Bus,
        tally: Tally,
        lists: Sequence[StampedInputs],
        maker: StampedMaker,
        decoder: StampDecoder,
        memory: ChangeMemory,
        clock: ClockWatch,
        outbox: Outbox,
        period: int,
        read_until: int,
    ) -> None:
        self.period = period
        self.outbox = outbox
        self._unit = unit
        self._bus = bus
        self._tally = tally
        self._maker = maker
        self._decoder = decoder
        self._memory = memory
        self._clock = clock
        self._read_until = read_until
        self._waiting: dict[int, tuple[Entry, Change]] = {}
        self._refused: set[ReadStamped] = set()
        self._spare_bits_told = False
        self._blind: tuple[int, int, Reason] | None = None
        self._unprobed = [inputs for inputs in lists if inputs.layout is None]
        self._pieces = [
            _Piece(request, inputs.layout)
            for inputs in lists
            for request in split(inputs.mei, inputs.address, inputs.count)
        ]
        self._first = self._began = self._latest = 0
        outbox.on_give_up = self._forget

    @property
    def name(self) -> str:
        return self._maker.block

    @property
    def samples(self) -> int:
        return self._maker.seq

    def expect(self, due: int) -> None:
        if not self._latest:
            self._began = due
            for piece in self._pieces:
                piece.due = due - self.period
        self._latest = due

    async def turn(self, due: int) -> None:
        """Read every list once.

        Raises:
            DeviceError: no answer, or a wrong one; the inputs read before it are kept, and the next
                turn begins behind it, so that it keeps no other from being read.
        """
        self.expect(due)
        while self._unprobed:
            await self._probe(self._unprobed[0], due)
            del self._unprobed[0]
        begin, self._first = self._first, 0
        try:
            for piece in (*self._pieces[begin:], *self._pieces[:begin]):
                try:
                    await self._read(piece, due)
                except DeviceError as error:
                    if not is_refusal(error):
                        self._first = self._pieces.index(piece) + 1
                        raise
                    self._tell_refusal(piece.request, error)
                if len(self._waiting) >= _ENOUGH:
                    await self._commit()
        finally:
            self._tell_blind()
            await self._commit()

    def close(self, now: Instant, *, is_end: bool = True) -> None:
        """A list that is refused all the time is told as that, and makes not the table blind."""
        del is_end  # nothing is counted
        for piece in self._pieces:
            is_known = piece.last is not None or piece.request not in self._refused
            if piece.due < self._latest and is_known:
                self._find_blind(piece.last, now)
        if self._blind is not None:
            gap = self._maker.gap(*self._blind)
            carry = self._maker.carry(self._memory, now.utc)
            self.outbox.add(gap._replace(carry=carry, carry_topic=self._maker.topic))
        elif any(piece.last for piece in self._pieces) and self.outbox.empty:
            carry = self._maker.carry(self._memory, self._seen_until())
            self.outbox.checkpoint(self._maker.topic, carry)

    async def _read(self, piece: _Piece, due: int) -> None:
        answer = await self._bus.transact(self._unit, piece.request, self._tally, due=due)
        self._tell_acceptance(piece.request)
        piece.due = due
        if self._was_blind(piece.last, answer.read):
            self._find_blind(piece.last, answer.read)
        self._take(piece, answer)

    def _take(self, piece: _Piece, answer: Answer) -> None:
        last, piece.last = piece.last, answer
        layout, ambiguous = self._layout(piece, answer)
        seen = parse(piece.request, answer.pdu, layout)
        since = None if last is None else _utc(last.asked, answer.read)

        def resolve(octets: bytes, kind: ChangeKind) -> tuple[int, int]:
            stamp = self._resolve(octets, kind, since, answer.read.utc)
            if ambiguous:
                stamp = stamp.marked(TimeFlag.LAYOUT_AMBIGUOUS)
            return stamp.device_time, int(stamp.flags)

        if seen.spare_bits and not self._spare_bits_told:
            self._spare_bits_told = True
            text = f"{_named(piece.request)}: status bits behind the last input are set"
            self.outbox.event("warning", "spare-bits", text)
        for point in seen.points:
            change = self._memory.judge(point.address, point.value, point.stamp, resolve)
            if change is not None:
                self._record(change, answer, since)
                self._follow_clock(change, last, answer.read)

    def _resolve(self, octets: bytes, kind: ChangeKind, since: int | None, read_at: int) -> Stamp:
        """A baseline without a date is taken for one of the last 24 hours, and is marked."""
        if kind is ChangeKind.BASELINE or since is None:
            since = oldest_baseline(read_at)
        return self._decoder.decode(octets, read_at=read_at, changed_after=since)

    def _record(self, change: Change, answer: Answer, since: int | None) -> None:
        entry = self._maker.message(change, answer, since or 0)
        self._memory.keep(change)
        self._waiting[id(entry)] = entry, change
        self.outbox.add(entry)

    def _follow_clock(self, change: Change, last: Answer | None, read: Instant) -> None:
        """What changed since the last read was stamped since that was asked for."""
        fresh = change.kind in (ChangeKind.CHANGED, ChangeKind.RESTAMPED)
        if last is not None and fresh and change.state.device_time:
            asked = last.asked
            earliest = Instant(asked.utc - _RESOLUTION, asked.monotonic - _RESOLUTION)
            self._clock.note(change.state.device_time, earliest, read)

    async def _commit(self) -> None:
        self._maker.update(self._memory, self._seen_until())
        if await self.outbox.flush():
            for _, change in self._waiting.values():
                self._memory.committed(change)
            self._waiting.clear()

    def _seen_until(self) -> int:
        """UTC ns up to which every input that can be read has been seen; 0 = none was ever."""
        wanted = [piece for piece in self._pieces if piece.request not in self._refused]
        read = [piece.last.asked.utc for piece in wanted if piece.last is not None]
        if self._read_until and len(read) < len(wanted):
            return self._read_until
        return min(read, default=self._read_until)

    def _forget(self, entry: Entry) -> None:
        """A change that the disk did not take in time: the next read shows that input again."""
        _, change = self._waiting.pop(id(entry), (entry, None))
        if change is not None:
            self._memory.give_up(change)

    def _was_blind(self, last: Answer | None, read: Instant) -> bool:
        """Whether nobody looked for longer than a period, or in another run."""
        if last is not None:
            return read.monotonic - last.read.monotonic > 1.5 * self.period
        return self._read_until > 0 or read.monotonic - self._began >= self.period

    def _find_blind(self, last: Answer | None, until: Instant) -> None:
        """Of what changed more than once while nobody read, only the last state is known."""
        if last is not None:
            since, reason = _utc(last.asked, until), Reason.UNREAD
        elif self._read_until:
            since, reason = min(self._read_until, until.utc), Reason.DOWNTIME
        else:
            since, reason = until.utc - (until.monotonic - self._began), Reason.UNREAD
        if self._blind is not None:
            since = min(since, self._blind[0])
            reason = self._blind[2]
        self._blind = since, until.utc, reason

    def _tell_blind(self) -> None:
        """One gap for all lists of a turn."""
        if self._blind is not None:
            self.outbox.add(self._maker.gap(*self._blind))
            self._blind = None

    def _layout(self, piece: _Piece, answer: Answer) -> tuple[Layout, bool]:
        """How to read an answer, and whether that is a guess."""
        if piece.layout is not None or piece.request.mei.is_discrete:
            return piece.layout or Layout.INTERLEAVED, False
        read_at = answer.read.utc

        def is_plausible(octets: bytes) -> bool:
            stamp = self._resolve(octets, ChangeKind.BASELINE, None, read_at)
            return is_trusted(int(stamp.flags)) and not stamp.flags & TimeFlag.FUTURE

        found = plausible_layout(piece.request, answer.pdu, is_plausible)
        if found is not None:
            return found, False
        return Layout.INTERLEAVED, piece.request.count > 1

    async def _probe(self, inputs: StampedInputs, due: int) -> None:
        """Ask the device for its layout, once."""
        addresses = range(inputs.address, inputs.address + max(1, inputs.count - 1))
        probe = LayoutProbe(inputs.mei, addresses[:_PROBED_PAIRS])
        while (request := probe.request) is not None:
            try:
                answer = await self._bus.transact(self._unit, request, self._tally, due=due)
            except ExceptionAnswer as refusal:
                if not is_refusal(refusal):
                    raise
                probe.skip()
            else:
                probe.take(answer.pdu)
        what = f"{inputs.count} {inputs.table} from {inputs.address} on"
        if probe.layout is None:
            text = f"the layout of {what} cannot be told by asking; each answer is judged by itself"
            self.outbox.event("warning", "layout", text)
            return
        self.outbox.event("info", "layout", f"the layout of {what} is {probe.layout}")
        end = inputs.address + inputs.count
        for piece in self._pieces:
            if piece.request.mei is inputs.mei and inputs.address <= piece.request.address < end:
                piece.layout = probe.layout

    def _tell_refusal(self, request: ReadStamped, refusal: DeviceError) -> None:
        if request not in self._refused:
            self._refused.add(request)
            text = f"{_named(request)} refused, asked for all the same: {refusal}"
            self.outbox.event("warning", "refused", text)

    def _tell_acceptance(self, request: ReadStamped) -> None:
        if request in self._refused:
            self._refused.discard(request)
            self.outbox.event("info", "refused", f"{_named(request)} answered again")


def _utc(past: Instant, now: Instant) -> int:
    """UTC ns of an earlier instant by the wall clock of now, whatever was set in between."""
    return now.utc - (now.monotonic - past.monotonic)


def _named(request: ReadStamped) -> str:
    last = request.address + request.count - 1
    return f"MEI type 0x{request.mei:02X}, inputs {request.address} to {last}"

"""The bus: one transaction at a time, and nothing sent while an old answer may still come.

On a serial line an answer carries no number. So after a time-out the line stays silent until the
late answer came or could no longer come; an answer that arrives in that time can only belong to the
one request that is out, and is used. Before every frame the line is silent for the time the slowest
rule of its devices asks. The same holds for a line behind a gateway that hands RTU frames over TCP.
With MBAP answers carry a number, so late ones are told apart and dropped.
"""

from __future__ import annotations

import asyncio
import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.bus.link import LineErrors
from roclog.bus.timing import Framing
from roclog.bus.turns import Turns
from roclog.errors import (
    DeviceError,
    ExceptionAnswer,
    LinkDown,
    NoAnswer,
    WriteRefused,
    WrongAnswer,
)
from roclog.modbus.mbap import DatagramExchange, MbapExchange, MbapStream, whole_frame
from roclog.modbus.request import check_answer, is_read
from roclog.modbus.rtu import Echo, RtuExchange

if TYPE_CHECKING:
    from collections.abc import Callable

    from roclog.bus.link import Link
    from roclog.bus.tally import Tally
    from roclog.bus.timing import Timing
    from roclog.clock import Clock, Instant
    from roclog.modbus.request import Request

    Exchange = RtuExchange | MbapExchange
    Heard = tuple[bytes, Instant, Instant]

_WRITE_REGISTER: Final = 6
_SPOILED: Final = 50_000_000
"""Nanoseconds of silence after a damaged answer; longer than any adapter holds octets back."""
_TIMER_STEP: Final = 1_000_000
_FIRST_RETRY: Final = 100_000_000
_LAST_RETRY: Final = 2_000_000_000
"""Nanoseconds between attempts to open a link: doubling until an answer comes over it."""


class TooLate(DeviceError):
    """The bus was busy until after ``not_after``; nothing was sent."""


class Answer(NamedTuple):
    """A checked normal answer and the instants of its transaction.

    asked: just before the first octet of the request was handed to the line.
    began, read: when the first and the last octet of the answer were handed over.
    """

    pdu: bytes
    asked: Instant
    began: Instant
    read: Instant


class Bus:
    """All transactions of one connection.

    permitted: the only writes that may leave, as (unit, address, value).
    devices: how many share the connection. failing: names of those that do not answer at present.
    on_open: called each time the link was opened. openings: how often that was.
    expects_silence: many units are asked that are not there, which tells nothing of the connection.
    late_units: then, with TCP and UDP, of whom an answer came too late.
    """

    def __init__(
        self,
        link: Link,
        timing: Timing,
        clock: Clock,
        permitted: frozenset[tuple[int, int, int]],
        devices: int = 1,
    ) -> None:
        self.link = link
        self.timing = timing
        self.devices = devices
        self.failing: set[str] = set()
        self.expects_silence = False
        self.late_units: list[int] = []
        self.echo = Echo.UNKNOWN
        self._clock = clock
        self._permitted = permitted
        self._turns = Turns()
        self.openings = 0
        self._opened = False
        self._trouble = ""
        self._retry_after = 0
        self._retry_delay = _FIRST_RETRY
        self._quiet_since = 0
        self._owed_until = 0
        self._heard: list[tuple[int, Instant]] = []
        self._octets = 0
        self._line_errors = LineErrors()
        self.on_open: Callable[[], None] | None = None
        self._transaction = 0
        self._stream = MbapStream(self.timing.dialect)
        self._exchange: Exchange | None = None
        self._waiter: asyncio.Future[Heard] | None = None
        self._stray = self._stale = self._losses = 0
        self._timed_out = False
        self._alarm: asyncio.TimerHandle

    async def transact(
        self,
        unit: int,
        request: Request,
        tally: Tally,
        *,
        due: int = 0,
        not_after: int | None = None,
    ) -> Answer:
        """Send one request when its turn comes and return its checked answer.

        due: monotonic nanoseconds; of those who wait the one due first is next.
        not_after: monotonic nanoseconds; if the turn comes later, nothing is sent.

        Raises:
            WriteRefused: not a read, and not a write that is permitted here; nothing was sent.
            TooLate, LinkDown, NoAnswer, WrongAnswer, ExceptionAnswer.
        """
        self._check_permitted(unit, request.pdu)
        await self._turns.take(due)
        try:
            if not self._opened:
                await self._open()
            if self.timing.framing is Framing.RTU:
                await self._wait_for_line()
            if not_after is not None and self._now() > not_after:
                raise TooLate(f"{self.link.name} was busy")
            return await self._exchange_once(unit, request, tally)
        finally:
            self._settle(tally)
            self._turns.release()

    @property
    def is_open(self) -> bool:
        """Whoever answered last is still connected, for all that is known."""
        return self._opened

    @property
    def has_queue(self) -> bool:
        """Somebody waits for the connection."""
        return self._turns.has_queue

    def close(self) -> None:
        """Close the link; a later transaction opens it again."""
        self.link.close()
        self._opened = False
        self._fail_waiter("closed")

    def _now(self) -> int:
        return self._clock.now().monotonic

    def _check_permitted(self, unit: int, pdu: bytes) -> None:
        """Judges the octets that would leave, whatever the request calls itself."""
        if is_read(pdu):
            return
        what = f"function {pdu[0]}"
        if pdu[0] == _WRITE_REGISTER and len(pdu) == 5:
            address, value = struct.unpack(">HH", pdu[1:])
            if (unit, address, value) in self._permitted:
                return
            what = f"writing {value} to register {address}"
        raise WriteRefused(f"{self.link.name} unit {unit}: {what} is not permitted here")

    async def _open(self) -> None:
        if self._now() < self._retry_after:
            raise LinkDown(f"{self.link.name} is not open, next attempt soon: {self._trouble}")
        self.echo = Echo.UNKNOWN
        self._stream = MbapStream(self.timing.dialect)
        try:
            await self.link.open(self._receive, self._lost)
        except OSError as error:
            self._losses += 1
            self._trouble = _reason(error)
            raise LinkDown(f"{self.link.name} cannot be opened: {self._trouble}") from error
        finally:
            self._retry_after = self._now() + self._retry_delay
            self._retry_delay = min(2 * self._retry_delay, _LAST_RETRY)
        self._opened = True
        self.openings += 1
        if self.on_open is not None:
            self.on_open()
        self._quiet_since = max(self._quiet_since, self._now())

    async def _wait_for_line(self) -> None:
        """Until no old answer can come any more and the line has been silent long enough."""
        await self._sleep_until(self._owed_until)
        limit = self._now() + self.timing.late_answer + self.timing.silence
        while self._now() < (free := self._quiet_since + self.timing.silence):
            if self._now() > limit:
                raise NoAnswer(f"{self.link.name}: the line is never silent, nothing was sent")
            await self._sleep_until(free)
        if not self._opened:
            raise LinkDown(f"{self.link.name} was lost: {self._trouble}")

    async def _sleep_until(self, instant: int) -> None:
        """The loop's timers tell milliseconds apart, and round up: a third of the silence."""
        while (left := instant - self._now()) > 0:
            if left > _TIMER_STEP:
                await asyncio.sleep((left - _TIMER_STEP) / 1e9)
            else:
                self._clock.pause(left)

    async def _exchange_once(self, unit: int, request: Request, tally: Tally) -> Answer:
        exchange = self._new_exchange(unit, request)
        asked = self._clock.now()
        sent = asked.monotonic + len(exchange.adu) * self.timing.character
        self._quiet_since = max(self._quiet_since, sent)
        if self.timing.framing is Framing.RTU:
            latest = asked.monotonic + self.timing.late_answer
            self._owed_until = max(latest, sent + self.timing.timeout)
        waiter = asyncio.get_running_loop().create_future()
        self._exchange, self._waiter = exchange, waiter
        self._heard.clear()
        self._octets = 0
        try:
            self.link.send(exchange.adu)
        except OSError as error:
            self._exchange = self._waiter = None
            self._give_up(_reason(error))
            raise LinkDown(f"{self.link.name}: {_reason(error)}") from error
        tally.requests += 1
        try:
            pdu, began, read = await self._wait_for_answer(waiter, sent, tally)
            check_answer(request, pdu)
        except ExceptionAnswer as refusal:
            tally.count_exception(refusal.code)
            raise
        except WrongAnswer:
            tally.wrong_answers += 1
            raise
        except NoAnswer as silence:
            if self.link.is_deaf and not self.expects_silence:
                self._give_up("nothing came back over the connection")
            raise self._explain(exchange, silence, tally) from None
        finally:
            tally.busy += self._now() - asked.monotonic
        tally.count_answer(read.monotonic - asked.monotonic)
        return Answer(pdu, asked, began, read)

    async def _wait_for_answer(
        self, waiter: asyncio.Future[Heard], sent: int, tally: Tally
    ) -> Heard:
        self._timed_out = False
        self._set_alarm(sent + self.timing.timeout, self._time_out)
        try:
            heard = await waiter
        finally:
            self._alarm.cancel()
            tally.timeouts += self._timed_out
        tally.late_answers += self._timed_out
        return heard

    def _set_alarm(self, instant: int, action: Callable[[], None]) -> None:
        left = (instant - self._now()) / 1e9
        self._alarm = asyncio.get_running_loop().call_later(left, action)

    def _time_out(self) -> None:
        """No answer in time; where it carries no number it is waited for all the same."""
        self._timed_out = True
        if self._owed_until > self._now():
            self._set_alarm(self._owed_until, self._end_wait)
        else:
            self._end_wait()

    def _end_wait(self) -> None:
        waiter, exchange = self._waiter, self._exchange
        if waiter is None or waiter.done():
            return
        pdu = exchange.conclude() if isinstance(exchange, RtuExchange) else None
        if pdu is not None and exchange is not None:
            waiter.set_result((pdu, self._began(exchange), self._heard[-1][1]))
        else:
            limit = f"{self.timing.timeout / 1e6:g} ms"
            waiter.set_exception(NoAnswer(f"{self.link.name}: no answer within {limit}"))

    def _new_exchange(self, unit: int, request: Request) -> Exchange:
        if self.timing.framing is Framing.RTU:
            return RtuExchange(unit, request, self.echo)
        self._transaction = self._transaction % 0xFFFF + 1
        if self.timing.framing is Framing.MBAP_DATAGRAM:
            return DatagramExchange(unit, request, self._transaction, self.timing.dialect)
        return MbapExchange(unit, request, self._transaction, self._stream)

    def _settle(self, tally: Tally) -> None:
        """The transaction is over, however it ended."""
        exchange, self._exchange, self._waiter = self._exchange, None, None
        if isinstance(exchange, RtuExchange):
            self.echo = exchange.echo
            tally.discarded_octets += len(exchange.leftover)
        elif exchange is not None:
            tally.late_answers += exchange.stale
            self._note_late(exchange.stale_units)
        tally.discarded_octets += self._stray
        tally.late_answers += self._stale
        tally.link_losses += self._losses
        self._count_line_errors(tally)
        self._stray = self._stale = self._losses = 0

    def _count_line_errors(self, tally: Tally) -> None:
        now, before = self.link.line_errors(), self._line_errors
        if now is None or now == before:
            return
        self._line_errors = now
        tally.frame_errors += now.frame - before.frame
        tally.parity_errors += now.parity - before.parity
        tally.overruns += now.overrun - before.overrun
        tally.breaks += now.breaks - before.breaks

    def _receive(self, octets: bytes) -> None:
        now = self._clock.now()
        self._quiet_since = max(self._quiet_since, now.monotonic)
        before, self._octets = self._octets, self._octets + len(octets)
        exchange, waiter = self._exchange, self._waiter
        try:
            if exchange is None or waiter is None or waiter.done():
                self._discard(octets)
                return
            self._heard.append((before, now))
            pdu = exchange.feed(octets)
        except LinkDown as error:
            self._give_up(str(error))
        except Exception as error:  # noqa: BLE001 - raised where the answer is waited for
            if waiter is not None:
                waiter.set_exception(error)
        else:
            if pdu is not None:
                self._owed_until = self._retry_after = 0
                self._retry_delay = _FIRST_RETRY
                waiter.set_result((pdu, self._began(exchange), now))
            elif isinstance(exchange, RtuExchange) and exchange.spoiled:
                loop = asyncio.get_running_loop()
                loop.call_later(_SPOILED / 1e9, self._call_off, exchange, self._octets)

    def _began(self, exchange: Exchange) -> Instant:
        """When the octet arrived with which the answer begins."""
        return next(at for before, at in reversed(self._heard) if before <= exchange.answer_start)

    def _call_off(self, exchange: Exchange, heard: int) -> None:
        """A damaged answer came and nothing behind it: no other will."""
        waiter = self._waiter
        same = exchange is self._exchange and heard == self._octets
        if same and waiter is not None and not waiter.done():
            self._owed_until = 0
            waiter.set_exception(NoAnswer(f"{self.link.name}: the answer was damaged"))

    def _discard(self, octets: bytes) -> None:
        """Nobody waits for this: noise on a serial line, late answers and copies with MBAP."""
        framing, dialect = self.timing.framing, self.timing.dialect
        frame = whole_frame(octets, dialect) if framing is Framing.MBAP_DATAGRAM else None
        if frame is not None:
            self._stale += 1
            self._note_late([frame.unit])
            return
        if framing is not Framing.MBAP_STREAM:
            self._stray += len(octets)
            return
        self._stream.receive(octets)
        while (frame := self._stream.next_frame()) is not None:
            self._stale += 1
            self._note_late([frame.unit])

    def _note_late(self, units: list[int]) -> None:
        if self.expects_silence:
            self.late_units += units

    def _lost(self, reason: str) -> None:
        self._opened = False
        self._losses += 1
        self._trouble = reason
        self._fail_waiter(reason)

    def _give_up(self, reason: str) -> None:
        self.link.close()
        self._lost(reason)

    def _fail_waiter(self, reason: str) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_exception(LinkDown(f"{self.link.name}: {reason}"))

    def _explain(self, exchange: Exchange, silence: NoAnswer, tally: Tally) -> DeviceError:
        if isinstance(exchange, MbapExchange) or not exchange.leftover:
            return silence
        octets = exchange.leftover
        if exchange.intact_stranger:
            tally.wrong_answers += 1
            return WrongAnswer(f"{self.link.name}: an answer to something else", octets)
        tally.crc_errors += 1
        return NoAnswer(f"{silence}; octets {octets[:64].hex(' ')}")


def _reason(error: OSError) -> str:
    return error.strerror or str(error)

"""The bus: one transaction at a time, and nothing sent while an old answer may still come.

On a serial line an answer carries no number. So after a time-out the line stays silent until the
late answer came or could no longer come; an answer that arrives in that time can only belong to the
one request that is out, and is used. Before every frame the line is silent for the time the slowest
rule of its devices asks. TCP answers carry a number, so late ones are told apart and dropped.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from roclog.errors import (
    DeviceError,
    ExceptionAnswer,
    LinkDown,
    NoAnswer,
    WriteRefused,
    WrongAnswer,
)
from roclog.modbus.mbap import MbapExchange
from roclog.modbus.request import WriteRegister, check_answer
from roclog.modbus.rtu import Echo, RtuExchange

if TYPE_CHECKING:
    from roclog.bus.link import Link
    from roclog.bus.tally import Tally
    from roclog.clock import Clock, Instant
    from roclog.modbus.request import Request

_FIRST_RETRY: Final = 100_000_000
_LAST_RETRY: Final = 2_000_000_000
"""Nanoseconds between attempts to open a link: doubling from the first to the last."""


class TooLate(DeviceError):
    """The bus was busy until after ``not_after``; nothing was sent."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A checked normal answer and the instants of its transaction.

    asked: just before the first octet of the request was handed to the line.
    read: when the last octet of the answer was handed over.
    """

    pdu: bytes
    asked: Instant
    read: Instant


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Rules of one connection, nanoseconds.

    timeout: for an answer to begin and end, from the end of the request.
    late_answer: from the start of the request until its answer can no longer come; None where
    answers are numbered.
    silence: before every frame. character: duration of one on the wire; both 0 on TCP.
    """

    timeout: int
    late_answer: int | None = None
    silence: int = 0
    character: int = 0


class Bus:
    """All transactions of one connection.

    permitted: the only writes that may leave, as (unit, address, value).
    """

    def __init__(
        self, link: Link, timing: Timing, clock: Clock, permitted: frozenset[tuple[int, int, int]]
    ) -> None:
        self.link = link
        self.timing = timing
        self.echo = Echo.UNKNOWN
        self._clock = clock
        self._permitted = permitted
        self._turn = asyncio.Lock()
        self._opened = False
        self._retry_after = 0
        self._retry_delay = _FIRST_RETRY
        self._quiet_since = 0
        self._transaction = 0
        self._exchange: RtuExchange | MbapExchange | None = None
        self._waiter: asyncio.Future[tuple[bytes, Instant]] | None = None
        self._stray = 0

    async def transact(
        self, unit: int, request: Request, tally: Tally, *, not_after: int | None = None
    ) -> Answer:
        """Send one request when its turn comes and return its checked answer.

        not_after: monotonic nanoseconds; if the turn comes later, nothing is sent.

        Raises:
            WriteRefused: a write that is not permitted here; nothing was sent.
            TooLate, LinkDown, NoAnswer, WrongAnswer, ExceptionAnswer.
        """
        if isinstance(request, WriteRegister):
            self._check_write(unit, request)
        async with self._turn:
            await self._ensure_open(tally)
            await self._wait_for_silence()
            if not_after is not None and self._clock.now().monotonic > not_after:
                raise TooLate(f"{self.link.name} was busy")
            started = self._clock.now().monotonic
            try:
                return await self._exchange_once(unit, request, tally)
            finally:
                self._exchange = None
                self._waiter = None
                tally.busy += self._clock.now().monotonic - started
                tally.discarded_octets += self._stray
                self._stray = 0

    def close(self) -> None:
        """Close the link; a later transaction opens it again."""
        self._opened = False
        self.link.close()

    def _check_write(self, unit: int, request: WriteRegister) -> None:
        if (unit, request.address, request.value) not in self._permitted:
            raise WriteRefused(
                f"{self.link.name} unit {unit}: writing {request.value} to register "
                f"{request.address} is not the profile's acknowledgement"
            )

    async def _ensure_open(self, tally: Tally) -> None:
        if self._opened:
            return
        if self._clock.now().monotonic < self._retry_after:
            raise LinkDown(f"{self.link.name} is not open, next attempt soon")
        try:
            await self.link.open(self._receive, self._lost)
        except OSError as error:
            tally.link_losses += 1
            self._retry_after = self._clock.now().monotonic + self._retry_delay
            self._retry_delay = min(2 * self._retry_delay, _LAST_RETRY)
            raise LinkDown(f"{self.link.name} cannot be opened: {_reason(error)}") from error
        self._opened = True
        self._retry_delay = _FIRST_RETRY
        self._quiet_since = self._clock.now().monotonic

    async def _wait_for_silence(self) -> None:
        limit = self._clock.now().monotonic + (self.timing.late_answer or 0)
        while (now := self._clock.now().monotonic) < self._quiet_since + self.timing.silence:
            if now > limit:
                raise NoAnswer(f"{self.link.name}: the line is never silent")
            await asyncio.sleep((self._quiet_since + self.timing.silence - now) / 1e9)
        if not self._opened:
            raise LinkDown(f"{self.link.name} was lost")

    async def _exchange_once(self, unit: int, request: Request, tally: Tally) -> Answer:
        exchange = self._new_exchange(unit, request)
        waiter = asyncio.get_running_loop().create_future()
        self._exchange, self._waiter = exchange, waiter
        asked = self._clock.now()
        tally.requests += 1
        try:
            self.link.send(exchange.adu)
        except OSError as error:
            self._drop(tally)
            raise LinkDown(f"{self.link.name}: {_reason(error)}") from error
        sent = asked.monotonic + len(exchange.adu) * self.timing.character
        self._quiet_since = max(self._quiet_since, sent)
        try:
            pdu, read = await self._wait_for_answer(waiter, asked, sent, tally)
            check_answer(request, pdu)
        except LinkDown:
            self._drop(tally)
            raise
        except ExceptionAnswer as refusal:
            tally.count_exception(refusal.code)
            raise
        except WrongAnswer:
            tally.wrong_answers += 1
            raise
        except NoAnswer as silence:
            raise self._explain(exchange, silence, tally) from None
        finally:
            if isinstance(exchange, RtuExchange):
                self.echo = exchange.echo
                tally.discarded_octets += len(exchange.leftover)
        tally.count_answer(read.monotonic - asked.monotonic)
        return Answer(pdu, asked, read)

    async def _wait_for_answer(
        self, waiter: asyncio.Future[tuple[bytes, Instant]], asked: Instant, sent: int, tally: Tally
    ) -> tuple[bytes, Instant]:
        deadline = sent + self.timing.timeout
        if await self._wait(waiter, deadline):
            return waiter.result()
        tally.timeouts += 1
        if self.timing.late_answer is not None:
            latest = max(deadline, asked.monotonic + self.timing.late_answer)
            if await self._wait(waiter, latest):
                tally.late_answers += 1
                return waiter.result()
        raise NoAnswer(f"{self.link.name}: no answer within {self.timing.timeout / 1e6:g} ms")

    async def _wait(self, waiter: asyncio.Future[tuple[bytes, Instant]], deadline: int) -> bool:
        left = deadline - self._clock.now().monotonic
        if not waiter.done() and left > 0:
            await asyncio.wait((waiter,), timeout=left / 1e9)
        return waiter.done()

    def _new_exchange(self, unit: int, request: Request) -> RtuExchange | MbapExchange:
        if self.timing.late_answer is not None:
            return RtuExchange(unit, request, self.echo)
        self._transaction = self._transaction % 0xFFFF + 1
        return MbapExchange(unit, request, self._transaction)

    def _receive(self, octets: bytes) -> None:
        now = self._clock.now()
        self._quiet_since = max(self._quiet_since, now.monotonic)
        exchange, waiter = self._exchange, self._waiter
        if exchange is None or waiter is None or waiter.done():
            self._stray += len(octets)
            return
        try:
            pdu = exchange.feed(octets)
        except DeviceError as error:
            waiter.set_exception(error)
            return
        if pdu is not None:
            waiter.set_result((pdu, now))
        elif isinstance(exchange, RtuExchange) and exchange.damaged:
            waiter.set_exception(NoAnswer(f"{self.link.name}: the answer was damaged"))

    def _lost(self, reason: str) -> None:
        self._opened = False
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_exception(LinkDown(f"{self.link.name}: {reason}"))

    def _drop(self, tally: Tally) -> None:
        tally.link_losses += 1
        self.close()

    def _explain(
        self, exchange: RtuExchange | MbapExchange, silence: NoAnswer, tally: Tally
    ) -> DeviceError:
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

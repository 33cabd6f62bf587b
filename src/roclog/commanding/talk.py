"""One device on a connection of its own: who it is, what it is set to, and single writes."""

from __future__ import annotations

import asyncio
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.bus.tally import Tally
from roclog.commanding.settings import differences, setting_block
from roclog.connect import make_bus
from roclog.errors import (
    GATEWAY_CODES,
    DeviceError,
    ExceptionAnswer,
    LinkDown,
    NoAnswer,
    RoclogError,
    WrongAnswer,
)
from roclog.modbus.request import WriteRegister
from roclog.polling.refusal import described
from roclog.request_plan import place_of, read_request
from roclog.word_types import block_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.register_map import Block, RegisterMap

BEFORE: Final = 2 * 10**9
"""Nanoseconds for which a device that does not answer is asked again before anything is written."""
_ATTEMPTS: Final = 3
"""How often at least, where a time-out is long: one lost datagram is no silent device."""
_PAUSE: Final = 0.2
"""Seconds between two attempts to read."""
_NO_RESPONSE: Final = 11
"""Exception of a gateway, V1.1b3 section 7: it has passed the request on, and nobody answered."""
_PASSING: Final = frozenset({4, 5, 6, 8}) | GATEWAY_CODES
"""Exceptions that may be over a moment later; all others are the device's answer."""


class NotDone(RoclogError):
    """The device answers, and did not do what it was told, or is not what people were shown."""


class ReadRefused(ExceptionAnswer):
    """The device refused to read. text: with the block, and what the device says of it."""

    def __init__(self, refusal: ExceptionAnswer, text: str) -> None:
        super().__init__(refusal.function, refusal.code)
        self._text = text

    def __str__(self) -> str:
        return self._text


class Target(NamedTuple):
    """A device of a configuration."""

    settings: Settings
    device: Device
    clock: Clock


@dataclass(frozen=True, slots=True)
class State:
    """What a device said of itself. unit: to which it answered. at: monotonic nanoseconds.

    identity: words of the blocks that say who it is. words: of the block of settings.
    """

    unit: int
    identity: tuple[tuple[int, ...], ...]
    words: tuple[int, ...]
    at: int


def identity_blocks(register_map: RegisterMap) -> list[Block]:
    """The blocks that say who the device is."""
    names = dict.fromkeys(block for block, _ in register_map.identity)
    return [register_map.block(name) for name in names]


async def read_identity(target: Target) -> list[tuple[int, ...]]:
    """Words of the blocks of ``identity_blocks``. A function is not called a second time.

    Raises:
        DeviceError: the device does not answer, or not with them.
    """
    profile, unit = target.device.profile, target.device.unit
    blocks = identity_blocks(profile)
    once = profile.dialect.has_functions
    patience, attempts = (0, 1) if once else (BEFORE, _ATTEMPTS)
    with closing(Talk(target)) as talk:
        try:
            _, words = await talk.find((unit,), blocks, patience, attempts)
        except NoAnswer as error:
            if not once:
                raise
            place = place_of(blocks[0], profile.dialect)
            more = "a function is called once only: try again"
            raise NoAnswer(f"{place}: {error}; {more}") from error
        return words


async def look(target: Target) -> State:
    """The device as it is now; nothing is written.

    Raises:
        DeviceError: as read_identity.
    """
    with closing(Talk(target)) as talk:
        return await talk.look((target.device.unit,), BEFORE)


async def neighbour(target: Target, before: State, unit: int) -> str:
    """Who else answers to a unit that the device is to take; empty where nobody does.

    A device that answers to every unit is told by its identity and all of its settings.
    """
    with closing(Talk(target)) as talk:
        try:
            other = await talk.look((unit,), BEFORE)
        except NoAnswer:
            return ""
        except LinkDown:
            raise
        except DeviceError as error:
            code = error.code if isinstance(error, ExceptionAnswer) else 0
            is_gateway = code in GATEWAY_CODES
            return "" if is_gateway else f"something there answers: {error}"
    return "another device answers there" if _changes(target.device, before, other) else ""


def _changes(device: Device, before: State, now: State) -> list[str]:
    """Names of what is not as it was."""
    found = differences(device.profile, before.words, now.words, now.at - before.at)
    others = ["its identity"] if now.identity != before.identity else []
    return [f"register {each.address}" for each in found] or others


class Talk:
    """One device on a connection of its own. writes: the only ones that may leave.

    silent: how often nothing at all was heard, of the last ``find``.
    """

    def __init__(
        self, target: Target, writes: frozenset[tuple[int, int, int]] = frozenset()
    ) -> None:
        self.device = target.device
        self._clock = target.clock
        connection = target.settings.connections[self.device.connection]
        self._bus = make_bus(connection, [], self._clock, writes)
        self._reached = self._heard = False
        self.silent = 0

    def close(self) -> None:
        self._bus.close()

    async def write(self, unit: int, address: int, value: int) -> None:
        """Once.

        Raises:
            DeviceError: as Bus.transact; NoAnswer also where a gateway says so.
        """
        try:
            await self._bus.transact(unit, WriteRegister(address, value), Tally())
        except ExceptionAnswer as refusal:
            if refusal.code == _NO_RESPONSE:
                raise NoAnswer(str(refusal)) from refusal
            raise

    async def look(self, units: Sequence[int], patience: int, attempts: int = _ATTEMPTS) -> State:
        """Raises DeviceError as ``find``."""
        profile = self.device.profile
        blocks = [*identity_blocks(profile), setting_block(profile)]
        unit, words = await self.find(units, blocks, patience, attempts)
        return State(unit, tuple(words[:-1]), words[-1], self.now())

    async def look_after_write(self, units: Sequence[int], patience: int) -> State:
        """As ``look``, whatever it answers at first: a device that starts may refuse anything."""
        return await self.look(units, patience, 0)

    async def check_unchanged(self, before: State) -> None:
        """Raises NotDone where the device is not the one that was shown, or not as it was."""
        changes = _changes(self.device, before, await self.look((self.device.unit,), BEFORE))
        if changes:
            text = f"is not as it was shown any more ({', '.join(changes)}); nothing was written"
            raise NotDone(text)

    async def find(
        self, units: Sequence[int], blocks: Sequence[Block], patience: int, attempts: int
    ) -> tuple[int, list[tuple[int, ...]]]:
        """The first of these units that answers with all blocks, and their words.

        patience: nanoseconds for which all of them are asked again. attempts: the least number of
        them, ended by a refusal that will not pass; 0 = none is counted, and nothing ends them.

        Raises:
            DeviceError: of the first unit, when the time is over or the link does not open at all.
        """
        limit = self.now() + patience
        asked = self.silent = 0
        while True:
            self._heard, failures = False, []
            for unit in dict.fromkeys(units):
                try:
                    return unit, [await self._read(unit, block) for block in blocks]
                except DeviceError as error:
                    failures.append(error)
            asked, self.silent = asked + 1, self.silent + (not self._heard)
            never_open = isinstance(failures[0], LinkDown) and not self._reached
            if (self.now() >= limit and asked >= attempts) or never_open:
                raise failures[0]
            for one in failures:
                if attempts and isinstance(one, ExceptionAnswer) and one.code not in _PASSING:
                    raise one
            await self.pause()

    async def _read(self, unit: int, block: Block) -> tuple[int, ...]:
        dialect, tally = self.device.profile.dialect, Tally()
        request = read_request(block, dialect)
        place = place_of(block, dialect)
        try:
            answer = await self._bus.transact(unit, request, tally)
        except ExceptionAnswer as refusal:
            text = await described(refusal, unit, self._bus, Tally(), dialect)
            raise ReadRefused(refusal, f"{place}: {text}") from refusal
        except WrongAnswer as error:
            raise DeviceError(f"{place}: {error}") from error
        finally:
            self._heard |= bool(tally.heard or tally.crc_errors or tally.wrong_answers)
        self._reached = True
        return block_words(block, answer.pdu[len(request.head) :])

    async def pause(self) -> None:
        await asyncio.sleep(_PAUSE)

    def now(self) -> int:
        """Monotonic nanoseconds."""
        return self._clock.now().monotonic

"""One device on a connection of its own: who it is, what it is set to, and single writes."""

from __future__ import annotations

import asyncio
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.bus.tally import Tally
from roclog.commanding.settings import differences, setting_block
from roclog.connect import make_bus
from roclog.errors import GATEWAY_CODES, DeviceError, ExceptionAnswer, LinkDown, NoAnswer
from roclog.modbus.request import WriteRegister
from roclog.request_plan import read_request
from roclog.word_types import block_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.register_map import Block, RegisterMap

BEFORE: Final = 2 * 10**9
"""Nanoseconds for which a device that does not answer is asked again before anything is written."""
_PAUSE: Final = 0.2
"""Seconds between two attempts to read."""
_NO_RESPONSE: Final = 11
"""Exception of a gateway, V1.1b3 section 7: it has passed the request on, and nobody answered."""


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
    profile = target.device.profile
    patience = 0 if profile.dialect.has_functions else BEFORE
    with closing(Talk(target)) as talk:
        _, words = await talk.find((target.device.unit,), identity_blocks(profile), patience)
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
    """One device on a connection of its own. writes: the only ones that may leave."""

    def __init__(
        self, target: Target, writes: frozenset[tuple[int, int, int]] = frozenset()
    ) -> None:
        self.device = target.device
        self._clock = target.clock
        connection = target.settings.connections[self.device.connection]
        self._bus = make_bus(connection, [], self._clock, writes)
        self._reached = False

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

    async def look(self, units: Sequence[int], patience: int) -> State:
        """Raises DeviceError as ``find``."""
        profile = self.device.profile
        blocks = [*identity_blocks(profile), setting_block(profile)]
        unit, words = await self.find(units, blocks, patience)
        return State(unit, tuple(words[:-1]), words[-1], self._now())

    async def check_unchanged(self, before: State) -> None:
        """Raises DeviceError where the device is not the one that was shown, or not as it was."""
        changes = _changes(self.device, before, await self.look((self.device.unit,), BEFORE))
        if changes:
            text = f"is not as it was shown any more ({', '.join(changes)}); nothing was written"
            raise DeviceError(text)

    async def find(
        self, units: Sequence[int], blocks: Sequence[Block], patience: int
    ) -> tuple[int, list[tuple[int, ...]]]:
        """The first of these units that answers with all blocks, and their words.

        patience: nanoseconds for which all of them are asked again.

        Raises:
            DeviceError: of the first unit, when the time is over or the link does not open at all.
        """
        limit = self._now() + patience
        while True:
            failures = []
            for unit in dict.fromkeys(units):
                try:
                    return unit, [await self._read(unit, block) for block in blocks]
                except DeviceError as error:
                    failures.append(error)
            never_open = isinstance(failures[0], LinkDown) and not self._reached
            if self._now() >= limit or never_open:
                raise failures[0]
            await asyncio.sleep(_PAUSE)

    async def _read(self, unit: int, block: Block) -> tuple[int, ...]:
        request = read_request(block, self.device.profile.dialect)
        answer = await self._bus.transact(unit, request, Tally())
        self._reached = True
        return block_words(block, answer.pdu[len(request.head) :])

    def _now(self) -> int:
        return self._clock.now().monotonic

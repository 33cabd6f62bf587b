"""What people have done to a device, apart from recording: settings written, saved, a reset.

Nothing is written that was not shown before, as the exact (unit, address, value) that the bus lets
pass. No write is repeated: after one that went unanswered the device is read, and what it holds is
what counts. Everything is read back at the end.
"""

from __future__ import annotations

import asyncio
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.bus.tally import Tally
from roclog.connect import make_bus
from roclog.device_settings import (
    describe,
    differences,
    expected,
    setting_block,
    writable_of,
)
from roclog.errors import DeviceError, ExceptionAnswer, LinkDown, NoAnswer
from roclog.modbus.request import WriteRegister
from roclog.request_plan import read_request
from roclog.word_types import block_words
from roclog.writable import RESET, SAVE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.device_settings import Plan, Step
    from roclog.register_map import Block, RegisterMap
    from roclog.writable import Command

BEFORE: Final = 2 * 10**9
"""Nanoseconds for which a device that does not answer is asked again before anything is written."""
AFTER: Final = 10 * 10**9
"""As BEFORE, after a write: what the device holds then must be found out."""
_UNITS: Final = range(1, 248)
"""Addresses that a device can have; Modbus over Serial Line V1.02, section 2.2."""
_PAUSE: Final = 0.2
"""Seconds between two attempts to read."""
_PATH_UNAVAILABLE: Final = 10
_NO_RESPONSE: Final = 11
"""Exceptions of a gateway, V1.1b3 section 7: it passed nothing on; it did, and nobody answered."""


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


@dataclass(slots=True)
class Outcome:
    """What became of it so far. problems: empty = everything is as it was wanted.

    state: None = the device was not read afterwards, or could not be. sent: steps that have left,
    less those that the device is known not to have taken. done: whether it has saved, or was reset;
    None = not known.
    """

    state: State | None = None
    sent: list[Step] = field(default_factory=list)
    done: bool | None = False
    remarks: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


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
    with closing(_Talk(target)) as talk:
        _, words = await talk.find((target.device.unit,), identity_blocks(profile), patience)
        return words


async def look(target: Target) -> State:
    """The device as it is now; nothing is written.

    Raises:
        DeviceError: as read_identity.
    """
    with closing(_Talk(target)) as talk:
        return await talk.look((target.device.unit,), BEFORE)


async def neighbour(target: Target, before: State, unit: int) -> str:
    """Who else answers to a unit that the device is to take; empty where nobody does.

    A device that answers to every unit is told by its identity and all of its settings.
    """
    with closing(_Talk(target)) as talk:
        try:
            other = await talk.look((unit,), BEFORE)
        except NoAnswer:
            return ""
        except LinkDown:
            raise
        except DeviceError as error:
            code = error.code if isinstance(error, ExceptionAnswer) else 0
            is_gateway = code in (_PATH_UNAVAILABLE, _NO_RESPONSE)
            return "" if is_gateway else f"something there answers: {error}"
    return "another device answers there" if _changes(target.device, before, other) else ""


async def change(
    target: Target, before: State, plan: Plan, outcome: Outcome, *, save: bool
) -> None:
    """Write the steps of a plan one by one, read everything back, and then save where wanted.

    before: what the plan was made from, and what people have seen. outcome: is filled in as it
    goes. What does not read back as it was set is not saved.

    Raises:
        DeviceError: the device does not answer, or is not as it was shown; nothing was written.
    """
    device = target.device
    command = _command(device, SAVE) if save else None
    with closing(_Talk(target, _permitted(device, plan, command))) as talk:
        await talk.check_unchanged(before)
        await _Change(talk, before, outcome).run(plan.steps, command)


async def reset(target: Target, before: State, outcome: Outcome, patience: int) -> None:
    """Have the device start anew, wait until it answers again and compare it with ``before``.

    patience: nanoseconds. It may come back under the address that its settings name.

    Raises:
        DeviceError: as ``change``.
    """
    device = target.device
    command = _command(device, RESET)
    permitted = frozenset({(device.unit, command.address, command.value)})
    with closing(_Talk(target, permitted)) as talk:
        await talk.check_unchanged(before)
        await _ask_for_reset(talk, command, outcome)
        if outcome.problems:
            return
        try:
            outcome.state = await talk.look(_units(device, before.words), patience)
        except DeviceError as error:
            text = f"it did not come back within {patience / 1e9:g} s after the reset: {error}"
            outcome.problems.append(text)
        else:
            _compare(device.profile, before, outcome.state, outcome)


async def _ask_for_reset(talk: _Talk, command: Command, outcome: Outcome) -> None:
    outcome.done, has_answer = None, False
    try:
        await talk.write(talk.device.unit, command.address, command.value)
        has_answer = True
    except NoAnswer:
        pass
    except ExceptionAnswer as refusal:
        outcome.done = False
        outcome.problems.append(f"the device refused to reset: {refusal}")
        return
    except DeviceError as error:
        outcome.remarks.append(f"{error}: whether the reset arrived is not known")
        return
    if has_answer is not command.answers:
        word = "an" if has_answer else "no"
        outcome.remarks.append(f"there was {word} answer, which is not as documented")


def _compare(profile: RegisterMap, before: State, after: State, outcome: Outcome) -> None:
    """What a reset has changed."""
    if after.identity != before.identity:
        outcome.problems.append("it does not say that it is the same device as before")
    was, now = (_texts(profile, each.words) for each in (before, after))
    for lost in differences(profile, before.words, after.words, after.at - before.at):
        outcome.remarks.append(
            f"register {lost.address} ({lost.name}) is {now[lost.address]} again: "
            f"{was[lost.address]} was not saved"
        )


def _command(device: Device, name: str) -> Command:
    command = writable_of(device.profile).command(name)
    assert command is not None, f"{device.profile.name} declares no {name}"
    return command


def _permitted(device: Device, plan: Plan, save: Command | None) -> frozenset[tuple[int, int, int]]:
    """Unit, address and value of all that may be written. The unit may change before it saves."""
    found = {(device.unit, step.address, step.new) for step in plan.steps}
    if save is not None:
        units = (device.unit, *_new_units(device, plan.steps))
        found |= {(unit, save.address, save.value) for unit in units}
    return frozenset(found)


def _new_units(device: Device, steps: Iterable[Step]) -> list[int]:
    """The address that these steps give the device, where they do."""
    name = writable_of(device.profile).unit
    return [step.new for step in steps if step.name == name]


def _units(device: Device, words: Sequence[int]) -> tuple[int, ...]:
    """Addresses under which the device may answer: the configured one, and its setting."""
    name = writable_of(device.profile).unit
    named = [setting.value for setting in describe(device.profile, words) if setting.name == name]
    return (device.unit, *(unit for unit in named if unit in _UNITS))


def _texts(register_map: RegisterMap, words: Sequence[int]) -> dict[int, str]:
    """By address; of what is no setting the number in the register."""
    first = setting_block(register_map).address
    found = {address: str(word) for address, word in enumerate(words, first)}
    return found | {setting.address: setting.text for setting in describe(register_map, words)}


def _changes(device: Device, before: State, now: State) -> list[str]:
    """Names of what is not as it was."""
    found = differences(device.profile, before.words, now.words, now.at - before.at)
    others = ["its identity"] if now.identity != before.identity else []
    return [f"register {each.address}" for each in found] or others


class _Talk:
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


class _Change:
    """One run of ``change``."""

    def __init__(self, talk: _Talk, before: State, outcome: Outcome) -> None:
        self._talk = talk
        self._device = talk.device
        self._before = before
        self._outcome = outcome

    async def run(self, steps: Iterable[Step], save: Command | None) -> None:
        outcome = self._outcome
        try:
            for step in steps:
                if not await self._write(step):
                    break
            await self._verify("")
            if save is not None and not outcome.problems:
                await self._save(save)
                await self._verify(" after saving")
        except DeviceError as error:
            outcome.state = None
            text = f"what the device holds now is not known, it cannot be read: {error}"
            outcome.problems.append(text)
        if save is not None and outcome.done is False:
            outcome.problems.append("nothing was saved")

    async def _write(self, step: Step) -> bool:
        """Whether to go on with the next one."""
        where = f"register {step.address} ({step.name})"
        self._outcome.sent.append(step)
        try:
            await self._talk.write(self._device.unit, step.address, step.new)
        except ExceptionAnswer as refusal:
            self._outcome.sent.remove(step)
            self._outcome.problems.append(f"{where}: the device refused {step.new}: {refusal}")
            return False
        except DeviceError as error:
            return await self._settle(step, f"{where}: {error}")
        return True

    async def _settle(self, step: Step, trouble: str) -> bool:
        """A write went unanswered: what the device holds tells what became of it."""
        try:
            state = await self._look()
        except DeviceError:
            self._outcome.problems.append(trouble)
            raise
        if state.words[step.address - setting_block(self._device.profile).address] == step.new:
            self._outcome.remarks.append(f"{trouble}; the device has taken the value all the same")
            return True
        self._outcome.sent.remove(step)
        self._outcome.problems.append(f"{trouble}; not written, and not tried again")
        return False

    async def _look(self) -> State:
        """The device after a write; raises DeviceError where it does not answer any more."""
        units = (self._device.unit, *_new_units(self._device, self._outcome.sent))
        self._outcome.state = await self._talk.look(units, AFTER)
        return self._outcome.state

    async def _verify(self, when: str) -> None:
        state, before, profile = await self._look(), self._before, self._device.profile
        if state.identity != before.identity:
            self._outcome.problems.append(f"{when} another device answers".strip())
        wanted = expected(profile, before.words, self._outcome.sent)
        texts, found, old = (
            _texts(profile, words) for words in (wanted, state.words, before.words)
        )
        for each in differences(profile, wanted, state.words, state.at - before.at):
            text = found[each.address]
            back = ", the old value: not taken, or its power was lost"
            self._outcome.problems.append(
                f"register {each.address} ({each.name}){when}: wanted {texts[each.address]}, "
                f"found {text}{back if text == old[each.address] else ''}"
            )

    async def _save(self, command: Command) -> None:
        outcome = self._outcome
        assert outcome.state is not None
        outcome.done = None
        try:
            await self._talk.write(outcome.state.unit, command.address, command.value)
        except ExceptionAnswer as refusal:
            outcome.done = False
            outcome.problems.append(f"the device refused to save: {refusal}")
        except DeviceError as error:
            outcome.problems.append(
                f"whether the values are saved is not known, saving was not answered: {error}"
            )
        else:
            outcome.done = True

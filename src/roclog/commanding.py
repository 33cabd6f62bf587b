"""What people have done to a device, apart from recording: settings written, saved, a reset.

Nothing is written that was not shown before, as the exact (unit, address, value) that the bus lets
pass. No write is repeated: after one that went unanswered the device is read, and what it holds is
what counts. Everything is read back at the end.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

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
    from collections.abc import Sequence

    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.device_settings import Plan, Step
    from roclog.register_map import Block, RegisterMap
    from roclog.writable import Command

BEFORE: Final = 2 * 10**9
"""Nanoseconds for which a device that does not answer is asked again before anything is written."""
AFTER: Final = 10 * 10**9
"""As BEFORE, after a write: what the device holds then must be found out."""
_PAUSE: Final = 0.2
"""Seconds between two attempts to read."""
_NOBODY: Final = frozenset({10, 11})
"""Exceptions by which a gateway says that the unit does not answer; V1.1b3 section 7."""

Write = tuple[int, int, int]
"""Unit, address, value."""


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
    """What became of it. problems: empty = everything is as it was wanted.

    state: None = the device could not be read afterwards.
    """

    state: State | None = None
    saved: bool = False
    remarks: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def identity_blocks(register_map: RegisterMap) -> list[Block]:
    """The blocks that say who the device is."""
    names = dict.fromkeys(block for block, _ in register_map.identity)
    return [register_map.block(name) for name in names]


async def read_identity(settings: Settings, name: str, clock: Clock) -> list[tuple[int, ...]]:
    """Words of the blocks of ``identity_blocks``.

    Raises:
        DeviceError: the device does not answer, or not with them.
    """
    talk = _Talk(settings, name, clock)
    try:
        blocks = identity_blocks(talk.device.profile)
        _, words = await talk.find((talk.device.unit,), blocks, BEFORE)
        return words
    finally:
        talk.close()


async def look(settings: Settings, name: str, clock: Clock) -> State:
    """The device as it is now; nothing is written.

    Raises:
        DeviceError: as read_identity.
    """
    talk = _Talk(settings, name, clock)
    try:
        return await talk.look((talk.device.unit,), BEFORE)
    finally:
        talk.close()


async def neighbour(settings: Settings, name: str, clock: Clock, before: State, unit: int) -> str:
    """Who else answers to a unit that the device is to take; empty where nobody does.

    A device that answers to every unit is told by its identity and all of its settings.
    """
    talk = _Talk(settings, name, clock)
    try:
        other = await talk.look((unit,), BEFORE)
    except NoAnswer:
        return ""
    except ExceptionAnswer as refusal:
        return "" if refusal.code in _NOBODY else f"something there answers: {refusal}"
    except LinkDown:
        raise
    except DeviceError as error:
        return f"something there answers: {error}"
    finally:
        talk.close()
    same = (other.identity, other.words) == (before.identity, before.words)
    return "" if same else "another device answers there"


async def change(
    settings: Settings, name: str, clock: Clock, before: State, plan: Plan, *, save: bool
) -> Outcome:
    """Write the steps of a plan one by one, read everything back, and then save where wanted.

    before: what the plan was made from, and what people have seen. It is not saved what does not
    read back as it was set.

    Raises:
        DeviceError: the device does not answer, or is not as it was shown; nothing was written.
    """
    device = settings.devices[name]
    command = writable_of(device.profile).command(SAVE) if save else None
    talk = _Talk(settings, name, clock, _permitted(device, plan, command))
    try:
        return await _Change(talk, before, plan, command).run()
    finally:
        talk.close()


async def reset(
    settings: Settings, name: str, clock: Clock, before: State, patience: int
) -> Outcome:
    """Have the device start anew, wait until it answers again and compare it with ``before``.

    patience: nanoseconds. It may come back under the address that its settings name.

    Raises:
        DeviceError: the device refused, or does not answer again.
    """
    device = settings.devices[name]
    command = writable_of(device.profile).command(RESET)
    assert command is not None
    permitted = frozenset({(device.unit, command.address, command.value)})
    talk = _Talk(settings, name, clock, permitted)
    outcome = Outcome()
    try:
        talk.refuse_another(before, await talk.look((device.unit,), BEFORE))
        await _ask_for_reset(talk, command, outcome)
        outcome.state = await _return(talk, before, patience)
    finally:
        talk.close()
    if outcome.state.identity != before.identity:
        outcome.problems.append("it does not say that it is the same device as before")
    elapsed = outcome.state.at - before.at
    was, now = (_texts(device.profile, each.words) for each in (before, outcome.state))
    for lost in differences(device.profile, before.words, outcome.state.words, elapsed):
        outcome.remarks.append(
            f"register {lost.address} ({lost.name}) is {now[lost.address]} again: "
            f"{was[lost.address]} was not saved"
        )
    return outcome


async def _return(talk: _Talk, before: State, patience: int) -> State:
    try:
        return await talk.look(_units(talk.device, before.words), patience)
    except DeviceError as error:
        wait = f"within {patience / 1e9:g} s after the reset"
        raise NoAnswer(f"{talk.device.name} did not come back {wait}: {error}") from error


async def _ask_for_reset(talk: _Talk, command: Command, outcome: Outcome) -> None:
    try:
        await talk.write(talk.device.unit, command.address, command.value)
    except ExceptionAnswer as refusal:
        raise DeviceError(f"{talk.device.name} refused to reset: {refusal}") from refusal
    except LinkDown as lost:
        outcome.remarks.append(f"{lost}: whether the reset arrived is not known")
    except NoAnswer:
        if command.answers:
            outcome.remarks.append("there was no answer, which is not as documented")
    else:
        if not command.answers:
            outcome.remarks.append("there was an answer, which is not as documented")


def _permitted(device: Device, plan: Plan, save: Command | None) -> frozenset[Write]:
    found = {(device.unit, step.address, step.new) for step in plan.steps}
    if save is not None:
        words = [step.new for step in plan.steps if step.name == _unit_name(device)]
        found |= {(unit, save.address, save.value) for unit in (device.unit, *words)}
    return frozenset(found)


def _unit_name(device: Device) -> str:
    return writable_of(device.profile).unit


def _units(device: Device, words: Sequence[int]) -> tuple[int, ...]:
    """Addresses under which the device may answer: the configured one, and its setting."""
    block = setting_block(device.profile)
    named = [words[p.offset] for p in block.points if p.name == _unit_name(device)]
    return tuple(dict.fromkeys((device.unit, *named)))


def _texts(register_map: RegisterMap, words: Sequence[int]) -> dict[int, str]:
    """By address; of what is no setting the number in the register."""
    first = setting_block(register_map).address
    found = {address: str(word) for address, word in enumerate(words, first)}
    return found | {setting.address: setting.text for setting in describe(register_map, words)}


class _Talk:
    """One device on a connection of its own. writes: the only ones that may leave."""

    def __init__(
        self,
        settings: Settings,
        name: str,
        clock: Clock,
        writes: frozenset[Write] = frozenset(),
    ) -> None:
        self.device = settings.devices[name]
        self._bus = make_bus(settings.connections[self.device.connection], [], clock, writes)
        self._clock = clock
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
            if refusal.code in _NOBODY:
                raise NoAnswer(f"{self.device.name}: {refusal}") from refusal
            raise

    async def look(self, units: Sequence[int], patience: int) -> State:
        """Raises DeviceError as ``find``."""
        profile = self.device.profile
        blocks = [*identity_blocks(profile), setting_block(profile)]
        unit, words = await self.find(units, blocks, patience)
        return State(unit, tuple(words[:-1]), words[-1], self._now())

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
            for unit in units:
                try:
                    return unit, [await self._read(unit, block) for block in blocks]
                except DeviceError as error:
                    failures.append(error)
            never_open = isinstance(failures[0], LinkDown) and not self._reached
            if self._now() >= limit or never_open:
                raise failures[0]
            await asyncio.sleep(_PAUSE)

    def refuse_another(self, before: State, now: State) -> None:
        """Raises DeviceError where the device is not the one that was shown, or not as it was."""
        changed = differences(self.device.profile, before.words, now.words, now.at - before.at)
        if now.identity != before.identity or changed:
            names = ", ".join(f"register {each.address}" for each in changed) or "its identity"
            text = f"is not as it was shown any more ({names}); nothing was written"
            raise DeviceError(f"{self.device.name} {text}")

    async def _read(self, unit: int, block: Block) -> tuple[int, ...]:
        request = read_request(block, self.device.profile.dialect)
        answer = await self._bus.transact(unit, request, Tally())
        self._reached = True
        return block_words(block, answer.pdu[len(request.head) :])

    def _now(self) -> int:
        return self._clock.now().monotonic


class _Change:
    """One run of ``change``. tried: steps that the device has, or should have, taken."""

    def __init__(self, talk: _Talk, before: State, plan: Plan, save: Command | None) -> None:
        self._talk = talk
        self._profile = talk.device.profile
        self._before = before
        self._plan = plan
        self._save = save
        self._tried: list[Step] = []
        self._is_lost = False
        self._outcome = Outcome()

    async def run(self) -> Outcome:
        talk, outcome = self._talk, self._outcome
        talk.refuse_another(self._before, await talk.look((talk.device.unit,), BEFORE))
        for step in self._plan.steps:
            if not await self._write(step):
                break
        await self._verify("")
        if self._save is None or outcome.state is None:
            return outcome
        if outcome.problems:
            outcome.problems.append("nothing was saved")
            return outcome
        await self._write_save(self._save, outcome.state.unit)
        await self._verify(" after saving")
        return outcome

    async def _write(self, step: Step) -> bool:
        """Whether to go on with the next one."""
        where = f"register {step.address} ({step.name})"
        try:
            await self._talk.write(self._talk.device.unit, step.address, step.new)
        except ExceptionAnswer as refusal:
            self._outcome.problems.append(f"{where}: the device refused {step.new}: {refusal}")
            return False
        except DeviceError as error:
            self._tried.append(step)
            return await self._settle(step, f"{where}: {error}")
        self._tried.append(step)
        return True

    async def _settle(self, step: Step, trouble: str) -> bool:
        """A write went unanswered: what the device holds tells what became of it."""
        state = await self._look()
        if state is None:
            self._outcome.problems.append(trouble)
            return False
        held = state.words[step.address - setting_block(self._profile).address]
        if held == step.new:
            self._outcome.remarks.append(f"{trouble}; the device has taken the value all the same")
            return True
        self._tried.remove(step)
        self._outcome.problems.append(f"{trouble}; not written, and not tried again")
        return False

    async def _look(self) -> State | None:
        """The device after a write; None where it does not answer any more."""
        units = [self._talk.device.unit]
        units += [s.new for s in self._tried if s.name == _unit_name(self._talk.device)]
        try:
            self._outcome.state = await self._talk.look(units, AFTER)
        except DeviceError as error:
            self._outcome.state, self._is_lost = None, True
            text = f"what the device holds now is not known, it cannot be read: {error}"
            self._outcome.problems.append(text)
        return self._outcome.state

    async def _verify(self, when: str) -> None:
        if self._is_lost:
            return  # it was asked for long enough
        state = await self._look()
        if state is None:
            return
        if state.identity != self._before.identity:
            self._outcome.problems.append(f"{when} another device answers".strip())
        wanted = expected(self._profile, self._before.words, self._tried)
        elapsed = state.at - self._before.at
        texts, found, old = (
            _texts(self._profile, words) for words in (wanted, state.words, self._before.words)
        )
        for each in differences(self._profile, wanted, state.words, elapsed):
            text = found[each.address]
            back = ", the old value: not taken, or its power was lost"
            self._outcome.problems.append(
                f"register {each.address} ({each.name}){when}: wanted {texts[each.address]}, "
                f"found {text}{back if text == old[each.address] else ''}"
            )

    async def _write_save(self, command: Command, unit: int) -> None:
        try:
            await self._talk.write(unit, command.address, command.value)
        except ExceptionAnswer as refusal:
            self._outcome.problems.append(f"the device refused to save: {refusal}")
        except DeviceError as error:
            self._outcome.problems.append(
                f"whether the values are saved is not known, saving was not answered: {error}"
            )
        else:
            self._outcome.saved = True

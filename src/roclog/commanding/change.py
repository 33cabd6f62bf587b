"""Settings written and saved, and a reset.

Nothing is written that was not shown before, as the exact (unit, address, value) that the bus lets
pass. No write is repeated: after one that went unanswered the device is read, and what it holds is
what counts. Everything is read back at the end.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from roclog.commanding.settings import (
    clock_words,
    describe,
    differences,
    expected,
    setting_block,
    writable_of,
)
from roclog.commanding.talk import BEFORE, Talk
from roclog.errors import GATEWAY_CODES, DeviceError, ExceptionAnswer, NoAnswer
from roclog.register_map.writable import RESET, SAVE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from roclog.commanding.settings import Difference, Plan, Step
    from roclog.commanding.talk import State, Target
    from roclog.config.settings import Device
    from roclog.register_map import RegisterMap
    from roclog.register_map.writable import Command

AFTER: Final = 10 * 10**9
"""Nanoseconds for which a device is asked after a write: what it holds then must be found out."""
_OPEN: Final = frozenset({4, 5, 6})
"""Exceptions after which a write may have been done, or may be yet: failure, acknowledge, busy."""
_SILENT: Final = 2
"""Attempts to read of which nothing at all is heard: a single one a bad line does lose."""
_UNITS: Final = range(1, 248)
"""Addresses that a device can have; Modbus over Serial Line V1.02, section 2.2."""


@dataclass(slots=True)
class Outcome:
    """What became of it so far. problems: empty = everything is as it was wanted.

    state: None = the device was not read afterwards, or could not be. sent: steps that have left,
    less those that the device is known not to have taken. done: whether it has saved what was
    wanted, or was reset; None = not known. lost: nobody answered, where it had to be known.
    """

    state: State | None = None
    sent: list[Step] = field(default_factory=list)
    done: bool | None = False
    lost: bool = False
    remarks: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


async def change(
    target: Target, before: State, plan: Plan, outcome: Outcome, *, save: bool
) -> None:
    """Write the steps of a plan one by one, read everything back, and then save where wanted.

    before: what the plan was made from, and what people have seen. outcome: is filled in as it
    goes. What does not read back as it was set is not saved.

    Raises:
        DeviceError: the device does not answer; nothing was written.
        NotDone: it is not as it was shown; nothing was written.
    """
    device = target.device
    command = _command(device, SAVE) if save else None
    with closing(Talk(target, _permitted(device, plan, command))) as talk:
        await talk.check_unchanged(before)
        await _Change(talk, before, outcome).run(plan.steps, command)


async def reset(target: Target, before: State, outcome: Outcome, patience: int) -> None:
    """Have the device start anew, wait until it answers again and compare it with ``before``.

    patience: nanoseconds. It may come back under the address that its settings name. That it was
    reset is known from what it does: it was silent, or what was not saved is gone.

    Raises:
        DeviceError, NotDone: as ``change``.
    """
    device = target.device
    command = _command(device, RESET)
    permitted = frozenset({(device.unit, command.address, command.value)})
    with closing(Talk(target, permitted)) as talk:
        await talk.check_unchanged(before)
        sent = talk.now()
        await _ask_for_reset(talk, command, outcome)
        if outcome.problems:
            return
        try:
            after = await talk.look_after_write(_units(device, before.words), patience)
        except DeviceError as error:
            outcome.lost = True
            text = f"it did not come back within {patience / 1e9:g} s after the reset: {error}"
            outcome.problems.append(text)
            return
        outcome.state = after
        evidence = _compare(device, before, after, outcome)
        if talk.silent >= _SILENT:
            evidence.append(f"it did not answer for {(after.at - sent) / 1e9:.1f} s")
        if after.identity != before.identity:
            outcome.problems.append("it does not say that it is the same device as before")
        elif evidence:
            outcome.done = True
            outcome.remarks += evidence
        else:
            outcome.remarks.append(_not_known(command, missed=bool(talk.silent)))


async def _ask_for_reset(talk: Talk, command: Command, outcome: Outcome) -> None:
    outcome.done, has_answer = None, False
    where = f"register {command.address} ({command.name})"
    try:
        await talk.write(talk.device.unit, command.address, command.value)
        has_answer = True
    except NoAnswer:
        pass
    except ExceptionAnswer as refusal:
        if refusal.code in _OPEN:
            outcome.remarks.append(f"{where}: {refusal}: perhaps it resets all the same")
            return
        outcome.done, outcome.lost = False, refusal.code in GATEWAY_CODES
        outcome.problems.append(f"{where}: the device refused to reset: {refusal}")
        return
    except DeviceError as error:
        outcome.remarks.append(f"{where}: {error}: whether the reset arrived is not known")
        return
    if has_answer is not command.answers:
        word = "an" if has_answer else "no"
        outcome.remarks.append(f"{where}: there was {word} answer, which is not as documented")


def _compare(device: Device, before: State, after: State, outcome: Outcome) -> list[str]:
    """What a reset has changed goes to the remarks; what shows that there was one is returned."""
    profile, evidence = device.profile, []
    was, now = (_texts(profile, each.words) for each in (before, after))
    for lost in differences(profile, before.words, after.words, after.at - before.at):
        where = f"register {lost.address} ({lost.name})"
        if lost.name in writable_of(profile).clock:
            outcome.remarks.append(f"{where} is {now[lost.address]}, and was {was[lost.address]}")
        else:
            evidence.append(
                f"{where} is {now[lost.address]} again: {was[lost.address]} was not saved"
            )
    if clock_words(profile, after.words) < clock_words(profile, before.words):
        evidence.append("its clock went back")
    if after.unit != before.unit:
        evidence.append(f"it answers to unit {after.unit}")
    return evidence


def _not_known(command: Command, *, missed: bool) -> str:
    heard = "it left a single question unanswered" if missed else "it answered all the time"
    return (
        f"register {command.address} ({command.name}) has no answer, {heard}, and its settings "
        "are what they were: whether it was reset is not known. One that was not saved would have "
        "fallen back: if there was one, it was not reset; reset it again, or switch its power"
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


class _Change:
    """One run of ``change``."""

    def __init__(self, talk: Talk, before: State, outcome: Outcome) -> None:
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
                wrong = await self._verify(" after saving")
                if wrong and outcome.done:
                    self._doubt_save(save, wrong)
        except DeviceError as error:
            outcome.state, outcome.lost = None, True
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
            if refusal.code in _OPEN:
                return await self._settle(step, f"{where}: {refusal}", BEFORE)
            self._outcome.sent.remove(step)
            self._outcome.lost = refusal.code in GATEWAY_CODES
            self._outcome.problems.append(f"{where}: the device refused {step.new}: {refusal}")
            return False
        except DeviceError as error:
            return await self._settle(step, f"{where}: {error}")
        return True

    async def _settle(self, step: Step, trouble: str, patience: int = 0) -> bool:
        """Whether a write was done is open: what the device holds tells what became of it.

        patience: nanoseconds that it may take until the device holds the value.
        """
        limit = self._talk.now() + patience
        while True:
            try:
                state = await self._look()
            except DeviceError:
                self._outcome.problems.append(trouble)
                raise
            if state.words[step.address - setting_block(self._device.profile).address] == step.new:
                text = f"{trouble}; the device has taken the value all the same"
                self._outcome.remarks.append(text)
                return True
            if self._talk.now() >= limit:
                break
            await self._talk.pause()
        self._outcome.sent.remove(step)
        so_far = " so far" if patience else ""
        self._outcome.problems.append(f"{trouble}; not written{so_far}, and not tried again")
        return False

    async def _look(self) -> State:
        """The device after a write; raises DeviceError where it does not answer any more."""
        units = (self._device.unit, *_new_units(self._device, self._outcome.sent))
        self._outcome.state = await self._talk.look_after_write(units, AFTER)
        return self._outcome.state

    async def _verify(self, when: str) -> list[Difference]:
        """What does not read back as it was wanted; it is told as well."""
        state, before, profile = await self._look(), self._before, self._device.profile
        if state.identity != before.identity:
            self._outcome.problems.append(f"{when} another device answers".strip())
        wanted = expected(profile, before.words, self._outcome.sent)
        texts, found, old = (
            _texts(profile, words) for words in (wanted, state.words, before.words)
        )
        wrong = differences(profile, wanted, state.words, state.at - before.at)
        for each in wrong:
            text = found[each.address]
            back = ", the old value: not taken, or its power was lost"
            self._outcome.problems.append(
                f"register {each.address} ({each.name}){when}: wanted {texts[each.address]}, "
                f"found {text}{back if text == old[each.address] else ''}"
            )
        return wrong

    async def _save(self, command: Command) -> None:
        outcome = self._outcome
        assert outcome.state is not None
        outcome.done = None
        where = f"register {command.address} ({command.name})"
        again = "whether the values are saved is not known, and cannot be read: save once more"
        try:
            await self._talk.write(outcome.state.unit, command.address, command.value)
        except ExceptionAnswer as refusal:
            if refusal.code in _OPEN:
                outcome.problems.append(f"{where}: {refusal}: perhaps saved; {again}")
                return
            outcome.done, outcome.lost = False, refusal.code in GATEWAY_CODES
            outcome.problems.append(f"{where}: the device refused to save: {refusal}")
        except DeviceError as error:
            outcome.lost = True
            outcome.problems.append(f"{where}: {error}; {again}")
        else:
            outcome.done = True

    def _doubt_save(self, command: Command, wrong: Sequence[Difference]) -> None:
        """It has saved something: what it held at that moment."""
        registers = ", ".join(str(each.address) for each in wrong)
        self._outcome.done = None
        self._outcome.problems.append(
            f"register {command.address} ({command.name}): saving was acknowledged, but what is "
            f"read back from {registers} now, the old values, is perhaps what it has saved: "
            "set them again and save"
        )

"""Contact devices once, read only: ``check --probe`` and ``read``."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from roclog.bus.tally import Tally
from roclog.connect import make_bus
from roclog.decode import Decoded, decode
from roclog.errors import DeviceError, ExceptionAnswer, LinkDown, NoAnswer, WrongAnswer
from roclog.modbus.stamped import Layout, parse, split
from roclog.polling.facts import read_words
from roclog.polling.refusal import described, is_refusal
from roclog.polling.stamped_table import oldest_baseline, stamp_decoder
from roclog.register_map import ClearOnRead
from roclog.request_plan import place_of

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

    from roclog.bus.bus import Bus
    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.modbus.request import ReadStamped
    from roclog.register_map import Block, StampedInputs, Table
    from roclog.stamps import Stamp


_T = TypeVar("_T")
_PAUSES: Final = 0.25, 0.5
"""Seconds before a question is repeated over a link that was lost; a question is asked once more
than there are of them."""
_MOST_SILENT: Final = 3
"""Questions in a row without an answer, after which a device that has answered is asked no more."""


class State(StrEnum):
    """How a question or a device was answered."""

    ANSWERS = "answers"
    PARTLY = "partly"
    """A device only: some of its data came."""
    REFUSES = "refuses"
    """The device itself said no."""
    WRONG = "wrong"
    """Something came that does not answer the question."""
    SILENT = "silent"
    UNASKED = "not asked"
    """A device only: nothing of it may be read without harm."""


@dataclass(frozen=True, slots=True)
class BlockRead:
    """One block of one device, or why it could not be read (then ``decoded`` is None)."""

    block: Block
    registers: tuple[int, ...]
    decoded: Decoded | None
    problem: str = ""
    state: State = State.ANSWERS


@dataclass(frozen=True, slots=True)
class Part:
    """What a device was asked for, and why it did not come; empty where it did.

    place: in words, with the addresses. texts: what the device says of itself there.
    """

    place: str
    state: State
    problem: str = ""
    texts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """What a device answered. left_out: what it was not asked for, with the reason."""

    device: str
    parts: tuple[Part, ...]
    left_out: tuple[str, ...] = ()

    @property
    def state(self) -> State:
        states = {part.state for part in self.parts}
        if State.ANSWERS in states:
            return State.ANSWERS if len(states) == 1 else State.PARTLY
        for state in (State.REFUSES, State.WRONG):
            if state in states:
                return state
        return State.SILENT if states else State.UNASKED

    @property
    def text(self) -> str:
        """Who it says it is, and how much of it could be read."""
        read = [part for part in self.parts if part.state is State.ANSWERS]
        texts = next((part.texts for part in read if part.texts), ())
        count = f"{len(read)} of {len(self.parts)} blocks read"
        return ", ".join([*texts, count if self.parts else "nothing may be read without harm"])

    @property
    def problems(self) -> tuple[Part, ...]:
        return tuple(part for part in self.parts if part.problem)


@dataclass(frozen=True, slots=True)
class StampedRead:
    """The inputs of one request with their stamps, or why they could not be read.

    inputs: (address, value, stamp). first, last: addresses that were asked for.
    """

    table: Table
    first: int
    last: int
    inputs: tuple[tuple[int, int, Stamp], ...]
    problem: str = ""
    state: State = State.ANSWERS


async def read_device(settings: Settings, name: str, clock: Clock) -> list[BlockRead]:
    """Every block of one device, each read once. Never writes. Does not raise DeviceError."""
    device = settings.devices[name]
    bus = make_bus(settings.connections[device.connection], [], clock)
    try:
        return [await _read(bus, device, block) for block in device.profile.blocks]
    finally:
        bus.close()


async def read_stamped(settings: Settings, name: str, clock: Clock) -> list[StampedRead]:
    """Every list of stamped inputs of one device, read once. Does not raise DeviceError.

    Where the layout is left to the device it is taken as interleaved; `record` finds it out.
    """
    device = settings.devices[name]
    bus = make_bus(settings.connections[device.connection], [], clock)
    try:
        return [
            await _read_stamped(bus, device, inputs, request)
            for inputs in device.profile.stamped
            for request in split(inputs.mei, inputs.address, inputs.count)
        ]
    finally:
        bus.close()


async def _read_stamped(
    bus: Bus, device: Device, inputs: StampedInputs, request: ReadStamped, *, again: bool = False
) -> StampedRead:
    """again: as of _read."""
    place = inputs.table, request.address, request.address + request.count - 1
    ask = partial(bus.transact, device.unit, request, Tally())
    try:
        answer = await (_repeated(bus, ask) if again else ask())
    except DeviceError as error:
        return StampedRead(*place, (), str(error), _state(error))
    decoder = stamp_decoder(device.profile.stamp_rules)
    since = oldest_baseline(answer.read.utc)
    found = tuple(
        (
            point.address,
            point.value,
            decoder.decode(point.stamp, read_at=answer.read.utc, changed_after=since),
        )
        for point in parse(request, answer.pdu, inputs.layout or Layout.INTERLEAVED).points
    )
    return StampedRead(*place, found)


async def probe(settings: Settings, clock: Clock) -> list[ProbeResult]:
    """Everything that may be read without harm, once each.

    Connections side by side, devices on one after another. What was lost on the way is asked for
    again, but no function is called twice. A device that is silent at first is asked for nothing
    else.
    """
    groups: dict[str, list[Device]] = {}
    for device in settings.devices.values():
        groups.setdefault(device.connection, []).append(device)
    found = await asyncio.gather(
        *(_probe_connection(settings, name, group, clock) for name, group in groups.items())
    )
    results = {result.device: result for results in found for result in results}
    return [results[name] for name in settings.devices]


async def _probe_connection(
    settings: Settings, name: str, devices: list[Device], clock: Clock
) -> list[ProbeResult]:
    bus = make_bus(settings.connections[name], [], clock)
    try:
        return [await probe_device(bus, device) for device in devices]
    finally:
        bus.close()


async def probe_device(bus: Bus, device: Device) -> ProbeResult:
    """As probe, of one device; bus: its connection. Does not raise DeviceError."""
    left_out = [text for block in device.profile.blocks if (text := _harm(block, device))]
    questions = list(_questions(bus, device))
    parts: list[Part] = []
    silent = 0
    for question in questions:
        parts.append(await question())
        silent = silent + 1 if parts[-1].state is State.SILENT else 0
        if silent == len(parts) or silent == _MOST_SILENT:
            break
    untried = len(questions) - len(parts)
    if untried:
        left_out.append(f"{untried} more, since it was silent")
    return ProbeResult(device.name, tuple(parts), tuple(left_out))


def _questions(bus: Bus, device: Device) -> Iterator[Callable[[], Awaitable[Part]]]:
    for block in device.profile.blocks:
        if not _harm(block, device):
            yield partial(_ask_for_block, bus, device, block)
    for inputs in device.profile.stamped:
        for request in split(inputs.mei, inputs.address, inputs.count):
            yield partial(_ask_for_inputs, bus, device, inputs, request)


def _harm(block: Block, device: Device) -> str:
    """Why a block is not asked for; empty where it may be.

    Functions that a document describes change nothing; of those that a configuration declares only
    it knows.
    """
    place = place_of(block, device.profile.dialect)
    if isinstance(block.trigger, ClearOnRead):
        return f"{place}, since a read clears it"
    if block.packed and not block.repeatable:
        return f"{place}, since a call may act: repeatable = true says it does not"
    return ""


async def _ask_for_block(bus: Bus, device: Device, block: Block) -> Part:
    again = block.repeatable or not device.profile.dialect.has_functions
    read = await _read(bus, device, block, again=again)
    values = [] if read.decoded is None else read.decoded.values
    texts = tuple(v.strip() for v in values if isinstance(v, str) and v.strip())
    return Part(place_of(block, device.profile.dialect), read.state, read.problem, texts)


async def _ask_for_inputs(
    bus: Bus, device: Device, inputs: StampedInputs, request: ReadStamped
) -> Part:
    read = await _read_stamped(bus, device, inputs, request, again=True)
    place = f"{read.table.replace('_', ' ')} {read.first} to {read.last}"
    return Part(place, read.state, read.problem)


async def _read(bus: Bus, device: Device, block: Block, *, again: bool = False) -> BlockRead:
    """again: what was lost on the way is asked for again."""
    if isinstance(block.trigger, ClearOnRead):
        return BlockRead(block, (), None, "not read, since a read clears it: only `record` does")
    tally = Tally()
    ask = partial(read_words, block, device, bus, tally)
    try:
        registers = await (_repeated(bus, ask) if again else ask())
    except ExceptionAnswer as refusal:
        text = await described(refusal, device.unit, bus, Tally(), device.profile.dialect)
        return BlockRead(block, (), None, text, _state(refusal))
    except DeviceError as error:
        state = State.WRONG if tally.crc_errors else _state(error)
        return BlockRead(block, (), None, str(error), state)
    return BlockRead(block, registers, decode(block, registers, device.word_order))


async def _repeated(bus: Bus, ask: Callable[[], Awaitable[_T]]) -> _T:
    """Raises as Bus.transact: the last error."""
    for pause in (*_PAUSES, None):
        try:
            return await ask()
        except (NoAnswer, WrongAnswer, LinkDown) as error:
            if pause is None or not bus.openings:
                raise
            if isinstance(error, LinkDown):
                await asyncio.sleep(pause)
    raise AssertionError("the last attempt returns or raises")


def _state(error: DeviceError) -> State:
    if isinstance(error, ExceptionAnswer):
        return State.REFUSES if is_refusal(error) else State.SILENT
    return State.WRONG if isinstance(error, WrongAnswer) else State.SILENT

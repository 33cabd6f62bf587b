"""Contact devices once, read only: ``check --probe`` and ``read``."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

from roclog.bus.tally import Tally
from roclog.connect import make_bus
from roclog.decode import Decoded, decode
from roclog.errors import DeviceError, ExceptionAnswer
from roclog.modbus.stamped import Layout, parse, split
from roclog.polling.facts import read_words
from roclog.polling.refusal import described, is_refusal
from roclog.polling.stamped_table import oldest_baseline, stamp_decoder
from roclog.register_map import ClearOnRead

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.modbus.request import ReadStamped
    from roclog.register_map import Block, StampedInputs, Table
    from roclog.stamps import Stamp


@dataclass(frozen=True, slots=True)
class BlockRead:
    """One block of one device, or why it could not be read (then ``decoded`` is None).

    refused: the device itself said no.
    """

    block: Block
    registers: tuple[int, ...]
    decoded: Decoded | None
    problem: str = ""
    refused: bool = False


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """Whether a device gave its data, and who it says it is or what went wrong.

    refused: it is there, and said no.
    """

    device: str
    ok: bool
    text: str
    refused: bool = False


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
    bus: Bus, device: Device, inputs: StampedInputs, request: ReadStamped
) -> StampedRead:
    place = inputs.table, request.address, request.address + request.count - 1
    try:
        answer = await bus.transact(device.unit, request, Tally())
    except DeviceError as error:
        return StampedRead(*place, (), str(error))
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
    """The first block of every device; connections side by side, devices on one after another."""
    groups: dict[str, list[Device]] = {}
    for device in settings.devices.values():
        groups.setdefault(device.connection, []).append(device)
    found = await asyncio.gather(
        *(_probe_connection(settings, name, group, clock) for name, group in groups.items())
    )
    return [result for results in found for result in results]


async def _probe_connection(
    settings: Settings, name: str, devices: list[Device], clock: Clock
) -> list[ProbeResult]:
    bus = make_bus(settings.connections[name], [], clock)
    try:
        return [await _probe_device(bus, device) for device in devices]
    finally:
        bus.close()


async def _probe_device(bus: Bus, device: Device) -> ProbeResult:
    """Ask for the first block, or where there is none for the first stamped inputs."""
    harmless = [b for b in device.profile.blocks if not isinstance(b.trigger, ClearOnRead)]
    if harmless:
        read = await _read(bus, device, harmless[0])
        texts = [] if read.decoded is None else [v for v in read.decoded.values if v]
        said = [v.strip() for v in texts if isinstance(v, str) and v.strip()]
        text = read.problem or ", ".join(said) or f"block {read.block.name} was read"
        if read.refused:
            text = f"{_place(read.block)}: {text}"
        ok = read.decoded is not None
        return ProbeResult(device.name, ok=ok, text=text, refused=read.refused)
    for inputs in device.profile.stamped[:1]:
        request = split(inputs.mei, inputs.address, inputs.count)[0]
        stamped = await _read_stamped(bus, device, inputs, request)
        what = f"{stamped.table.replace('_', ' ')} {stamped.first} to {stamped.last}"
        text = stamped.problem or f"{what} were read"
        return ProbeResult(device.name, ok=not stamped.problem, text=text)
    return ProbeResult(device.name, ok=False, text="nothing can be read without clearing it")


async def _read(bus: Bus, device: Device, block: Block) -> BlockRead:
    if isinstance(block.trigger, ClearOnRead):
        return BlockRead(block, (), None, "not read, since a read clears it: only `record` does")
    try:
        registers = await read_words(block, device, bus, Tally())
    except ExceptionAnswer as refusal:
        text = await described(refusal, device.unit, bus, Tally(), device.profile.dialect)
        return BlockRead(block, (), None, text, refused=is_refusal(refusal))
    except DeviceError as error:
        return BlockRead(block, (), None, str(error))
    return BlockRead(block, registers, decode(block, registers, device.word_order))


def _place(block: Block) -> str:
    if block.packed:
        return f"function {block.address} ({block.name})"
    what = block.table.replace("_", " ")
    return f"{what} {block.address} to {block.address + block.count - 1} ({block.name})"

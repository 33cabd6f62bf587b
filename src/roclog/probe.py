"""Contact devices once, read only: ``check --probe`` and ``read``."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

from roclog.bus.tally import Tally
from roclog.connect import make_bus
from roclog.decode import Decoded, decode
from roclog.errors import DeviceError, ExceptionAnswer
from roclog.polling.refusal import described
from roclog.polling.request_plan import read_request
from roclog.word_types import block_words

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.clock import Clock
    from roclog.config.settings import Device, Settings
    from roclog.register_map import Block


@dataclass(frozen=True, slots=True)
class BlockRead:
    """One block of one device, or why it could not be read (then ``decoded`` is None)."""

    block: Block
    registers: tuple[int, ...]
    decoded: Decoded | None
    problem: str = ""


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """Whether a device answered, and who it says it is or what went wrong."""

    device: str
    ok: bool
    text: str


async def read_device(settings: Settings, name: str, clock: Clock) -> list[BlockRead]:
    """Every block of one device, each read once. Never writes. Does not raise DeviceError."""
    device = settings.devices[name]
    bus = make_bus(settings.connections[device.connection], [], clock)
    try:
        return [await _read(bus, device, block) for block in device.profile.blocks]
    finally:
        bus.close()


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
    results = []
    try:
        for device in devices:
            read = await _read(bus, device, device.profile.blocks[0])
            if read.decoded is None:
                results.append(ProbeResult(device.name, ok=False, text=read.problem))
            else:
                texts = [v.strip() for v in read.decoded.values if isinstance(v, str) and v.strip()]
                results.append(ProbeResult(device.name, ok=True, text=", ".join(texts)))
    finally:
        bus.close()
    return results


async def _read(bus: Bus, device: Device, block: Block) -> BlockRead:
    request, dialect = read_request(block, device.profile.dialect), device.profile.dialect
    try:
        answer = await bus.transact(device.unit, request, Tally())
    except ExceptionAnswer as refusal:
        text = await described(refusal, device.unit, bus, Tally(), dialect)
        return BlockRead(block, (), None, text)
    except DeviceError as error:
        return BlockRead(block, (), None, str(error))
    registers = block_words(block, answer.pdu[len(request.head) :])
    return BlockRead(block, registers, decode(block, registers, device.word_order))

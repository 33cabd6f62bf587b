"""What a device says of itself: identity and configuration, kept as metadata of every segment."""

from __future__ import annotations

import json
import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from roclog.decode import Value, decode, named_values
from roclog.request_plan import plan_requests
from roclog.word_types import block_words

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.config.settings import Device
    from roclog.register_map import Block, Point


async def read_facts(
    block: Block, device: Device, bus: Bus, tally: Tally, due: int
) -> dict[str, Value | None]:
    """The fields of one block by name, None = no measurement. due: as of Bus.transact.

    Raises:
        DeviceError: as Bus.transact.
    """
    words = await read_words(block, device, bus, tally, due)
    return named_values(block, decode(block, words, device.word_order))


async def read_words(
    block: Block, device: Device, bus: Bus, tally: Tally, due: int = 0
) -> tuple[int, ...]:
    """The words of one block, in as many requests as it needs.

    Raises:
        DeviceError: as Bus.transact.
    """
    octets = b""
    for fetch in plan_requests([block], device.profile.dialect):
        answer = await bus.transact(device.unit, fetch.request, tally, due=due)
        octets += b"".join(answer.pdu[part.start : part.stop] for part in fetch.parts)
    return block_words(block, octets)


def device_metadata(device: Device, facts: dict[str, dict[str, Value | None]]) -> dict[str, str]:
    """The metadata record of a device: who it is, and its map, to read ``raw`` without roclog."""
    return {
        "profile": device.profile.name,
        "unit": str(device.unit),
        "connection": device.connection,
        "word_order": device.word_order.value,
        "register_map": _as_text(device.profile.samples),
        **{name: _as_json(values) for name, values in facts.items()},
    }


@lru_cache(maxsize=256)
def _as_text(blocks: tuple[Block, ...]) -> str:
    """The map; a thousand devices share a few."""
    return json.dumps([_described(block) for block in blocks])


def _as_json(values: dict[str, Value | None]) -> str:
    """JSON has neither NaN nor infinities: null, as in the lines of an export."""
    known = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in values.items()
    }
    return json.dumps(known, allow_nan=False, default=bytes.hex)


def _described(block: Block) -> dict[str, Any]:
    return {
        "block": block.name,
        "title": block.title,
        "table": block.table.value,
        "address": block.address,
        "count": block.count,
        "packed": block.packed,
        "points": [_described_point(point) for point in block.points],
    }


def _described_point(point: Point) -> dict[str, Any]:
    """Numbers with a point as text, since they are exact. What few points have is left out."""
    gate = point.valid_when
    more = {
        "words": point.words,
        "add": None if point.add is None else str(point.add),
        "word_order": None if point.word_order is None else point.word_order.value,
        "sentinels": {str(value): text for value, text in point.sentinels},
        "valid_when": None if gate is None else {"point": gate.point, "values": gate.values},
        "meanings": {str(value): text for value, text in point.meanings},
        "bits": {str(bit): name for bit, name in point.bits},
        "parts": [{"first": bit, "bits": size, "name": name} for bit, size, name in point.parts],
    }
    return {
        "name": point.name,
        "offset": point.offset,
        "type": point.type.value,
        "scale": None if point.scale is None else str(point.scale),
        "unit": point.unit,
        **{key: value for key, value in more.items() if value},
    }

"""What a device says of itself: identity and configuration, kept as metadata of every segment."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from roclog.decode import Value, decode, field_names
from roclog.request_plan import read_request
from roclog.word_types import block_words

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.config.settings import Device
    from roclog.register_map import Block


async def read_facts(
    block: Block, device: Device, bus: Bus, tally: Tally, due: int
) -> dict[str, Value]:
    """The fields of one block by name. due: as of Bus.transact.

    Raises:
        DeviceError: as Bus.transact.
    """
    request = read_request(block, device.profile.dialect)
    answer = await bus.transact(device.unit, request, tally, due=due)
    words = block_words(block, answer.pdu[len(request.head) :])
    decoded = decode(block, words, device.word_order)
    return dict(zip(field_names(block), decoded.values, strict=True))


def device_metadata(device: Device, facts: dict[str, dict[str, Value]]) -> dict[str, str]:
    """The metadata record of a device: who it is, and its map, to read ``raw`` without roclog."""
    return {
        "profile": device.profile.name,
        "unit": str(device.unit),
        "connection": device.connection,
        "word_order": device.word_order.value,
        "register_map": json.dumps([_described(block) for block in device.profile.samples]),
        **{name: json.dumps(values) for name, values in facts.items()},
    }


def _described(block: Block) -> dict[str, Any]:
    return {
        "block": block.name,
        "table": block.table.value,
        "address": block.address,
        "count": block.count,
        "points": [
            {
                "name": point.name,
                "offset": point.offset,
                "type": point.type.value,
                "scale": None if point.scale is None else str(point.scale),
                "unit": point.unit,
            }
            for point in block.points
        ],
    }

"""The module's functions from their octets to values, both byte orders, text in one."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from roclog.decode import TimeFlag, decode, named_values
from roclog.devices.msx_e3317 import CLOCK, COMMAND_STATUS, REGISTER_MAP
from roclog.modbus.dialect import MSX_E
from roclog.modbus.functions import ReadFunction
from roclog.register_map import WordOrder
from roclog.word_types import block_words

if TYPE_CHECKING:
    from roclog.register_map import Block

FOLDER = Path(__file__).parents[1] / "vectors/msx"
FUNCTIONS = {
    function["register"]: function
    for function in tomllib.loads((FOLDER / "functions.toml").read_text(encoding="utf-8"))[
        "function"
    ]
}
VALUES = tomllib.loads((FOLDER / "values.toml").read_text(encoding="utf-8"))["value"]
ORDERS = {"big": WordOrder.ABCD, "little": WordOrder.DCBA}
BLOCKS = {block.name: block for block in (*REGISTER_MAP.blocks, COMMAND_STATUS)}


@pytest.mark.parametrize("block", BLOCKS.values(), ids=lambda block: block.name)
def test_every_block_is_a_function_of_the_document(block: Block) -> None:
    function = FUNCTIONS[block.address]
    assert block.count == function["words"]
    assert block.octets == function["count"]
    assert block.atomic
    covered = [word for p in block.points for word in range(p.offset, p.offset + block.size_of(p))]
    assert covered == list(range(block.count))
    for order in ("big", "little"):
        dialect = replace(MSX_E, order=order)
        request = ReadFunction(block.address, block.count, dialect=dialect)
        assert request.pdu == bytes.fromhex(function["query"][order])[7:]


@pytest.mark.parametrize("value", VALUES, ids=lambda v: f"{v['block']}-{v['order']}")
def test_values(value: dict[str, Any]) -> None:
    block = BLOCKS[value["block"]]
    payload = bytes.fromhex(value["payload"]).ljust(block.octets, b"\0")
    decoded = decode(block, block_words(block, payload), ORDERS[value["order"]])
    found = named_values(block, decoded)
    assert {name: found[name] for name in value["values"]} == value["values"]
    assert decoded.device_time == value.get("device_time", 0)
    assert [flag.name for flag in decoded.time_flags] == value.get("time_flags", [])
    names = [p.name for i, p in enumerate(block.points) if decoded.doubtful >> i & 1]
    assert names == value.get("doubtful", [])


def test_a_clock_that_was_never_set_is_no_time() -> None:
    decoded = decode(CLOCK, [0] * 4)
    assert (decoded.device_time, decoded.time_flags) == (0, TimeFlag.NO_TIME)

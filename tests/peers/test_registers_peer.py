"""The test device of any registers against raw octets, as documents print them."""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any

import pytest
from registers_cells import contents
from registers_model import Model
from registers_options import Options
from roc_truth import Truth
from wire import rtu_frame

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

INSIDE = {"how": "read", "area": 4, "at": 2, "mask": 4, "up": 4, "reads": [3, 0, 998]}
BY_CLIENT = {"how": "client", "area": 4, "at": 300, "mask": 0xFFFF, "up": 1, "down": 0}


@pytest.mark.parametrize(
    ("cell", "value", "words"),
    [
        ({"as": "u32", "order": "1234"}, 0x12345678, [0x1234, 0x5678]),  # Honeywell HC900, FP B
        ({"as": "u32", "order": "2143"}, 0x12345678, [0x3412, 0x7856]),  # FP BB
        ({"as": "u32", "order": "4321"}, 0x12345678, [0x7856, 0x3412]),  # FP L
        ({"as": "u32", "order": "3412"}, 0x12345678, [0x5678, 0x1234]),  # FP LB
        ({"as": "f64"}, 1234567.89, [0x4132, 0xD687, 0xE3D7, 0x0A3D]),  # JUMO LOGOSCREEN, p. 25
        ({"as": "f32", "order": "3412"}, 30.56, [0x7AE1, 0x41F4]),  # Vaisala Indigo500, p. 118
        ({"as": "i16"}, -23456, [0xA460]),  # Xentara Modbus driver 1.0
        ({"as": "d16"}, 105341284, [0, 1, 0x0534, 0x1284]),  # GE EPM 9650, F11
        ({"as": "chars:6"}, "8801", [0x3838, 0x3031, 0]),  # Met One 6000, A.1
        ({"as": "pair"}, [11, 23], [0x0B17]),
        # Schneider EM3000, DATETIME, from its last word on; summer time as IEC 60870-5-4, 6.8
        ({"as": "cp56", "order": "87654321"}, [2026, 11, 23, 6, 30, 15250, 0],
         [0x001A, 0x0B17, 0x061E, 0x3B92]),
        ({"as": "cp32"}, [2026, 7, 1, 6, 30, 15250, 1], [0x923B, 0x1E86]),
        ({"as": "cp56"}, None, [0, 0, 0, 0]),
    ],
)  # fmt: skip
def test_what_lies_in_registers(cell: dict[str, Any], value: Any, words: list[int]) -> None:
    assert contents({"area": 4, **cell}, value) == words


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., Model]:
    def make(*groups: dict[str, Any], **more: Any) -> Model:
        path = tmp_path / "memory.json"
        path.write_text(json.dumps({"unit": 204, "groups": groups, **more}))
        model = Model(Options(tcp="127.0.0.1:0", memory=str(path)), Truth(None))
        model.power_up()
        return model

    return make


def group(**more: Any) -> dict[str, Any]:
    cell = {"name": "n", "area": 3, "at": 0, "as": "u16", "counts": [1, 3]}
    return {"name": "g", "every": 1, "cells": [cell], **more}


def ask(model: Model, *words: int) -> str:
    """words: function, address, and count or value."""
    reply = model.execute(struct.pack(">BHH", *words), "ok", {})
    model.settled(reply, "ok")
    return "" if reply.pdu is None else reply.pdu.hex(" ")


def test_the_request_that_a_manual_prints(made: Callable[..., Model]) -> None:
    """RMF CMS 2, 6.4.1: CC 04 00 00 00 7D 20 36."""
    frame = bytes.fromhex("CC 04 00 00 00 7D 20 36")
    assert rtu_frame(frame[0], frame[1:-2]) == frame
    product = {"name": "product", "area": 3, "at": 0, "as": "words", "give": [[0xD3DD]]}
    model = made({"name": "settings", "cells": [product]}, more=[[3, 0, 124]])
    reply = model.execute(frame[1:-2], "ok", {})
    assert reply.pdu == bytes.fromhex("04 fa d3 dd") + bytes(248)


def test_exceptions(made: Callable[..., Model]) -> None:
    refuse = [{"area": 3, "first": 0, "last": 0, "code": 4, "times": 1}]
    model = made(group(), refuse=refuse)
    assert ask(model, 5, 0, 1) == "85 01"
    assert ask(model, 4, 0, 2) == "84 02"
    assert ask(model, 4, 0, 126) == "84 03"
    assert ask(model, 4, 0, 1) == "84 04"
    assert ask(model, 4, 0, 1) == "04 02 00 00"
    assert ask(model, 6, 0, 1) == "86 02"


def test_a_counter_runs_over_and_a_flag_falls_by_reading(made: Callable[..., Model]) -> None:
    model = made(group(tells=INSIDE))
    assert ask(model, 3, 2, 1) == "03 02 00 00"
    for number in (1, 2, 3, 1):
        model.complete(model.groups[0])
        assert ask(model, 3, 2, 1) == "03 02 00 04"
        assert ask(model, 4, 0, 1) == f"04 02 00 {number:02x}"
        assert ask(model, 3, 2, 1) == "03 02 00 00"
    took = [line["took"] for line in model._truth.lines if line["event"] == "read" and line["took"]]
    assert took == [{"g": k} for k in (1, 2, 3, 4)]


def test_only_the_client_lowers_its_flag_and_writes_nothing_else(
    made: Callable[..., Model],
) -> None:
    model = made(group(tells=BY_CLIENT))
    model.complete(model.groups[0])
    model.complete(model.groups[0])
    assert ask(model, 3, 300, 1) == "03 02 00 01"
    assert ask(model, 6, 300, 2) == "86 02"
    assert ask(model, 6, 300, 0) == "06 01 2c 00 00"
    assert ask(model, 3, 300, 1) == "03 02 00 00"
    events = [line["event"] for line in model._truth.lines]
    assert (events.count("overwritten"), events.count("clear"), events.count("write")) == (1, 1, 1)


def test_a_lost_answer_is_lost_once_and_power_begins_at_zero(made: Callable[..., Model]) -> None:
    model = made(group(lose=[1]))
    model.complete(model.groups[0])
    assert ask(model, 4, 0, 1) == ""
    assert ask(model, 4, 0, 1) == "04 02 00 01"
    model.power_up()
    assert ask(model, 4, 0, 1) == "04 02 00 00"
    model.complete(model.groups[0])
    assert ask(model, 4, 0, 1) == "04 02 00 01"


def test_bits_fill_octets_from_the_lowest_on(made: Callable[..., Model]) -> None:
    """V1.1b3, 6.1: coils 20-38 are CD 6B 05."""
    states = [int(c) for octet in ("11001101", "01101011", "101") for c in reversed(octet)]
    coils = {"name": "c", "area": 0, "at": 19, "as": "bit", "give": [states]}
    model = made({"name": "coils", "cells": [coils]})
    assert ask(model, 1, 19, 19) == "01 03 cd 6b 05"

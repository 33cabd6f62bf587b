"""The MPA-48 against the examples and the table of its manual, pages 23 and 25."""

from __future__ import annotations

import math

import pytest

from roclog.decode import decode, named_values
from roclog.devices.mpa_48 import SENSORS, mpa_48
from roclog.errors import RegisterMapError
from roclog.map_check import check_register_map
from roclog.modbus.bits import ReadBits
from roclog.modbus.library import crc
from roclog.modbus.request import ReadRegisters, words
from roclog.register_map import WordType
from roclog.schema import sample_type
from roclog.word_types import block_words

ALL = {f"channel_{n}": model for n, model in enumerate(SENSORS, start=1)}
ADDRESSES = {"channel_3": 16, "channel_4": 19}


def test_the_relays_of_page_23() -> None:
    """Request 01 01 00 00 00 08, answer 01 01 01 05: relays 1 and 3 are on."""
    block = mpa_48({"channel_1": "model-15"}).block("relays")
    request = ReadBits(block.table.read_function, block.address, block.count)
    assert b"\x01" + request.pdu == bytes.fromhex("01 01 00 00 00 08")
    answer = bytes.fromhex("01 01 05")
    assert answer.startswith(request.head)
    assert len(answer) == request.answer_size
    values = named_values(block, decode(block, block_words(block, answer[2:])))
    assert [name for name, is_on in values.items() if is_on] == ["relay_1", "relay_3"]


def test_channel_2_of_page_25() -> None:
    """Dissolved oxygen 8.30 ppm, 25.0 degrees: registers 3 to 5 are 0000 033E 00FA."""
    block = mpa_48({"channel_2": "model-10"}).block("channel_2")
    request = ReadRegisters(block.table.read_function, block.address, block.count)
    frame = b"\x01" + request.pdu
    assert frame + crc(frame) == bytes.fromhex("01 04 00 03 00 03 40 0B")
    found = decode(block, words(bytes.fromhex("04 06 00 00 03 3E 00 FA")))
    assert named_values(block, found) == {
        "status": 0,
        "dissolved_oxygen": 8.3,
        "temperature": 25.0,
    }


@pytest.mark.parametrize(
    ("model", "raw", "values"),
    [
        ("model-10", (830, 0xFFF6), {"dissolved_oxygen": 8.3, "temperature": -1.0}),
        ("model-15", (1234, 0xFFFF), {"suspended_solids": 1234}),
        ("model-51", (701, 205), {"ph": 7.01, "temperature": 20.5}),
        ("model-52", (1500, 0xFFFF), {"orp": -500.0}),
        ("model-52", (2000, 0), {"orp": 0.0}),
    ],
)
def test_models(model: str, raw: tuple[int, int], values: dict[str, float]) -> None:
    """Scaling of page 25; an undefined second register has no value at all."""
    block = mpa_48({"channel_1": model}).block("channel_1")
    assert named_values(block, decode(block, (0, *raw))) == {"status": 0, **values}
    for status in (1, 2, 3, 0xFFFF):
        decoded = decode(block, (status, *raw))
        away = dict.fromkeys(values)
        assert named_values(block, decoded) == {"status": status, **away}
        assert decoded.doubtful == (1 if status > 3 else 0)
        floats = [value for value in decoded.values if isinstance(value, float)]
        assert all(map(math.isnan, floats))


@pytest.mark.parametrize(
    ("model", "text"),
    [
        ("model-10", "new sensor codes needed"),
        ("model-15", "needs zero calibration"),
        ("model-51", "sensor error"),
        ("model-52", "sensor error"),
    ],
)
def test_status_3_differs_by_model(model: str, text: str) -> None:
    status = mpa_48({"channel_1": model}).block("channel_1").points[0]
    assert dict(status.meanings)[3] == text


def test_every_model_at_once() -> None:
    made = mpa_48(ALL, ADDRESSES)
    check_register_map(made)
    assert [block.address for block in made.samples] == [0, 0, 3, 16, 19]
    assert {p.type for p in made.block("relays").points} == {WordType.BIT}


def test_one_model_has_one_message_type_on_every_channel() -> None:
    made = mpa_48({"channel_1": "model-15", "channel_2": "model-15"})
    types = [sample_type(made.name, made.block(f"channel_{n}")) for n in (1, 2)]
    assert types[0] == types[1]
    assert types[0].name == "roclog.mpa_48.ChannelModel15"


@pytest.mark.parametrize(
    ("sensors", "addresses", "problem"),
    [
        ({}, {}, "sensors: none"),
        ({"channel_1": "model-16"}, {}, "channel_1: 'model-16' is not one of"),
        ({"channel_3": "model-15"}, {}, "channel_3: its address is not documented"),
        ({"channel_0": "model-15"}, {"channel_0": 9}, "channel_0: is not a channel"),
        ({"channel_1": "model-15"}, {"channel_9": 9}, "channel_9: has an address, but no"),
        ({"channel_3": "model-15"}, {"channel_3": 65534}, "65534 to 65536 do not exist"),
    ],
)
def test_mistakes(sensors: dict[str, str], addresses: dict[str, int], problem: str) -> None:
    with pytest.raises(RegisterMapError, match=problem):
        mpa_48(sensors, addresses)


def test_all_mistakes_at_once() -> None:
    with pytest.raises(RegisterMapError) as caught:
        mpa_48({"channel_3": "model-16", "x": "model-15"}, {"channel_9": -1})
    assert len(caught.value.problems) == 5


@pytest.mark.parametrize(
    ("addresses", "problem"),
    [
        ({"channel_3": 6, "channel_4": 8}, "channel_4: registers 8 to 10 overlap those of"),
        (
            {"channel_3": 2, "channel_4": 9},
            "channel_3: registers 2 to 4 overlap those of channel_1",
        ),
        ({"channel_1": 3, "channel_3": 6, "channel_4": 9}, "channel_1: registers 3 to 5 overlap"),
    ],
)
def test_channels_share_no_register(addresses: dict[str, int], problem: str) -> None:
    sensors = dict.fromkeys(["channel_1", "channel_2", "channel_3", "channel_4"], "model-10")
    with pytest.raises(RegisterMapError, match=problem) as caught:
        mpa_48(sensors, addresses)
    assert len(caught.value.problems) == (2 if addresses["channel_3"] == 2 else 1)
    assert mpa_48(sensors, {"channel_3": 6, "channel_4": 9})

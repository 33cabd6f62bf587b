"""Every device against octets and meanings that come from its document, never from our encoder."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from roclog.decode import decode, field_names
from roclog.devices import PROFILES
from roclog.modbus.library import crc
from roclog.modbus.request import ReadRegisters
from roclog.schema import block_fields
from roclog.testing import check_register_map

if TYPE_CHECKING:
    from roclog.register_map import Block, RegisterMap

FOLDER = Path(__file__).parents[1] / "vectors/devices"
FILES = {
    vectors["profile"]: vectors
    for vectors in (tomllib.loads(p.read_text(encoding="utf-8")) for p in FOLDER.glob("*.toml"))
}
MAPS = pytest.mark.parametrize("register_map", PROFILES.values(), ids=lambda m: m.name)


def _all(key: str) -> list[Any]:
    return [
        pytest.param(profile, vector, id=f"{profile}-{vector['source'][:60]}")
        for profile, vectors in FILES.items()
        for vector in vectors[key]
    ]


def _words(block: Block, registers: dict[str, Any]) -> list[int]:
    words = [0] * block.count
    for address, given in registers.items():
        first = int(address) - block.address
        values = given if isinstance(given, list) else [given]
        assert 0 <= first <= block.count - len(values)
        words[first : first + len(values)] = values
    return words


@pytest.mark.parametrize(("profile", "vector"), _all("block"))
def test_meaning(profile: str, vector: dict[str, Any]) -> None:
    block = PROFILES[profile].block(vector["name"])
    decoded = decode(block, _words(block, vector["registers"]))
    values = dict(zip(field_names(block), decoded.values, strict=True))
    assert {name: values[name] for name in vector["values"]} == vector["values"]
    named = [p.name for i, p in enumerate(block.points) if decoded.doubtful >> i & 1]
    expected = set(vector.get("doubtful", ()))
    touched = {p.name for p in block.points if p.name in vector["values"]}
    assert expected == set(named) & (touched | expected)
    assert decoded.device_time == vector.get("device_time", 0)
    if "time_flags" in vector:
        assert [flag.name for flag in decoded.time_flags] == vector["time_flags"]


@pytest.mark.parametrize(("profile", "vector"), _all("frame"))
def test_request(profile: str, vector: dict[str, Any]) -> None:
    device = PROFILES[profile]
    block = device.block(vector["block"])
    request = ReadRegisters(block.table.read_function, block.address, block.count)
    body = bytes([device.unit]) + request.pdu
    assert body + crc(body) == bytes.fromhex(vector["octets"])


@MAPS
def test_contract(register_map: RegisterMap) -> None:
    check_register_map(register_map)
    assert register_map.name in FILES, "a device needs vectors from its document"
    assert PROFILES[register_map.name] is register_map


GOLDEN = {
    "hiac-roc": {
        "sample": {
            "count_1": 16,
            "count_2": 17,
            "count_3": 18,
            "count_4": 19,
            "iso_code_1": 20,
            "iso_code_2": 21,
            "iso_code_3": 22,
            "iso_code_4": 23,
            "nas_class_2_3": 24,
            "nas_class_3_4": 25,
            "sae_class_1": 26,
            "sae_class_2": 27,
            "sae_class_3": 28,
            "sae_class_4": 29,
            "temperature": 30,
            "sample_period": 31,
            "alarms": 32,
            "laser_current_low": 33,
            "laser_current_high": 34,
            "photo_diode_power_low": 35,
            "photo_diode_power_high": 36,
            "temperature_low": 37,
            "temperature_high": 38,
            "concentration_low": 39,
            "concentration_high": 40,
            "channel_1_alarm": 41,
            "channel_2_alarm": 42,
            "channel_3_alarm": 43,
            "channel_4_alarm": 44,
        }
    },
    "msx-e3317": {
        "clock": {"seconds": 16, "microseconds": 17},
        "calibration_status": {"status": 16, "channel": 17, "reference": 18, "digital_value": 19},
        "pressure_channels": {"channels": 16},
        "acquisition_channels": {"channels": 16},
        "channels_info": {
            **{f"type_{place}": 15 + place for place in range(1, 17)},
            **{f"hardware_position_{place}": 31 + place for place in range(1, 17)},
            **{f"channel_index_{place}": 47 + place for place in range(1, 17)},
        },
    },
}


@MAPS
def test_field_numbers_are_stable_for_ever(register_map: RegisterMap) -> None:
    """Recordings carry these numbers. A field may be added at the end; nothing else may change."""
    for block in register_map.samples:
        numbers = {field.name: field.number for field in block_fields(block)}
        golden = GOLDEN[register_map.name][block.name]
        assert dict(list(numbers.items())[: len(golden)]) == golden

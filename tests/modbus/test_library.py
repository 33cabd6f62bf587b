"""Encoding and checksum against printed frames and a checksum computed bit by bit."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire import crc16

from roclog.modbus.library import crc, read_registers_pdu, write_register_pdu

VECTORS = tomllib.loads(
    (Path(__file__).parents[1] / "vectors/modbus/frames.toml").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("vector", VECTORS["rtu"], ids=lambda vector: vector["octets"])
def test_printed_frames_hold(vector: dict[str, str]) -> None:
    frame = bytes.fromhex(vector["octets"])
    assert crc(frame[:-2]) == frame[-2:]


@pytest.mark.parametrize("vector", VECTORS["misprint"], ids=lambda vector: vector["octets"])
def test_a_misprint_does_not_hold(vector: dict[str, str]) -> None:
    frame = bytes.fromhex(vector["octets"])
    assert crc(frame[:-2]) != frame[-2:]
    assert crc(frame[:-2]) == bytes.fromhex(vector["correct"])


@pytest.mark.parametrize("vector", VECTORS["computed"], ids=lambda vector: vector["frame"])
def test_computed_frames(vector: dict[str, object]) -> None:
    body = bytes([int(str(vector["unit"]))]) + bytes.fromhex(str(vector["request"]))
    assert body + crc(body) == bytes.fromhex(str(vector["frame"]))


@settings(derandomize=True, deadline=None)
@given(st.binary(max_size=260))
def test_the_checksum_is_the_one_computed_bit_by_bit(octets: bytes) -> None:
    assert crc(octets) == crc16(octets).to_bytes(2, "little")


@pytest.mark.parametrize("function", [3, 4])
@pytest.mark.parametrize("address", [0, 1, 300, 0xFFFF])
@pytest.mark.parametrize("count", [1, 27, 125])
def test_read_requests(function: int, address: int, count: int) -> None:
    expected = bytes([function]) + address.to_bytes(2) + count.to_bytes(2)
    assert read_registers_pdu(function, address, count) == expected


@pytest.mark.parametrize("address", [0, 300, 0xFFFF])
@pytest.mark.parametrize("value", [0, 1, 0x8000, 0xFFFF])
def test_write_requests(address: int, value: int) -> None:
    assert write_register_pdu(address, value) == b"\x06" + address.to_bytes(2) + value.to_bytes(2)

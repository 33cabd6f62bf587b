"""The one place that knows pymodbus: request encoding and the RTU checksum.

Answers are judged in roclog.modbus.request, because pymodbus compares neither the function nor the
count of an answer with its request.
"""

from __future__ import annotations

from pymodbus.framer import FramerRTU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteSingleRegisterRequest,
)


def read_registers_pdu(function: int, address: int, count: int) -> bytes:
    """Request PDU of functions 3 and 4; V1.1b3 sections 6.3 and 6.4."""
    kind = ReadHoldingRegistersRequest if function == 3 else ReadInputRegistersRequest
    return bytes([function]) + kind(address=address, count=count).encode()


def write_register_pdu(address: int, value: int) -> bytes:
    """Request PDU of function 6; V1.1b3 section 6.6."""
    return bytes([6]) + WriteSingleRegisterRequest(address=address, registers=[value]).encode()


def crc(octets: bytes) -> bytes:
    """The two checksum octets that follow ``octets`` on the wire, low octet first."""
    return FramerRTU.compute_CRC(octets).to_bytes(2)

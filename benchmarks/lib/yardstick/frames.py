"""The octets of the one read that is measured, by the standard library alone.

Register ``a + i`` of every device holds ``a + i``, so that an answer shows what it answers.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Final

UNIT: Final = 1
REGISTERS: Final = 27
REQUEST_SIZE: Final = 8
"""Octets of an RTU request of function 3."""
ANSWER_SIZE: Final = 5 + 2 * REGISTERS
TCP_REQUEST_SIZE: Final = 12
_HEADER_TAIL: Final = struct.Struct(">HHB")
"""The MBAP header behind the transaction number: protocol, length, unit."""


def _table() -> tuple[int, ...]:
    entries = []
    for octet in range(256):
        value = octet
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
        entries.append(value)
    return tuple(entries)


_CRC: Final = _table()


def crc(octets: bytes) -> bytes:
    """MODBUS over Serial Line V1.02, 6.2.2; low octet first."""
    value = 0xFFFF
    for octet in octets:
        value = value >> 8 ^ _CRC[(value ^ octet) & 0xFF]
    return value.to_bytes(2, "little")


@cache
def registers(address: int) -> tuple[int, ...]:
    """What a read of REGISTERS from ``address`` on must give."""
    return tuple((address + i) & 0xFFFF for i in range(REGISTERS))


def request_pdu(address: int) -> bytes:
    return struct.pack(">BHH", 3, address, REGISTERS)


def answer_pdu(address: int) -> bytes:
    values = registers(address)
    return bytes([3, 2 * REGISTERS]) + struct.pack(f">{REGISTERS}H", *values)


@cache
def rtu_request(address: int) -> bytes:
    body = bytes([UNIT]) + request_pdu(address)
    return body + crc(body)


@cache
def rtu_answer(address: int) -> bytes:
    body = bytes([UNIT]) + answer_pdu(address)
    return body + crc(body)


def tcp_tail(pdu: bytes, unit: int = UNIT) -> bytes:
    """An ADU without its transaction number."""
    return _HEADER_TAIL.pack(0, 1 + len(pdu), unit) + pdu


def rtu_address(request: bytes) -> int | None:
    """The first register that a request asks for; None where it is not the measured read."""
    if len(request) != REQUEST_SIZE:
        return None
    address = int.from_bytes(request[2:4])
    return address if request == rtu_request(address) else None

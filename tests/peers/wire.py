"""Modbus octets as a device sees them: CRC, RTU and MBAP framing, requests of FC 3, 6 and 16."""

from __future__ import annotations

from dataclasses import dataclass

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3

READ = 3
WRITE_ONE = 6
WRITE_MANY = 16

IDLE_GAP = 0.005
"""Seconds of silence that end a frame of unknown length (ROC document 2.4: 4 to 5 ms)."""

_FIXED_LENGTH = 8
_COUNTED_AT = 6
_COUNTED_EXTRA = 9
_RTU_MIN = 4
_MBAP_HEADER = 7
_MBAP_LENGTHS = range(2, 255)
_MAX_READ = 125
_MAX_WRITE = 123


class PduError(Exception):
    """A request that is answered by the exception `code`."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class StreamError(Exception):
    """An MBAP stream that cannot be followed any further: the connection has to be closed."""


@dataclass(frozen=True)
class Request:
    unit: int
    pdu: bytes
    transaction: int = 0


@dataclass(frozen=True)
class Read:
    address: int
    count: int


@dataclass(frozen=True)
class Write:
    function: int
    address: int
    values: tuple[int, ...]


def crc16(octets: bytes) -> int:
    crc = 0xFFFF
    for octet in octets:
        crc ^= octet
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + crc16(body).to_bytes(2, "little")


def mbap_frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    length = len(pdu) + 1
    header = transaction.to_bytes(2, "big") + b"\0\0" + length.to_bytes(2, "big")
    return header + bytes([unit]) + pdu


def exception_pdu(function: int, code: int) -> bytes:
    return bytes([function | 0x80, code])


def octets_of(registers: list[int] | tuple[int, ...]) -> bytes:
    return b"".join(register.to_bytes(2, "big") for register in registers)


def _crc_good(frame: bytes) -> bool:
    return len(frame) >= _RTU_MIN and crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


class RtuFramer:
    """Cuts requests out of a serial line; `idle` has to be called after `IDLE_GAP` of silence."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def __bool__(self) -> bool:
        return bool(self._buffer)

    def feed(self, octets: bytes) -> list[Request]:
        self._buffer += octets
        requests = []
        while (length := self._length()) and len(self._buffer) >= length:
            frame = bytes(self._buffer[:length])
            if not _crc_good(frame):
                break  # out of step: only silence tells where the next frame starts
            del self._buffer[:length]
            requests.append(Request(frame[0], frame[1:-2]))
        return requests

    def idle(self) -> tuple[list[Request], bytes]:
        """Requests ended by the silence, and the octets thrown away by it."""
        frame = bytes(self._buffer)
        self._buffer.clear()
        if _crc_good(frame):
            return [Request(frame[0], frame[1:-2])], b""
        return [], frame

    def _length(self) -> int:
        """Octets of the request that starts the buffer, 0 while that cannot be told."""
        if len(self._buffer) < 2:  # unit and function code
            return 0
        function = self._buffer[1]
        if 1 <= function <= WRITE_ONE:
            return _FIXED_LENGTH
        if function == WRITE_MANY and len(self._buffer) > _COUNTED_AT:
            return _COUNTED_EXTRA + self._buffer[_COUNTED_AT]
        return 0


class MbapFramer:
    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, octets: bytes) -> list[Request]:
        self._buffer += octets
        requests = []
        while len(self._buffer) >= _MBAP_HEADER:
            protocol = int.from_bytes(self._buffer[2:4], "big")
            length = int.from_bytes(self._buffer[4:6], "big")
            if protocol or length not in _MBAP_LENGTHS:
                raise StreamError(self._buffer[:_MBAP_HEADER].hex(" "))
            if len(self._buffer) < (end := 6 + length):
                break
            transaction = int.from_bytes(self._buffer[:2], "big")
            requests.append(Request(self._buffer[6], bytes(self._buffer[7:end]), transaction))
            del self._buffer[:end]
        return requests


def parse(pdu: bytes) -> Read | Write:
    """Function code first, then the form of the request; addresses are the device's matter."""
    function, body = pdu[0], pdu[1:]
    if function not in (READ, WRITE_ONE, WRITE_MANY):
        raise PduError(ILLEGAL_FUNCTION)
    if len(body) < 4 or (function != WRITE_MANY and len(body) != 4):
        raise PduError(ILLEGAL_VALUE)
    address = int.from_bytes(body[:2], "big")
    second = int.from_bytes(body[2:4], "big")
    if function == READ:
        if not 1 <= second <= _MAX_READ:
            raise PduError(ILLEGAL_VALUE)
        return Read(address, second)
    if function == WRITE_ONE:
        return Write(function, address, (second,))
    data = body[5:]
    if not 1 <= second <= _MAX_WRITE or len(data) != 2 * second or body[4] != len(data):
        raise PduError(ILLEGAL_VALUE)
    values = tuple(int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2))
    return Write(function, address, values)

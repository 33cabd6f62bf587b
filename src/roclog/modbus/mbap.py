"""One TCP request and its answer: MBAP header, Messaging on TCP/IP V1.0b section 3.1.3."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from roclog.errors import LinkDown, WrongAnswer

if TYPE_CHECKING:
    from roclog.modbus.request import Request

_HEADER: Final = struct.Struct(">HHHB")
_MAX_PDU: Final = 253


class MbapExchange:
    """Feed it octets until it returns the answer's PDU. Answers to earlier requests are skipped."""

    def __init__(self, unit: int, request: Request, transaction: int) -> None:
        self.adu = _HEADER.pack(transaction, 0, 1 + len(request.pdu), unit) + request.pdu
        self.stale = 0
        self._unit = unit
        self._transaction = transaction
        self._buffer = bytearray()

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception, once it is whole; None while it is not.

        Raises:
            LinkDown: this is not a Modbus stream; nothing after it can be framed.
            WrongAnswer: the transaction fits, the unit does not.
        """
        self._buffer += octets
        while len(self._buffer) >= _HEADER.size:
            transaction, protocol, length, unit = _HEADER.unpack_from(self._buffer)
            if protocol != 0 or not 3 <= length <= _MAX_PDU + 1:
                start = bytes(self._buffer[:16]).hex(" ")
                raise LinkDown(f"not a Modbus TCP stream (octets {start}), connection closed")
            if len(self._buffer) < 6 + length:
                return None
            pdu = bytes(self._buffer[_HEADER.size : 6 + length])
            del self._buffer[: 6 + length]
            if transaction != self._transaction:
                self.stale += 1
            elif unit != self._unit:
                raise WrongAnswer(f"asked unit {self._unit}, unit {unit} answered", pdu)
            else:
                return pdu
        return None

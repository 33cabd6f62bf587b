"""One TCP or UDP request and its answer: MBAP header, Messaging on TCP/IP V1.0b section 3.1.3."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from roclog.errors import LinkDown, WrongAnswer

if TYPE_CHECKING:
    from roclog.modbus.request import Request

_HEADER: Final = struct.Struct(">HHHB")
_MIN_PDU: Final = 2
_MAX_PDU: Final = 253


@dataclass(frozen=True, slots=True)
class Frame:
    """One ADU, taken apart."""

    transaction: int
    unit: int
    pdu: bytes


class MbapStream:
    """The frames of one connection. It outlives an exchange: a frame may end in the next one."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def has_octets(self) -> bool:
        return bool(self._buffer)

    def receive(self, octets: bytes) -> None:
        self._buffer += octets

    def next_frame(self) -> Frame | None:
        """The next whole frame, None until more octets come.

        Raises:
            LinkDown: this is not a Modbus stream; nothing after it can be framed.
        """
        if len(self._buffer) < _HEADER.size:
            return None
        transaction, protocol, length, unit = _HEADER.unpack_from(self._buffer)
        if protocol != 0 or not 1 + _MIN_PDU <= length <= 1 + _MAX_PDU:
            start = bytes(self._buffer[:16]).hex(" ")
            raise LinkDown(f"not a Modbus TCP stream (octets {start}), connection closed")
        end = _HEADER.size - 1 + length
        if len(self._buffer) < end:
            return None
        frame = Frame(transaction, unit, bytes(self._buffer[_HEADER.size : end]))
        del self._buffer[:end]
        return frame


class MbapExchange:
    """Feed it octets until it returns the answer's PDU. Answers to earlier requests are skipped."""

    def __init__(self, unit: int, request: Request, transaction: int, stream: MbapStream) -> None:
        self.adu = _HEADER.pack(transaction, 0, 1 + len(request.pdu), unit) + request.pdu
        self.stale = 0
        self._unit = unit
        self._transaction = transaction
        self._stream = stream

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception, once it is whole; None while it is not.

        Raises:
            LinkDown: as MbapStream.next_frame.
            WrongAnswer: the transaction fits, the unit does not.
        """
        self._stream.receive(octets)
        while (frame := self._stream.next_frame()) is not None:
            if frame.transaction != self._transaction:
                self.stale += 1
            elif frame.unit != self._unit:
                raise WrongAnswer(f"asked unit {self._unit}, unit {frame.unit} answered", frame.pdu)
            else:
                return frame.pdu
        return None


def whole_frame(datagram: bytes) -> Frame | None:
    """The frame that a datagram is; None where it is less, more or something else."""
    stream = MbapStream()
    stream.receive(datagram)
    try:
        frame = stream.next_frame()
    except LinkDown:
        return None
    return None if frame is None or stream.has_octets else frame


class DatagramExchange(MbapExchange):
    """As MbapExchange, where each piece is a datagram: one whole answer, or none."""

    def __init__(self, unit: int, request: Request, transaction: int) -> None:
        super().__init__(unit, request, transaction, MbapStream())

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception; None where the datagram belongs to another request.

        Raises:
            WrongAnswer: the unit does not fit, or the datagram is not one whole answer.
        """
        if whole_frame(octets) is not None:
            return super().feed(octets)
        if len(octets) >= 2 and octets[:2] != self.adu[:2]:
            self.stale += 1
            return None
        raise WrongAnswer(f"a datagram of {len(octets)} octets that is not one answer", octets)

"""One TCP or UDP request and its answer: MBAP header, Messaging on TCP/IP V1.0b section 3.1.3."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from roclog.errors import LinkDown, WrongAnswer
from roclog.modbus.dialect import STANDARD, ByteOrder, Dialect

if TYPE_CHECKING:
    from roclog.modbus.request import Request

_HEADERS: Final[dict[ByteOrder, struct.Struct]] = {
    "big": struct.Struct(">HHHB"),
    "little": struct.Struct("<HHHB"),
}
_HEADER_SIZE: Final = 7
_MIN_PDU: Final = 2


@dataclass(frozen=True, slots=True)
class Frame:
    """One ADU, taken apart."""

    transaction: int
    unit: int
    pdu: bytes


class MbapStream:
    """The frames of one connection. It outlives an exchange: a frame may end in the next one."""

    def __init__(self, dialect: Dialect = STANDARD) -> None:
        self.dialect = dialect
        self._header = _HEADERS[dialect.order]
        self._max_length = 1 + dialect.max_pdu
        self._buffer = bytearray()

    @property
    def size(self) -> int:
        """Octets that belong to frames not yet handed out."""
        return len(self._buffer)

    def receive(self, octets: bytes) -> None:
        self._buffer += octets

    def next_frame(self) -> Frame | None:
        """The next whole frame, None until more octets come.

        Raises:
            LinkDown: this is not a Modbus stream; nothing after it can be framed.
        """
        if len(self._buffer) < _HEADER_SIZE:
            return None
        transaction, protocol, length, unit = self._header.unpack_from(self._buffer)
        if protocol != 0 or not 1 + _MIN_PDU <= length <= self._max_length:
            hint = _other_order(self._buffer, self.dialect)
            start = bytes(self._buffer[:16]).hex(" ")
            raise LinkDown(f"not a Modbus TCP stream{hint} (octets {start}), connection closed")
        end = _HEADER_SIZE - 1 + length
        if len(self._buffer) < end:
            return None
        frame = Frame(transaction, unit, bytes(self._buffer[_HEADER_SIZE:end]))
        del self._buffer[:end]
        return frame


class MbapExchange:
    """Feed it octets until it returns the answer's PDU. Answers to earlier requests are skipped.

    answer_start: how many octets were fed before those of the answer, once it is known.
    stale: how many were skipped. stale_units: of which units, as far as they are whole.
    """

    def __init__(self, unit: int, request: Request, transaction: int, stream: MbapStream) -> None:
        header = _HEADERS[stream.dialect.order]
        self.adu = header.pack(transaction, 0, 1 + len(request.pdu), unit) + request.pdu
        self.stale = 0
        self.stale_units: list[int] = []
        self.answer_start = 0
        self._fed = 0
        self._unit = unit
        self._request = request
        self._transaction = transaction
        self._stream = stream

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception, once it is whole; None while it is not.

        Raises:
            LinkDown: as MbapStream.next_frame.
            WrongAnswer: the transaction fits, the unit or the size of the byte count does not.
        """
        self._fed += len(octets)
        self._stream.receive(octets)
        while (frame := self._stream.next_frame()) is not None:
            if frame.transaction != self._transaction:
                self.stale += 1
                self.stale_units.append(frame.unit)
            elif frame.unit != self._unit:
                text = f"asked unit {self._unit}, unit {frame.unit} answered"
                raise WrongAnswer(text, frame.pdu, is_strange=True)
            else:
                dialect = self._stream.dialect
                if dialect.wide_below:
                    dialect.check_count_size(self._request.pdu, frame.pdu)
                behind = self._stream.size + _HEADER_SIZE + len(frame.pdu)
                self.answer_start = max(0, self._fed - behind)
                return frame.pdu
        return None


def whole_frame(datagram: bytes, dialect: Dialect = STANDARD) -> Frame | None:
    """The frame that a datagram is; None where it is less, more or something else."""
    stream = MbapStream(dialect)
    stream.receive(datagram)
    try:
        frame = stream.next_frame()
    except LinkDown:
        return None
    return None if frame is None or stream.size else frame


class DatagramExchange(MbapExchange):
    """As MbapExchange, where each piece is a datagram: one whole answer, or none."""

    def __init__(
        self, unit: int, request: Request, transaction: int, dialect: Dialect = STANDARD
    ) -> None:
        super().__init__(unit, request, transaction, MbapStream(dialect))

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception; None where the datagram belongs to another request.

        Raises:
            WrongAnswer: as MbapExchange.feed, or the datagram is not one whole answer.
        """
        dialect = self._stream.dialect
        if whole_frame(octets, dialect) is not None:
            return super().feed(octets)
        if len(octets) >= 2 and octets[:2] != self.adu[:2]:
            self.stale += 1
            self._fed += len(octets)
            return None
        hint = _other_order(octets, dialect)
        raise WrongAnswer(
            f"a datagram of {len(octets)} octets that is not one answer{hint}",
            octets,
            is_strange=True,
        )


def _other_order(octets: bytes | bytearray, dialect: Dialect) -> str:
    """Words for a header that makes sense in the other byte order only."""
    other: ByteOrder = "little" if dialect.order == "big" else "big"
    if _is_sane(octets, dialect.order, dialect) or not _is_sane(octets, other, dialect):
        return ""
    return f", its header is {other} endian"


def _is_sane(octets: bytes | bytearray, order: ByteOrder, dialect: Dialect) -> bool:
    if len(octets) < _HEADER_SIZE:
        return False
    protocol, length = (int.from_bytes(octets[at : at + 2], order) for at in (2, 4))
    return protocol == 0 and 1 + _MIN_PDU <= length <= 1 + dialect.max_pdu

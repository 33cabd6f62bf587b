"""Octets as an MSX-E sees them, in either byte order: frames in, calls out, answers in frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from wire import ILLEGAL_FUNCTION, ILLEGAL_VALUE, PduError, StreamError

if TYPE_CHECKING:
    from msx_options import Order

READ, WRITE, READ_WRITE = 3, 16, 23
FIRST_WITH_SHORT_COUNT = 1000
"""Byte counts have 16 bits where the register is below this."""

_HEADER = 7
_LENGTHS = range(2, 300)


@dataclass(frozen=True)
class Frame:
    number: int
    unit: int
    pdu: bytes


@dataclass(frozen=True)
class Call:
    """Function code with what it asks: `register` and `words` to read, `written` with octets."""

    function: int
    register: int | None = None
    words: int = 0
    written: int | None = None
    parameters: bytes = b""


class Framer:
    def __init__(self, order: Order) -> None:
        self._order: Order = order
        self._buffer = b""

    def feed(self, octets: bytes) -> list[Frame]:
        self._buffer += octets
        frames = []
        while len(self._buffer) >= _HEADER:
            number, protocol, length = (self._word(at) for at in (0, 2, 4))
            if protocol or length not in _LENGTHS:
                raise StreamError(self._buffer[:_HEADER].hex(" "))
            end = 6 + length
            if len(self._buffer) < end:
                break
            frames.append(Frame(number, self._buffer[6], self._buffer[_HEADER:end]))
            self._buffer = self._buffer[end:]
        return frames

    def datagram(self, octets: bytes) -> Frame:
        self._buffer = b""
        frames = self.feed(octets)
        if len(frames) != 1 or self._buffer:
            raise StreamError(octets.hex(" "))
        return frames[0]

    def _word(self, at: int) -> int:
        return int.from_bytes(self._buffer[at : at + 2], self._order)


def frame_octets(frame: Frame, order: Order) -> bytes:
    words = (frame.number, 0, 1 + len(frame.pdu))
    return b"".join(w.to_bytes(2, order) for w in words) + bytes([frame.unit]) + frame.pdu


def parse(pdu: bytes, order: Order) -> Call:
    """Raises PduError with the exception that the device answers."""
    function, body = pdu[0], pdu[1:]

    def word(at: int) -> int:
        if len(body) < at + 2:
            raise PduError(ILLEGAL_VALUE)
        return int.from_bytes(body[at : at + 2], order)

    def counted(at: int, register: int, words: int) -> bytes:
        size = count_size(register)
        count, octets = body[at : at + size], body[at + size :]
        if int.from_bytes(count, order) != len(octets) or len(octets) != 2 * words:
            raise PduError(ILLEGAL_VALUE)
        return octets

    if function == READ:
        if len(body) != 4:
            raise PduError(ILLEGAL_VALUE)
        return Call(READ, register=word(0), words=word(2))
    if function == WRITE:
        return Call(WRITE, written=word(0), parameters=counted(4, word(0), word(2)))
    if function == READ_WRITE:
        parameters = counted(8, word(4), word(6))
        return Call(READ_WRITE, word(0), word(2), word(4), parameters)
    raise PduError(ILLEGAL_FUNCTION)


def count_size(register: int) -> int:
    return 1 if register >= FIRST_WITH_SHORT_COUNT else 2


def counted_answer(function: int, size: int, payload: bytes, order: Order) -> bytes:
    """`size`: octets of the byte count."""
    return bytes([function]) + len(payload).to_bytes(size, order) + payload

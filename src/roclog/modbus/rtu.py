"""One RTU request and the hunt for its answer among whatever else is on the line.

The length of an answer follows from its request, so a frame is recognised by its head, its length
and its checksum wherever it begins; gaps between octets mean nothing behind a USB adapter.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING

from roclog.modbus.library import crc
from roclog.modbus.request import EXCEPTION_BIT, Request

if TYPE_CHECKING:
    from collections.abc import Iterator


class Echo(Enum):
    """Whether the adapter hands back what it sends. Learnt from reads, needed to judge writes."""

    UNKNOWN = auto()
    ABSENT = auto()
    PRESENT = auto()


class RtuExchange:
    """Feed it octets until it returns the answer's PDU.

    A read's answer cannot equal its request (5 + 2n octets against 8), a write's answer always
    does: on a line that echoes, the first copy of a write is not its answer.
    """

    def __init__(self, unit: int, request: Request, echo: Echo) -> None:
        body = bytes([unit]) + request.pdu
        self.adu = body + crc(body)
        self.echo = echo
        self._head = bytes([unit]) + request.head
        self._refusal = bytes([unit, request.pdu[0] | EXCEPTION_BIT])
        self._size = 1 + request.answer_size + 2
        self._answer_echoes = self._head == body
        self._buffer = bytearray()

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception, once it is whole; None while it is not."""
        self._buffer += octets
        self._drop_echo()
        for start, size in self._candidates():
            frame = bytes(self._buffer[start : start + size])
            if len(frame) == size and crc(frame[:-2]) == frame[-2:]:
                del self._buffer[start : start + size]
                if not self._answer_echoes and self.echo is Echo.UNKNOWN:
                    self.echo = Echo.ABSENT
                return frame[1:-2]
        return None

    @property
    def damaged(self) -> bool:
        """The answer came, head and length right and checksum wrong: no other will follow."""
        start = self._buffer.find(self._head)
        return start >= 0 and len(self._buffer) - start >= self._size

    @property
    def leftover(self) -> bytes:
        """Octets that belong to no answer."""
        return bytes(self._buffer)

    @property
    def intact_stranger(self) -> bool:
        """The leftover is a whole frame of somebody else, or one that answers another question."""
        return len(self._buffer) >= 4 and crc(self.leftover[:-2]) == self.leftover[-2:]

    def _drop_echo(self) -> None:
        if self._answer_echoes and self.echo is not Echo.PRESENT:
            return
        start = self._buffer.find(self.adu)
        if start >= 0:
            del self._buffer[start : start + len(self.adu)]
            if self._answer_echoes:
                self._answer_echoes = False
            else:
                self.echo = Echo.PRESENT

    def _candidates(self) -> Iterator[tuple[int, int]]:
        for start in range(len(self._buffer)):
            if self._buffer.startswith(self._head, start):
                yield start, self._size
            if self._buffer.startswith(self._refusal, start):
                yield start, 5

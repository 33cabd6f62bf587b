"""One RTU request and the hunt for its answer among whatever else is on the line.

The length of an answer follows from its request, or from its own first octets, so a frame is
recognised by its head, its length and its checksum wherever it begins; gaps between octets mean
nothing behind a USB adapter.

1. Octets are judged in order. As long as an earlier octet may still begin the echo or the answer,
   a later one is not looked at: how the octets were cut into pieces changes nothing.
2. Octets that look like the beginning of an answer and fail the checksum end nothing by themselves.
   They may have been noise or a damaged echo, with the answer still to come; to ask again before it
   came would let it pass for the next one. ``spoiled`` says when only the answer can look so.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING

from roclog.modbus.library import crc
from roclog.modbus.request import SelfSized, refusals

if TYPE_CHECKING:
    from roclog.modbus.request import Request


class Echo(Enum):
    """Whether the adapter hands back what it sends. Learnt from reads, needed to judge writes."""

    UNKNOWN = auto()
    ABSENT = auto()
    PRESENT = auto()


class RtuExchange:
    """Feed it octets until it returns the answer's PDU.

    answer_start: how many octets were fed before those of the answer, once it is known.

    A read's answer cannot equal its request, a write's answer always does: unless the line is known
    not to echo, the first copy of a write is not its answer.
    """

    def __init__(self, unit: int, request: Request, echo: Echo) -> None:
        body = bytes([unit]) + request.pdu
        self.adu = body + crc(body)
        self.echo = echo
        head = bytes([unit]) + request.head
        self._head = head
        self._size = 1 + request.answer_size + 2
        self._self_sized = request if isinstance(request, SelfSized) else None
        self._shapes = [(bytes([unit]) + start, 1 + n + 2) for start, n in refusals(request)]
        self._shapes.append((head, self._size))
        self._answer_is_copy = head == body
        self._echo_due = not self._answer_is_copy or echo is not Echo.ABSENT
        if self._echo_due:
            self._shapes.insert(0, (self.adu, len(self.adu)))
        self._echoed = False
        self._buffer = bytearray()
        self._judged = 0
        self._removed = 0
        self.answer_start = 0

    def feed(self, octets: bytes) -> bytes | None:
        """The PDU, normal or exception, once it is whole; None while it is not."""
        self._buffer += octets
        return self._hunt(over=False)

    def conclude(self) -> bytes | None:
        """The PDU that was held back by octets which more octets could have made an answer."""
        return self._hunt(over=True)

    @property
    def spoiled(self) -> bool:
        """The last octets have head and length of the answer, on a line that does not echo.

        If nothing follows them, they were the answer, damaged, and no other will come.
        """
        start = self._buffer.find(self._head)
        if self.echo is not Echo.ABSENT or start < 0:
            return False
        return len(self._buffer) - start == self._size_at(start)

    @property
    def leftover(self) -> bytes:
        """Octets that belong neither to the answer nor to the echo."""
        return bytes(self._buffer)

    @property
    def intact_stranger(self) -> bool:
        """The leftover is a whole frame of somebody else, or one that answers another question."""
        return len(self._buffer) >= 4 and crc(self.leftover[:-2]) == self.leftover[-2:]

    def _hunt(self, *, over: bool) -> bytes | None:
        while (start := self._buffer.find(self.adu[0], self._judged)) >= 0:
            self._judged = start
            frame = self._frame_at(start, over=over)
            if frame is None:
                return None
            del self._buffer[start : start + len(frame)]
            if not frame:
                self._judged += 1
            elif self._echo_due and frame == self.adu:
                self._removed += len(frame)
                self._take_echo()
            else:
                self.answer_start = self._removed + start
                self._learn(start)
                return frame[1:-2]
        self._judged = len(self._buffer)
        return None

    def _frame_at(self, start: int, *, over: bool) -> bytes | None:
        """The frame that begins here, empty where none does, None where more octets must tell."""
        for head, fixed in self._shapes:
            if not head.startswith(bytes(self._buffer[start : start + len(head)])):
                continue
            size = self._size_at(start) if head is self._head else fixed
            if len(self._buffer) - start >= size:
                frame = bytes(self._buffer[start : start + size])
                if crc(frame[:-2]) == frame[-2:]:
                    return frame
            elif not over:
                return None
        return b""

    def _size_at(self, start: int) -> int:
        """Octets of the normal answer that begins here, as far as they tell."""
        if self._self_sized is None:
            return self._size
        return 1 + self._self_sized.size_of(bytes(self._buffer[start + 1 :])) + 2

    def _take_echo(self) -> None:
        self._echoed = True
        self._echo_due = False
        del self._shapes[0]
        if not self._answer_is_copy:
            self.echo = Echo.PRESENT

    def _learn(self, octets_before: int) -> None:
        """More than a glitch before the answer may have been a damaged echo: nothing is learnt."""
        if self._echoed:
            self.echo = Echo.PRESENT
        elif octets_before < len(self.adu) // 2:
            self.echo = Echo.ABSENT

"""A serial client with the best known policy for late answers, and nothing else.

It keeps the silence by an absolute deadline. After a time-out it listens until the late answer has
come or can no longer come, and only then asks again.
"""

from __future__ import annotations

import os
import select
import struct
import time
import tty
from typing import TYPE_CHECKING

from yardstick.frames import ANSWER_SIZE, REGISTERS, crc, rtu_request

if TYPE_CHECKING:
    from yardstick.job import Job

_WORDS = struct.Struct(f">{REGISTERS}H")


class DroppingLate:
    """A late answer ends the wait, and its read has failed."""

    failures: tuple[type[Exception], ...] = (TimeoutError,)
    keeps_late = False

    def __init__(self, job: Job) -> None:
        self._job = job
        self._descriptor = -1
        self._free = 0.0
        self.late_us: list[float] = []

    def open(self) -> None:
        self._descriptor = os.open(self._job.port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._descriptor)

    def read(self, address: int) -> tuple[int, ...]:
        request = rtu_request(address)
        if (left := self._free - time.monotonic()) > 0:
            time.sleep(left)
        asked = time.monotonic()
        if self._free:
            self.late_us.append((asked - self._free) * 1e6)
        os.write(self._descriptor, request)
        sent = asked + len(request) * 10 / self._job.baud
        received = self._listen(b"", sent + self._job.timeout)
        if len(received) < ANSWER_SIZE:
            received = self._listen(received, asked + self._job.late_answer)
            if not self.keeps_late or len(received) < ANSWER_SIZE:
                raise TimeoutError
        if received[:3] != request[:2] + bytes([2 * REGISTERS]):
            raise TimeoutError("this is another answer")
        if crc(received[:-2]) != received[-2:]:
            raise TimeoutError("the answer is damaged")
        return _WORDS.unpack_from(received, 3)

    def close(self) -> None:
        os.close(self._descriptor)

    def _listen(self, received: bytes, end: float) -> bytes:
        while len(received) < ANSWER_SIZE and (left := end - time.monotonic()) > 0:
            if select.select([self._descriptor], [], [], left)[0]:
                received += os.read(self._descriptor, 4096)
        self._free = time.monotonic() + self._job.silence
        return received


class KeepingLate(DroppingLate):
    """A late answer is the answer: nothing else was asked meanwhile."""

    keeps_late = True

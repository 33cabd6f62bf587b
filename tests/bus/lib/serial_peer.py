"""The far end of a pseudo-terminal: a thread that reads requests and answers by a script."""

from __future__ import annotations

import os
import random
import select
import threading
import time
import tty
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

from wire import rtu_frame

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Answerer = Callable[[bytes], list[tuple[float, bytes]]]


def registers(adu: bytes) -> list[tuple[float, bytes]]:
    """Every register holds its own address."""
    first, count = int.from_bytes(adu[2:4]), int.from_bytes(adu[4:6])
    data = b"".join((first + index & 0xFFFF).to_bytes(2) for index in range(count))
    return [(0.001, rtu_frame(adu[0], bytes([adu[1], len(data)]) + data))]


@dataclass
class SerialPeer:
    """``link`` points to the terminal that a client opens.

    answerer: from a request to (seconds to wait, octets to send) in turn.
    deaf: requests that come while an answer is under way are lost.
    asked, answered: CLOCK_MONOTONIC nanoseconds of each frame, a wire that takes no time.
    """

    link: Path
    answerer: Answerer = registers
    deaf: bool = False
    asked: list[int] = field(default_factory=list)
    answered: list[int] = field(default_factory=list)

    def __enter__(self) -> Self:
        self.master, self._terminal = os.openpty()
        tty.setraw(self._terminal)
        os.set_blocking(self.master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._terminal))
        self._wake, self._end = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.hang_up()

    def stop_listening(self) -> None:
        if self._end >= 0:
            os.close(self._end)
            self._thread.join()
            os.close(self._wake)
            self._end = -1

    def hang_up(self) -> None:
        self.stop_listening()
        if self.master >= 0:
            os.close(self.master)
            os.close(self._terminal)
            self.master = -1

    def _serve(self) -> None:
        waiting = b""
        while True:
            ready, _, _ = select.select([self.master, self._wake], [], [])
            if self._wake in ready:
                return
            waiting += self._read()
            while len(waiting) >= 8:
                self.asked.append(time.monotonic_ns())
                adu, waiting = waiting[:8], waiting[8:]
                self._answer(adu)
                if self.deaf:
                    self._read()
                    waiting = b""

    def _answer(self, adu: bytes) -> None:
        for delay, octets in self.answerer(adu):
            time.sleep(delay)
            self.answered.append(time.monotonic_ns())
            os.write(self.master, octets)

    def _read(self) -> bytes:
        try:
            return os.read(self.master, 512)
        except BlockingIOError:
            return b""


def late_in_a_tenth(seed: int, shortest: float, longest: float) -> Answerer:
    rng = random.Random(seed)

    def answer(adu: bytes) -> list[tuple[float, bytes]]:
        [(delay, octets)] = registers(adu)
        return [(rng.uniform(shortest, longest) if rng.random() < 0.1 else delay, octets)]

    return answer

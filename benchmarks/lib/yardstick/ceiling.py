"""How many polls a second the documents allow on a serial line."""

from __future__ import annotations

import math
from dataclasses import dataclass

from yardstick.frames import ANSWER_SIZE, REQUEST_SIZE

_FIXED_ABOVE = 19_200
_FIXED_SILENCE = 1.75e-3


@dataclass(frozen=True)
class Line:
    """baud: 8N1, so ten bits a character. tick: of a USB adapter. Seconds."""

    baud: int
    turnaround: float = 0.010
    tick: float = 0.0

    @property
    def name(self) -> str:
        tick = f", {self.tick * 1e3:g} ms tick" if self.tick else ""
        return f"{self.baud} 8N1{tick}"

    @property
    def character(self) -> float:
        return 10 / self.baud

    @property
    def silence(self) -> float:
        """3.5 characters; 1.75 ms above 19200 Bd (Modbus over Serial Line V1.02, 2.5.1.1)."""
        return _FIXED_SILENCE if self.baud > _FIXED_ABOVE else 3.5 * self.character

    @property
    def cycle(self) -> float:
        """From request to request: request, turnaround, answer, silence.

        With a tick the answer is seen at the next one only, and the silence begins there: no client
        knows when the last octet really ended.
        """
        octets = REQUEST_SIZE + ANSWER_SIZE
        cycle = octets * self.character + self.turnaround + self.silence
        return math.ceil(cycle / self.tick) * self.tick if self.tick else cycle

    @property
    def ceiling(self) -> float:
        """Polls a second."""
        return 1 / self.cycle

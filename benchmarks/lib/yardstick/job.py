"""What a client is asked to do and what it reports; both cross a process border as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field


@dataclass(frozen=True, kw_only=True)
class Job:
    """One measurement of one client.

    port: of a serial line, as a path; empty with TCP. baud: of that line.
    timeout, late_answer, silence: seconds; the client's settings, where it has such.
    polls: how many, or as many as fit into ``seconds``. moving: every read from other registers.
    """

    client: str
    port: str = ""
    baud: int = 9600
    tcp_port: int = 0
    connections: int = 1
    timeout: float = 0.5
    late_answer: float = 1.0
    silence: float = 0.0
    polls: int | None = None
    seconds: float = 0.0
    moving: bool = False

    def address(self, poll: int) -> int:
        """Where the read of this number begins."""
        return poll * 64 & 0xFFFF if self.moving else 300

    def to_json(self) -> str:
        return json.dumps(asdict(self))


@dataclass(kw_only=True)
class Outcome:
    """good: right registers. wrong: others, given as an answer. failed: an error was raised.

    wall, cpu: seconds from the first measured request to the last answer, of the whole process.
    system: the part of ``cpu`` in the kernel; sampled by ticks, so only the sum is exact.
    late_us: how long after the silence each request went out, where the client can tell.
    """

    good: int = 0
    wrong: int = 0
    failed: int = 0
    wall: float = 0.0
    cpu: float = 0.0
    system: float = 0.0
    late_us: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Good reads a second."""
        return self.good / self.wall

    @property
    def cpu_us(self) -> float:
        """Microseconds of processor time for a read, whatever came of it."""
        return self.cpu / (self.good + self.wrong + self.failed) * 1e6

    @property
    def system_us(self) -> float:
        return self.system / (self.good + self.wrong + self.failed) * 1e6

    def to_json(self) -> str:
        return json.dumps(asdict(self))

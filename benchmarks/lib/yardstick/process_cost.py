"""What this process has cost so far."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Cost:
    """wall: of the monotonic clock. cpu: of all threads. loop: of the thread that asks; seconds.

    memory, most_memory: octets.
    """

    wall: float
    cpu: float
    loop: float
    memory: int
    most_memory: int


def cost() -> Cost:
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return Cost(
        wall=time.monotonic(),
        cpu=time.process_time(),
        loop=time.thread_time(),
        memory=1024 * int(status["VmRSS"].split()[0]),
        most_memory=1024 * int(status["VmHWM"].split()[0]),
    )


def since(before: Cost) -> dict[str, Any]:
    """Seconds spent since then, and the memory now."""
    now = cost()
    spent = {name: getattr(now, name) - getattr(before, name) for name in ("wall", "cpu", "loop")}
    return {**asdict(now), **spent}

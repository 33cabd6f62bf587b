"""``python -m yardstick.recording_run FOLDER PORT DEVICES SECONDS``: one recording, measured.

Prints what it cost and when each poll began, as one line of JSON.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roclog.clock import SystemClock
from roclog.runner import keep_for_good
from roclog.session import Session
from yardstick.fleet import settings
from yardstick.process_cost import cost, since

if TYPE_CHECKING:
    from roclog.clock import Instant
    from roclog.outbox import Outbox
    from roclog.polling.poller import Poller

_PERIOD = 10**9


class TimedPoller:
    """A poller that notes when each of its turns was due and when it began."""

    def __init__(self, poller: Poller) -> None:
        self._poller = poller
        self.turns: list[tuple[int, int]] = []

    @property
    def name(self) -> str:
        return self._poller.name

    @property
    def period(self) -> int:
        return self._poller.period

    @property
    def outbox(self) -> Outbox:
        return self._poller.outbox

    @property
    def samples(self) -> int:
        return self._poller.samples

    def expect(self, due: int) -> None:
        self._poller.expect(due)

    async def turn(self, due: int) -> None:
        self.turns.append((due, time.monotonic_ns()))
        await self._poller.turn(due)

    def close(self, now: Instant, *, is_end: bool = True) -> None:
        self._poller.close(now, is_end=is_end)


async def run(folder: Path, port: int, devices: int, seconds: float) -> dict[str, Any]:
    before = cost()
    timed: dict[str, TimedPoller] = {}
    async with Session(settings(folder, port, devices, _PERIOD), SystemClock()) as session:
        for device in session.devices:
            timer = timed[device.device.name] = TimedPoller(device.pollers[0])
            device.pollers = [timer]
        keep_for_good()
        running = asyncio.create_task(session.run())
        await asyncio.sleep(seconds)
        session.stop()
        await running
        recorded = since(before)
    return {
        "recording": recorded,
        "whole": since(before),
        "turns": {name: timer.turns for name, timer in timed.items()},
    }


def main() -> None:
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)
    folder, port, devices, seconds = sys.argv[1:]
    print(json.dumps(asyncio.run(run(Path(folder), int(port), int(devices), float(seconds)))))


if __name__ == "__main__":
    main()

"""``python -m yardstick.client JOB``: one client in a process of its own, measured.

Prints the outcome as one line of JSON; exit 3 where the client is not installed.
"""

from __future__ import annotations

import asyncio
import logging
import os
import sys
import time
from json import loads
from typing import TYPE_CHECKING

from yardstick.frames import registers
from yardstick.job import Job, Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    from yardstick.clients import AsyncClient, BlockingClient

NOT_INSTALLED = 3
WARM_UP = 3


def _count(outcome: Outcome, address: int, values: Sequence[int]) -> None:
    if tuple(values) == registers(address):
        outcome.good += 1
    else:
        outcome.wrong += 1


class _Watch:
    """Wall and processor time of what happens inside ``with``."""

    def __init__(self, outcome: Outcome) -> None:
        self._outcome = outcome

    def __enter__(self) -> None:
        self._system = os.times().system
        self._cpu, self._wall = time.process_time(), time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._outcome.wall = time.perf_counter() - self._wall
        self._outcome.cpu = time.process_time() - self._cpu
        self._outcome.system = os.times().system - self._system


def _goes_on(job: Job, poll: int, end: float) -> bool:
    return poll < job.polls if job.polls is not None else time.perf_counter() < end


def run_blocking(client: BlockingClient, job: Job) -> Outcome:
    client.open()
    for _ in range(0 if job.moving else WARM_UP):
        client.read(job.address(0))
    outcome = Outcome()
    client.late_us.clear()
    with _Watch(outcome):
        poll, end = 0, time.perf_counter() + job.seconds
        while _goes_on(job, poll, end):
            address = job.address(poll)
            try:
                values = client.read(address)
            except client.failures:
                outcome.failed += 1
            else:
                _count(outcome, address, values)
            poll += 1
    client.close()
    outcome.late_us = client.late_us
    return outcome


async def run_async(clients: list[AsyncClient], job: Job) -> Outcome:
    """All connections at once, each with one request out at a time."""
    for client in clients:
        await client.open()
    for client in clients:
        for _ in range(0 if job.moving else WARM_UP):
            await client.read(job.address(0))
        client.late_us.clear()
    outcome = Outcome()
    with _Watch(outcome):
        end = time.perf_counter() + job.seconds
        await asyncio.gather(*(_work(client, job, end, outcome) for client in clients))
    for client in clients:
        client.close()
        outcome.late_us += client.late_us
    return outcome


async def _work(client: AsyncClient, job: Job, end: float, outcome: Outcome) -> None:
    poll = 0
    while _goes_on(job, poll, end):
        address = job.address(poll)
        try:
            values = await client.read(address)
        except client.failures:
            outcome.failed += 1
        else:
            _count(outcome, address, values)
        poll += 1


def main() -> int:
    from yardstick.clients import ASYNC, BLOCKING  # noqa: PLC0415 - a client may be missing

    logging.disable(logging.CRITICAL)
    job = Job(**loads(sys.argv[1]))
    try:
        if job.client in ASYNC:
            make = ASYNC[job.client]
            clients = [make(job) for _ in range(job.connections)]
            outcome = asyncio.run(run_async(clients, job))
        else:
            outcome = run_blocking(BLOCKING[job.client](job), job)
    except ImportError as error:
        print(error, file=sys.stderr)
        return NOT_INSTALLED
    print(outcome.to_json())
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Waiting for what a simulator does, with a limit and without guessing how long it takes."""

from __future__ import annotations

import asyncio
import os
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    ReadOctets = Callable[[int, int], Awaitable[bytes]]
    Until = Callable[[Callable[[], bool]], Awaitable[None]]


@pytest.fixture
def read_octets() -> ReadOctets:
    """Give a coroutine function (descriptor, count) that waits up to 5 s for that many octets.

    It takes whatever has arrived, so octets too many are returned as well.
    """

    async def read(descriptor: int, count: int) -> bytes:
        loop = asyncio.get_running_loop()
        arrived = asyncio.Event()
        octets = b""
        loop.add_reader(descriptor, arrived.set)
        try:
            async with asyncio.timeout(5):
                while len(octets) < count:
                    await arrived.wait()
                    arrived.clear()
                    with suppress(BlockingIOError):  # another turn has taken them
                        octets += os.read(descriptor, 4096)
        finally:
            loop.remove_reader(descriptor)
        return octets

    return read


@pytest.fixture
def until() -> Until:
    """Give a coroutine function that waits up to 5 s for a condition that has no event."""

    async def wait(condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(5):
            while not condition():  # noqa: ASYNC110 - as said above
                await asyncio.sleep(0.001)

    return wait

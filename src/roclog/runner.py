"""Runs a session until its time is over or the process is asked to stop."""

from __future__ import annotations

import asyncio
import gc
import signal
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from roclog.errors import StorageError
from roclog.service import notify
from roclog.session import Session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from roclog.clock import Clock
    from roclog.config.settings import Settings


_GRACE: Final = 3.0
"""Seconds for every device to finish the poll in hand: a confirming read, a commit, a clear."""


async def record(
    settings: Settings,
    clock: Clock,
    duration: float | None,
    on_second: Callable[[Session], None] | None = None,
) -> None:
    """Record for ``duration`` seconds (None: until SIGINT or SIGTERM), then close in order.

    Raises:
        StorageError: the directory cannot be used.
    """
    stop = asyncio.Event()
    with _stopping_signals(stop):
        async with Session(settings, clock) as session:
            keep_for_good()
            notify("READY=1")
            recording = asyncio.create_task(session.run())
            tasks = [
                recording,
                asyncio.create_task(_prove_life(session, on_second)),
                asyncio.create_task(stop.wait()),
            ]
            try:
                await asyncio.wait(tasks, timeout=duration, return_when=asyncio.FIRST_COMPLETED)
            finally:
                notify("STOPPING=1")
                session.stop()
                await asyncio.wait((recording,), timeout=_GRACE)
                for task in tasks:
                    task.cancel()
                ended = await asyncio.gather(*tasks, return_exceptions=True)
        for result in ended:
            if isinstance(result, Exception):
                raise result


def keep_for_good() -> None:
    """What is built by now stays: a collection that looks at all of it takes a tenth of a second.

    With a thousand devices that would be the only thing that makes a poll late.
    """
    gc.collect()
    gc.freeze()


async def _prove_life(session: Session, on_second: Callable[[Session], None] | None) -> None:
    """Once a second, and only after the writer has answered, tell the watchdog."""
    while True:
        with suppress(StorageError):  # a disk that is full is told elsewhere; the writer is alive
            await session.writer_answers()
        notify("WATCHDOG=1")
        if on_second is not None:
            on_second(session)
        await asyncio.sleep(1)


@contextmanager
def _stopping_signals(stop: asyncio.Event) -> Iterator[None]:
    """The first signal stops in order; a second one at once."""
    loop = asyncio.get_running_loop()

    def ask() -> None:
        stop.set()
        for number in numbers:
            loop.remove_signal_handler(number)
            signal.signal(number, signal.SIG_DFL)

    numbers = (signal.SIGINT, signal.SIGTERM)
    for number in numbers:
        loop.add_signal_handler(number, ask)
    try:
        yield
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)

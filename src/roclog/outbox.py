"""What one device wants recorded, kept in order until it is on disk."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any, Final, Protocol

from roclog.errors import StorageError
from roclog.recording.entries import Entry, log_entry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from concurrent.futures import Future

    from roclog.clock import Clock

_MOST: Final = 1000
"""Messages kept while the disk takes none; then the oldest samples are given up, and counted."""


class Recorder(Protocol):
    """The writer, as far as a device needs it."""

    def commit(self, entries: Sequence[Entry]) -> Future[None]: ...

    def note(self, entries: Sequence[Entry]) -> Future[None]: ...

    def carry(self, topic: str, values: Mapping[str, object]) -> Future[None]: ...


class Outbox:
    """Messages of one device. ``add`` what must be durable, then ``flush``."""

    def __init__(self, device: str, recorder: Recorder, clock: Clock) -> None:
        self._device = device
        self._recorder = recorder
        self._clock = clock
        self._waiting: list[Entry] = []
        self._given_up: tuple[int, int, int] | None = None
        self._failing = False

    @property
    def empty(self) -> bool:
        """Everything added so far is on disk; only then may a device forget."""
        return not self._waiting

    def add(self, entry: Entry) -> None:
        self._waiting.append(entry)
        if len(self._waiting) > _MOST:
            samples = (n for n, waiting in enumerate(self._waiting) if waiting.carry is not None)
            oldest = self._waiting.pop(next(samples, 0))
            first, count = self._given_up[0::2] if self._given_up else (oldest.log_time, 0)
            self._given_up = (first, oldest.log_time, count + 1)

    def take_given_up(self) -> tuple[int, int, int] | None:
        """First and last log_time and number of samples that were read but could not be kept.

        None while the disk takes nothing, and where there are none.
        """
        if self._failing or self._given_up is None:
            return None
        taken, self._given_up = self._given_up, None
        return taken

    def note(self, entry: Entry) -> None:
        """Record without waiting for the disk."""
        self._recorder.note([entry])

    def event(self, level: str, kind: str, text: str) -> None:
        """A ``/log`` event, on stderr as well."""
        name = f"{self._device}.{kind}"
        logging.getLogger("roclog").log(_LEVELS[level], "%s: %s", name, text)
        self.note(log_entry(self._clock.now().utc, level, name, text))

    def checkpoint(self, topic: str, carry: Mapping[str, Any]) -> None:
        """Something a later run must know changed without a message of its own."""
        self._recorder.carry(topic, carry)

    async def flush(self) -> bool:
        """Commit what waits; False (and an event, once) when the disk does not take it."""
        if not self._waiting:
            return True
        batch = tuple(self._waiting)
        try:
            await asyncio.wrap_future(self._recorder.commit(batch))
        except StorageError as error:
            if not self._failing:
                self._failing = True
                self.event("error", "storage", f"not recording, nothing is cleared: {error}")
            return False
        del self._waiting[: len(batch)]
        if self._failing:
            self._failing = False
            self.event("info", "storage", "recording again")
        return True


_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}

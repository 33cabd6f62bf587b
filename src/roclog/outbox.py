"""What one device wants recorded, kept in order until it is on disk."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Protocol

from roclog.errors import StorageError
from roclog.recording.entries import Entry, log_entry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from concurrent.futures import Future

    from roclog.clock import Clock

_MOST: Final = 1000
"""Messages kept while the disk takes none; older ones are given up, and counted."""


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
        self._given_up: list[Entry] = []
        self._failing = False

    @property
    def empty(self) -> bool:
        """Everything added so far is on disk; only then may a device forget."""
        return not self._waiting

    def add(self, entry: Entry) -> None:
        self._waiting.append(entry)
        if len(self._waiting) > _MOST:
            self._given_up.append(replace(self._waiting.pop(0), data=b"", carry=None))

    def take_given_up(self) -> list[Entry]:
        """Head of the messages that were read but could not be kept, once the disk is back."""
        taken: list[Entry] = []
        if not self._failing:
            taken, self._given_up = self._given_up, []
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

"""Seals finished segments beside the recording, and deletes old ones where the user asks for it."""

from __future__ import annotations

import logging
import queue
import threading
from typing import TYPE_CHECKING

from roclog.errors import DamagedFile
from roclog.recording.seal import seal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from roclog.recording.retention import Retention

_log = logging.getLogger(__name__)


class Sealer:
    """One thread; a failure leaves the hot segment for the next start and never stops recording."""

    def __init__(
        self, root: Path, retention: Retention | None, tell: Callable[[str, str], None]
    ) -> None:
        """tell: called with a level and a text about every failure and every deletion."""
        self._root = root
        self._retention = retention
        self._tell = tell
        self._paths: queue.SimpleQueue[Path | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="roclog-sealer")
        self._thread.start()

    def seal(self, path: Path) -> None:
        self._paths.put(path)

    def close(self) -> None:
        """Returns when everything handed over is sealed."""
        self._paths.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (path := self._paths.get()) is not None:
            try:
                seal(path, self._root)
            except DamagedFile as problem:
                self._set_aside(path, problem)
            except OSError as error:
                self._tell("error", f"{path} stays unsealed: {error}")
            else:
                self._delete_old()

    def _delete_old(self) -> None:
        if self._retention is None:
            return
        try:
            for deleted in self._retention.apply(self._root):
                self._tell("info", f"deleted {deleted} as the keep setting asks")
        except OSError as error:
            self._tell("error", f"an old segment could not be deleted: {error}")

    def _set_aside(self, path: Path, problem: DamagedFile) -> None:
        """A crash before the head was on disk leaves a file with nothing in it to seal."""
        try:
            path.rename(path.with_suffix(".unreadable"))
        except OSError as error:
            self._tell("error", f"{path}: {error}")
        self._tell("warning", f"{problem}; kept as {path.with_suffix('.unreadable').name}")

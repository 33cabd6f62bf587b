"""Child processes that never outlive a test, and waiting for conditions instead of time."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

T = TypeVar("T")
PATIENCE = 20.0


def until(found: Callable[[], T], what: str, seconds: float = PATIENCE) -> T:
    """The first true value of ``found``. Raises AssertionError when the time is over."""
    limit = time.monotonic() + seconds
    while True:
        value = found()
        if value:
            return value
        if time.monotonic() > limit:
            raise AssertionError(f"waited {seconds:g} s in vain for {what}")
        time.sleep(0.01)


class Child:
    """A process with its own group; stdout and stderr go to files beside each other.

    listens: its standard input stays open until it has ended; otherwise it is empty.
    """

    def __init__(
        self,
        command: Sequence[str],
        log: Path,
        *,
        environment: Mapping[str, str] | None = None,
        listens: bool = False,
    ) -> None:
        self.stdout = log.with_suffix(".out")
        self.stderr = log.with_suffix(".err")
        with self.stdout.open("wb") as out, self.stderr.open("ab") as err:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE if listens else subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def code(self) -> int | None:
        """Exit code, None while it runs."""
        return self._process.poll()

    def talk(self) -> str:
        return self.stderr.read_text(errors="replace")

    def said(self) -> str:
        return self.stdout.read_text(errors="replace")

    def send(self, number: int) -> None:
        """To the group: a tracer around the process takes no signals."""
        os.killpg(self._process.pid, number)

    def while_it_runs(self, found: Callable[[], T], what: str, seconds: float = PATIENCE) -> T:
        """As ``until``, but fails at once, with what it said, when the process has ended."""

        def look() -> T:
            assert self.code is None, f"ended with {self.code} before {what}:\n{self.talk()}"
            return found()

        return until(look, what, seconds)

    def wait(self, seconds: float = PATIENCE) -> int:
        try:
            return self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{self._process.args!r} did not end:\n{self.talk()}") from None

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Ask it to end, and return its exit code."""
        if self.code is None:
            self.send(number)
        return self.wait()

    def kill(self) -> None:
        """The whole group, at once."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

"""Devices, lines and clients, each in a process of its own on the core it belongs to."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from yardstick.client import NOT_INSTALLED
from yardstick.job import Job, Outcome

if TYPE_CHECKING:
    from types import TracebackType

_LIB: Final = Path(__file__).parents[1]
_ENVIRONMENT: Final = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join((str(_LIB), os.environ.get("PYTHONPATH", ""))),
}
_LONGEST_S: Final = 300
_EQUAL_MALLOC: Final = {
    "MALLOC_MMAP_THRESHOLD_": str(4 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
}
"""asyncio receives into 256 KiB at a time. glibc maps and unmaps those pages at every read unless
the process has happened to free something larger before: some 20 us for each poll that depend on
what a program has imported, and not on what is measured."""
MALLOC: Final = ("equal", "default")


def choose_malloc(kind: str) -> None:
    """For every client from now on: the same thresholds for all, or what each happens to get."""
    if kind == "equal":
        _ENVIRONMENT.update(_EQUAL_MALLOC)


def cores() -> tuple[set[int], set[int]]:
    """(of clients, of devices and lines): one each where there are two, else the same."""
    known = sorted(os.sched_getaffinity(0))
    return {known[-1]}, {known[0]}


class NotInstalled(Exception):
    """The library of a client is not there."""


class Peer:
    """A line or devices: prints something when ready, ends with its input, then prints JSON."""

    def __init__(self, *arguments: str, lines: int = 1) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=_ENVIRONMENT,
            text=True,
        )
        os.sched_setaffinity(self._process.pid, cores()[1])
        self.seen: dict[str, Any] = {}
        self.ready = [self._read_line() for _ in range(lines)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        output, _ = self._process.communicate(timeout=_LONGEST_S)
        if kind is None:
            self.seen = json.loads(output)

    def _read_line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline().strip()
        if not line:
            raise RuntimeError(f"{self._process.args!r} did not start")
        return line


def run_client(job: Job) -> Outcome:
    """Raises:
    NotInstalled: with what is missing.
    """
    return Outcome(**json.loads(run_on_client_core("-m", "yardstick.client", job.to_json())))


def run_on_client_core(*arguments: str) -> str:
    """Standard output of a Python program that has the clients' core and ends by itself.

    Raises:
        NotInstalled: it says that a library is missing.
        RuntimeError: it failed.
    """
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        env=_ENVIRONMENT,
        text=True,
        timeout=_LONGEST_S,
        preexec_fn=lambda: os.sched_setaffinity(0, cores()[0]),
        check=False,
    )
    if done.returncode == NOT_INSTALLED:
        raise NotInstalled(done.stderr.strip())
    if done.returncode:
        raise RuntimeError(f"{arguments}: {done.stderr}")
    if done.stderr:
        print(done.stderr, file=sys.stderr, end="")
    return done.stdout

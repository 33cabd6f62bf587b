"""Ways to lose a device and to get it back."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

from bench.peer import Roc
from bench.process import Child

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import ExitStack

_CABLE: Final = Path(__file__).parents[3] / "peers/cable.py"
_NUMBERS: Final = count()
CYCLE: Final = 1.0
"""Seconds between two samples of the devices."""


@dataclass(frozen=True)
class Moment:
    mono_ns: int
    wall_ns: int

    @classmethod
    def now(cls) -> Moment:
        return cls(time.monotonic_ns(), time.time_ns())


class Cable:
    """The process of tests/peers/cable.py; after `pull` a new `lay` puts it there again."""

    def __init__(self, folder: Path, *arguments: str, under: Sequence[str] = ()) -> None:
        self._command = [*under, sys.executable, str(_CABLE), *arguments]
        self._log = folder / "cable"
        self.name = ""
        self.lay()

    def lay(self, *more: str) -> Moment:
        self.child = Child([*self._command, *more], self._log)
        name, moment = self.heard("open", 1)
        self.name = name
        return moment

    def heard(self, what: str, times: int) -> tuple[str, Moment]:
        """The line of that number that begins with `what`."""

        def look() -> list[str]:
            lines = self.child.said().split("\n")[:-1]
            found = [line for line in lines if line.split()[0] == what]
            return found[times - 1 : times]

        _, name, mono, wall = self.child.while_it_runs(look, f"{what} of the cable")[0].split()
        return name, Moment(int(mono), int(wall))

    def pull(self) -> None:
        assert self.child.stop() == 0, self.child.talk()

    def close(self) -> None:
        self.child.kill()


class Outage:
    """One way: `cut` begins an outage, `mend` ends it and says when the peer was back.

    recorder_under: command that runs the recorder. lengths: seconds of the outages, in turn.
    limit: seconds from the peer's return to its first good answer.
    """

    limit = 5.0
    lengths: tuple[float, ...] = (1.0, 3.0, 0.3)
    recorder_under: Sequence[str] = ()
    needs_root = False

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.stack = stack
        self.roc, self.cable = self.build()

    def build(self) -> tuple[Roc, Cable]:
        """By default a TCP device behind a cable."""
        roc = self.stack.enter_context(Roc(self.folder, cycle=CYCLE, samples=10**6))
        cable = Cable(self.folder, "--tcp", "127.0.0.1:0", "--to", f"127.0.0.1:{roc.address}")
        self.stack.callback(cable.close)
        self.port = cable.name
        return roc, cable

    def connection(self) -> str:
        return f'transport = "tcp"\nhost = "127.0.0.1"\nport = {self.port}'

    def cut(self) -> None:
        raise NotImplementedError

    def mend(self) -> Moment:
        raise NotImplementedError


class Stopped(Outage):
    """Half-open: the peer's computer acknowledges, nobody answers (SIGSTOP)."""

    lengths = (2.0, 7.0, 0.7)

    def cut(self) -> None:
        self.cable.child.send(signal.SIGSTOP)

    def mend(self) -> Moment:
        back = Moment.now()
        self.cable.child.send(signal.SIGCONT)
        return back


class Reset(Outage):
    """The peer resets the connection (SO_LINGER 0) and goes on listening."""

    lengths = (0.0,)

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        super().__init__(folder, stack)
        self._resets = 0

    def cut(self) -> None:
        self.cable.child.send(signal.SIGUSR1)

    def mend(self) -> Moment:
        self._resets += 1
        return self.cable.heard("reset", self._resets)[1]


class Deaf(Reset):
    """The peer keeps the connection, but serves only new ones, as a gateway that lost its place.

    Nothing but silence tells of it, so some requests have to run into their time-outs first.
    """

    limit = 10.0

    def cut(self) -> None:
        self.cable.child.send(signal.SIGUSR2)

    def mend(self) -> Moment:
        self._resets += 1
        return self.cable.heard("deaf", self._resets)[1]


class Refused(Outage):
    """The peer resets the connection and nobody listens for a while."""

    def cut(self) -> None:
        self.cable.pull()

    def mend(self) -> Moment:
        return self.cable.lay("--tcp", f"127.0.0.1:{self.port}")


class Unplugged(Outage):
    """A serial adapter behind a link like those of /dev/serial/by-id."""

    def build(self) -> tuple[Roc, Cable]:
        roc = Roc(self.folder, line="pty", cycle=CYCLE, samples=10**6)
        self.stack.enter_context(roc)
        cable = Cable(self.folder, "--pty", str(self.folder / "adapter"), "--to", roc.address)
        self.stack.callback(cable.close)
        return roc, cable

    def connection(self) -> str:
        return f'transport = "rtu"\nport = "{self.folder / "adapter"}"'

    def cut(self) -> None:
        self.cable.pull()

    def mend(self) -> Moment:
        return self.cable.lay()


class Moved(Unplugged):
    """The adapter comes back under another name; the link points there."""

    def mend(self) -> Moment:
        former = self.cable.name
        moment = self.cable.lay("--avoid", former)
        assert self.cable.name != former
        return moment


class Split(Outage):
    """The network between two namespaces is down, and the recorder's own interface with it."""

    lengths = (1.0, 7.0, 3.3)
    needs_root = True
    _HOST: Final = "10.213.77.2"
    _PORT: Final = 1502

    def build(self) -> tuple[Roc, Cable]:
        number = f"{os.getpid()}-{next(_NUMBERS)}"
        near, self._far = f"near-{number}", f"far-{number}"
        for name in (near, self._far):
            ip("netns", "add", name)
            self.stack.callback(ip, "netns", "delete", name)
            ip("-n", name, "link", "set", "lo", "up")
        far_end = ("peer", "name", "wire", "netns", self._far)
        ip("-n", near, "link", "add", "wire", "type", "veth", *far_end)
        for name, host in ((near, "10.213.77.1"), (self._far, self._HOST)):
            ip("-n", name, "address", "add", f"{host}/24", "dev", "wire")
            ip("-n", name, "link", "set", "wire", "up")
        self.recorder_under = ("ip", "netns", "exec", near)
        under = ("ip", "netns", "exec", self._far)
        roc = Roc(self.folder, cycle=CYCLE, samples=10**6, under=under)
        self.stack.enter_context(roc)
        listen = ("--tcp", f"0.0.0.0:{self._PORT}", "--to", f"127.0.0.1:{roc.address}")
        cable = Cable(self.folder, *listen, under=under)
        self.stack.callback(cable.close)
        return roc, cable

    def connection(self) -> str:
        return f'transport = "tcp"\nhost = "{self._HOST}"\nport = {self._PORT}'

    def cut(self) -> None:
        ip("-n", self._far, "link", "set", "wire", "down")

    def mend(self) -> Moment:
        ip("-n", self._far, "link", "set", "wire", "up")
        return Moment.now()


class Vanished(Split):
    """Half-open: all that is sent to the peer disappears without a word; nobody knows of it."""

    def cut(self) -> None:
        self._address("delete")

    def mend(self) -> Moment:
        self._address("add")
        return Moment.now()

    def _address(self, action: str) -> None:
        ip("-n", self._far, "address", action, f"{self._HOST}/24", "dev", "wire")


class Rebooted(Vanished):
    """As before, and the peer starts anew meanwhile: it has never heard of the connection."""

    def cut(self) -> None:
        super().cut()
        self.cable.pull()
        self.cable.lay()


def ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr}"


def namespaces_possible() -> bool:
    if os.geteuid() != 0:
        return False
    name = f"try-{os.getpid()}-{next(_NUMBERS)}"
    try:
        ip("netns", "add", name)
        ip("netns", "delete", name)
    except (AssertionError, OSError):
        return False
    return True


CASES: Final[dict[str, type[Outage]]] = {
    "unplugged": Unplugged,
    "moved": Moved,
    "stopped": Stopped,
    "reset": Reset,
    "deaf": Deaf,
    "refused": Refused,
    "split": Split,
    "vanished": Vanished,
    "rebooted": Rebooted,
}

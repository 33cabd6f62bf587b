"""One end of a line: a pseudo-terminal in raw mode, and a link to it."""

from __future__ import annotations

import fcntl
import os
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Final

CHUNK: Final = 4096
PTY_DIRECTORY: Final = "/dev/pts/"


class Terminal:
    """A pseudo-terminal that others open as `name`, or as `link` if there is one.

    The terminal itself stays open here until `close`, so who uses it may come and go without the
    line going down. Octets that nobody takes are dropped when it is full, like on a wire.

    Args:
        link: Where to put a symbolic link. A link that a killed process left behind is replaced.

    Raises:
        OSError: `link` exists and is anything else than a link to a pseudo-terminal, or no
            pseudo-terminal is left.
    """

    def __init__(self, link: str | os.PathLike[str] | None) -> None:
        self._link = None if link is None else Path(link)
        self.descriptor, self._terminal = os.openpty()
        try:
            tty.setraw(self._terminal)
            os.set_blocking(self.descriptor, False)
            self.name = os.ttyname(self._terminal)
            if self._link is not None:
                self._make_link(self._link)
        except OSError:
            os.close(self.descriptor)
            os.close(self._terminal)
            raise

    def read(self) -> bytes:
        """Take what has been written at the other side of the terminal."""
        # A terminal forgets TIOCEXCL at its last close, which never comes here: without this, a
        # user that had asked for exclusive use would lock out its successor.
        fcntl.ioctl(self._terminal, termios.TIOCNXCL)
        try:
            return os.read(self.descriptor, CHUNK)
        except BlockingIOError:
            return b""

    def write(self, octets: bytes) -> int:
        """Hand octets over and tell how many found room."""
        try:
            return os.write(self.descriptor, octets)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Take the terminal away, and the link too unless someone else has replaced it."""
        os.close(self.descriptor)
        os.close(self._terminal)
        if self._link is not None:
            with suppress(OSError):
                if self._link.readlink() == Path(self.name):
                    self._link.unlink()

    def _make_link(self, link: Path) -> None:
        if link.is_symlink() and str(link.readlink()).startswith(PTY_DIRECTORY):
            link.unlink()
        link.symlink_to(self.name)

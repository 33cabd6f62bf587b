"""A serial line without wire: two pseudo-terminals and the octets carried between them.

A pseudo-terminal has no baud rate; octets cross this line as fast as the event loop turns.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Final

CHUNK: Final = 4096
PTY_DIRECTORY: Final = "/dev/pts/"


class PtyLine:
    """Two ends of a line, each a terminal device in raw mode.

    Clients open `link`, a symbolic link; `server_port` is the name of the other end. Both
    terminals stay open here until `close`, so a client may come and go without the line going
    down. Like a wire, the line drops octets that nobody takes.

    Args:
        link: Where to put the link. A link that a killed process left behind is replaced.

    Raises:
        OSError: `link` exists and is anything else than a link to a pseudo-terminal, or no
            pseudo-terminal is left.
    """

    def __init__(self, link: str | os.PathLike[str]) -> None:
        self._loop = asyncio.get_running_loop()
        self._link = Path(link)
        self._client, self._client_tty = _open_raw()
        try:
            self._server, self._server_tty = _open_raw()
        except OSError:
            _close(self._client, self._client_tty)
            raise
        self.server_port = os.ttyname(self._server_tty)
        self._target = os.ttyname(self._client_tty)
        try:
            self._make_link()
        except OSError:
            _close(self._client, self._client_tty, self._server, self._server_tty)
            raise
        self._loop.add_reader(self._client, self._from_client)
        self._loop.add_reader(self._server, self._pump, self._server, self._client)

    def close(self) -> None:
        """Take the line down and remove the link, unless someone else has replaced it."""
        for end in (self._client, self._server):
            self._loop.remove_reader(end)
        _close(self._client, self._client_tty, self._server, self._server_tty)
        with suppress(OSError):
            if self._link.readlink() == Path(self._target):
                self._link.unlink()

    def _make_link(self) -> None:
        if self._link.is_symlink() and str(self._link.readlink()).startswith(PTY_DIRECTORY):
            self._link.unlink()
        self._link.symlink_to(self._target)

    def _from_client(self) -> None:
        # A terminal forgets TIOCEXCL at its last close, which never comes here: without this, a
        # client that had asked for exclusive use would lock out its successor.
        fcntl.ioctl(self._client_tty, termios.TIOCNXCL)
        self._pump(self._client, self._server)

    @staticmethod
    def _pump(source: int, sink: int) -> None:
        with suppress(BlockingIOError):
            os.write(sink, os.read(source, CHUNK))


def _open_raw() -> tuple[int, int]:
    """Open a pseudo-terminal; give its master, not blocking, and the terminal itself."""
    master, terminal = os.openpty()
    tty.setraw(terminal)
    os.set_blocking(master, False)
    return master, terminal


def _close(*descriptors: int) -> None:
    for descriptor in descriptors:
        os.close(descriptor)

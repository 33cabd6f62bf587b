"""A cable between a client and a device that can be pulled: octets pass, nothing is understood.

    python tests/peers/cable.py --tcp 127.0.0.1:0 --to 127.0.0.1:5020
    python tests/peers/cable.py --pty adapter --to roc

`open NAME MONO_NS WALL_NS` on stdout: it carries. SIGTERM pulls it: connections are reset without
a word more, a terminal goes away with its link. SIGUSR1 resets the connections and listens on,
SIGUSR2 keeps them and carries only for later ones; `reset - MONO_NS WALL_NS` and `deaf - ...` say
when. Standard library only.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import pty
import signal
import socket
import struct
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_PIECE = 4096


def _say(what: str, name: str) -> None:
    print(what, name, time.monotonic_ns(), time.time_ns(), flush=True)


def _place(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host, int(port)


class TcpCable:
    def __init__(self, listen: str, to: str) -> None:
        self._listen = _place(listen)
        self._to = _place(to)
        self._ends: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._deaf: set[asyncio.StreamReader] = set()
        self._sources: set[asyncio.StreamReader] = set()

    async def open(self) -> str:
        self._server = await asyncio.start_server(self._carry, *self._listen)
        return str(self._server.sockets[0].getsockname()[1])

    def reset(self) -> None:
        """RST to the clients, not FIN: what is in flight never arrives."""
        for end in self._ends:
            connection = end.transport.get_extra_info("socket")
            with contextlib.suppress(OSError):
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            end.transport.abort()
        self._ends.clear()

    def stop_hearing(self) -> None:
        """What comes over the connections that there are is taken and forgotten."""
        self._deaf |= self._sources

    def close(self) -> None:
        self._server.close()
        self.reset()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection(*self._to)
        except OSError:
            writer.transport.abort()
            return
        self._ends |= {writer, far_writer}
        for source, drain in ((reader, far_writer), (far_reader, writer)):
            task = asyncio.create_task(self._pump(source, drain))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pump(self, source: asyncio.StreamReader, drain: asyncio.StreamWriter) -> None:
        self._sources.add(source)
        with contextlib.suppress(OSError):
            while octets := await source.read(_PIECE):
                if source not in self._deaf:
                    drain.write(octets)
        self._sources.discard(source)
        drain.close()
        self._ends.discard(drain)


class PtyCable:
    """avoid: a name that the terminal must not get."""

    def __init__(self, link: str, to: str, avoid: str) -> None:
        self._link = Path(link)
        self._to = to
        self._avoid = avoid

    async def open(self) -> str:
        self._near, slave = pty.openpty()
        if os.ttyname(slave) == self._avoid:
            unwanted = self._near, slave
            self._near, slave = pty.openpty()
            for end in unwanted:
                os.close(end)
        tty.setraw(slave)
        self._slave = slave  # stays open: the client may come and go
        self._far = os.open(self._to, os.O_RDWR | os.O_NOCTTY)
        for end, other in ((self._near, self._far), (self._far, self._near)):
            os.set_blocking(end, False)
            asyncio.get_running_loop().add_reader(end, self._pass_on, end, other)
        new = self._link.with_name(self._link.name + ".new")
        new.unlink(missing_ok=True)
        new.symlink_to(os.ttyname(slave))
        new.replace(self._link)
        return os.ttyname(slave)

    def reset(self) -> None:
        raise ValueError("a serial line has no connections")

    stop_hearing = reset

    def close(self) -> None:
        self._link.unlink(missing_ok=True)
        for end in (self._near, self._far):
            asyncio.get_running_loop().remove_reader(end)
        for end in (self._near, self._slave, self._far):
            os.close(end)

    @staticmethod
    def _pass_on(source: int, drain: int) -> None:
        """With nobody reading, the buffer fills up and octets are lost, as on a real line."""
        with contextlib.suppress(BlockingIOError):
            os.write(drain, os.read(source, _PIECE))


async def _run(given: argparse.Namespace) -> None:
    cable: TcpCable | PtyCable = (
        TcpCable(given.tcp, given.to) if given.tcp else PtyCable(given.pty, given.to, given.avoid)
    )
    loop, pulled = asyncio.get_running_loop(), asyncio.Event()

    def act(what: str, action: Callable[[], None]) -> None:
        _say(what, "-")
        action()

    loop.add_signal_handler(signal.SIGTERM, pulled.set)
    loop.add_signal_handler(signal.SIGUSR1, act, "reset", cable.reset)
    loop.add_signal_handler(signal.SIGUSR2, act, "deaf", cable.stop_hearing)
    _say("open", await cable.open())
    await pulled.wait()
    cable.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--tcp", help="HOST:PORT to listen on, port 0 for any")
    where.add_argument("--pty", help="symbolic link to make to a pseudo terminal")
    parser.add_argument("--to", required=True, help="HOST:PORT or terminal of the device")
    parser.add_argument("--avoid", default="", help="name that the terminal must not get")
    given = parser.parse_args()
    asyncio.run(_run(given))


if __name__ == "__main__":
    main()

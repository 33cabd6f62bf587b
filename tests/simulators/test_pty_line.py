"""The line between two pseudo-terminals."""

from __future__ import annotations

import asyncio
import fcntl
import os
import termios
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roclog.simulators.pty_line import PtyLine

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    ReadOctets = Callable[[int, int], Awaitable[bytes]]

TIOCGEXCL = 0x80045440  # of Linux, missing in the module termios of Python 3.11
EVERY_OCTET = bytes(range(256))


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def open_terminal(path: str | Path) -> int:
    return os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def test_every_octet_crosses_unchanged_both_ways(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        line = PtyLine(tmp_path / "line")
        client, server = open_terminal(tmp_path / "line"), open_terminal(line.server_port)
        os.write(client, EVERY_OCTET)
        assert await read_octets(server, 256) == EVERY_OCTET
        os.write(server, EVERY_OCTET)
        assert await read_octets(client, 256) == EVERY_OCTET
        os.close(client)
        os.close(server)
        line.close()

    asyncio.run(main())


def test_client_may_come_and_go(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        line = PtyLine(tmp_path / "line")
        server = open_terminal(line.server_port)
        for octets in (b"first", b"second"):
            client = open_terminal(tmp_path / "line")
            os.write(client, octets)
            assert await read_octets(server, len(octets)) == octets
            os.close(client)
        os.close(server)
        line.close()

    asyncio.run(main())


def test_exclusive_use_ends_with_the_client(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        line = PtyLine(tmp_path / "line")
        server, client = open_terminal(line.server_port), open_terminal(tmp_path / "line")
        fcntl.ioctl(client, termios.TIOCEXCL)
        os.write(client, b"x")
        await read_octets(server, 1)
        exclusive = bytearray(4)
        fcntl.ioctl(client, TIOCGEXCL, exclusive)
        assert exclusive == bytes(4)
        os.close(client)
        os.close(server)
        line.close()

    asyncio.run(main())


def test_octets_that_nobody_takes_are_dropped(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        line = PtyLine(tmp_path / "line")
        client, server = open_terminal(tmp_path / "line"), open_terminal(line.server_port)
        for _ in range(100):
            with suppress(BlockingIOError):
                os.write(server, EVERY_OCTET)
            await asyncio.sleep(0)
        os.write(client, b"still here")
        assert await read_octets(server, 10) == b"still here"
        os.close(client)
        os.close(server)
        line.close()

    asyncio.run(main())


def test_link_goes_with_the_line(tmp_path: Path) -> None:
    async def main() -> None:
        link = tmp_path / "line"
        line = PtyLine(link)
        assert link.is_symlink()
        line.close()
        assert not link.is_symlink()

    asyncio.run(main())


def test_stale_link_is_replaced(tmp_path: Path) -> None:
    async def main() -> None:
        link = tmp_path / "line"
        link.symlink_to("/dev/pts/99999")
        line = PtyLine(link)
        assert link.exists()
        line.close()

    asyncio.run(main())


def test_anything_else_in_the_way_stays(tmp_path: Path) -> None:
    async def main() -> None:
        for way in ("file", "link"):
            taken = tmp_path / way
            if way == "file":
                taken.write_text("mine")
            else:
                taken.symlink_to(tmp_path / "file")
            open_before = open_descriptors()
            with pytest.raises(FileExistsError):
                PtyLine(taken)
            assert taken.read_text() == "mine"
            assert open_descriptors() == open_before

    asyncio.run(main())


def test_link_that_someone_replaced_stays(tmp_path: Path) -> None:
    async def main() -> None:
        link = tmp_path / "line"
        line = PtyLine(link)
        link.unlink()
        link.symlink_to("/dev/null")
        line.close()
        assert link.is_symlink()

    asyncio.run(main())

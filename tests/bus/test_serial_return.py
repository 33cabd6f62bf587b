"""Ports that others hold, that are pulled, and that come back under another name."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import subprocess
import sys
import termios
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest
from serial_peer import SerialPeer
from wire import rtu_frame

from roclog.bus import serial_driver
from roclog.bus.serial_port import SerialLink

if TYPE_CHECKING:
    from collections.abc import Iterator

TIOCGEXCL = 0x80045440
"""<asm-generic/ioctls.h> on x86_64."""
REQUEST = rtu_frame(1, bytes.fromhex("03 0005 0001"))
ANSWER = rtu_frame(1, bytes.fromhex("03 02 0005"))
HOLDER = """
import fcntl, os, sys, termios
fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.flock(fd, fcntl.LOCK_EX) if sys.argv[2] == "lock" else fcntl.ioctl(fd, termios.TIOCEXCL)
print("held", flush=True)
sys.stdin.read()
fcntl.ioctl(fd, termios.TIOCNXCL)
"""


def make(path: Path) -> SerialLink:
    return SerialLink(str(path), 9600, 8, "N", 1)


def ignore(_: object) -> None:
    pass


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@contextmanager
def held_by_another_program(path: Path, how: str) -> Iterator[None]:
    command = [sys.executable, "-c", HOLDER, str(path), how]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        yield
        holder.communicate()


@pytest.mark.parametrize("how", ["lock", "TIOCEXCL"])
def test_a_port_that_another_program_holds(tmp_path: Path, how: str) -> None:
    """With a lock alone, or with TIOCEXCL alone, which does not keep root out.

    The port is left as it is.
    """

    async def main() -> None:
        link = make(tmp_path / "port")
        watching = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
        before = termios.tcgetattr(watching), descriptors()
        with held_by_another_program(tmp_path / "port", how):
            with pytest.raises(OSError, match="another program has it open"):
                await link.open(ignore, ignore)
            assert termios.tcgetattr(watching) == before[0]
        assert descriptors() == before[1]
        os.close(watching)
        await link.open(ignore, ignore)
        link.close()

    with SerialPeer(tmp_path / "port"):
        asyncio.run(main())


def test_the_port_is_marked_as_taken_while_it_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def marked(link: SerialLink) -> list[bool]:
        marks = []
        await link.open(ignore, ignore)
        marks.append(fcntl.ioctl(watching, TIOCGEXCL, bytes(4)) != bytes(4))
        link.close()
        marks.append(fcntl.ioctl(watching, TIOCGEXCL, bytes(4)) != bytes(4))
        return marks

    with SerialPeer(tmp_path / "port"):
        link = make(tmp_path / "port")
        watching = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
        assert asyncio.run(marked(link)) == [False, False]  # it would outlive a killed program
        monkeypatch.setattr(serial_driver, "_PSEUDO_TERMINALS", range(0))
        assert asyncio.run(marked(link)) == [True, False]
        os.close(watching)


def test_an_adapter_that_is_pulled_and_returns_under_another_name(tmp_path: Path) -> None:
    """20 times; nothing is left behind. Meanwhile the link below by-id is not there."""
    by_id = tmp_path / "usb-FTDI_RS485-if00-port0"
    lost: list[str] = []

    async def main() -> None:
        link = make(by_id)
        devices: list[str] = []
        old = -1
        before = descriptors()
        for _ in range(20):
            answered, pulled = asyncio.Event(), asyncio.Event()
            heard = bytearray()

            def receive(
                octets: bytes, heard: bytearray = heard, done: asyncio.Event = answered
            ) -> None:
                heard.extend(octets)
                if len(heard) >= len(ANSWER):
                    done.set()

            def gone(reason: str, done: asyncio.Event = pulled) -> None:
                lost.append(reason)
                done.set()

            with SerialPeer(by_id):
                await link.open(receive, gone)
                devices.append(link.describe()["device"])
                assert devices[-1] == str(by_id.readlink())
                link.send(REQUEST)
                await asyncio.wait_for(answered.wait(), 10)
                assert heard == ANSWER
                if old >= 0:
                    os.close(old)
                old = os.open(by_id, os.O_RDWR | os.O_NOCTTY)  # keeps the name from coming again
            await asyncio.wait_for(pulled.wait(), 10)
            for there in (True, False):  # first the link leads nowhere, then it is gone
                if not there:
                    by_id.unlink()
                with pytest.raises(OSError) as caught:
                    await link.open(ignore, ignore)
                assert caught.value.errno in (
                    (errno.EIO, errno.ENOENT) if there else (errno.ENOENT,)
                )
            with pytest.raises(OSError, match="the port is closed"):
                link.send(REQUEST)
        os.close(old)
        assert descriptors() == before
        assert all(one != other for one, other in pairwise(devices))

    asyncio.run(main())
    assert len(lost) == 20


def test_a_file_where_the_port_was(tmp_path: Path) -> None:
    """What remains where something was redirected to a port that was not there."""

    async def main() -> None:
        with pytest.raises(OSError, match="is not a serial port"):
            await make(tmp_path / "ttyUSB0").open(ignore, ignore)

    (tmp_path / "ttyUSB0").write_text("x")
    before = descriptors()
    asyncio.run(main())
    assert descriptors() == before


@pytest.mark.root
def test_a_node_without_a_device_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "ttyUSB250"
    try:
        os.mknod(path, 0o600 | 0o020000, os.makedev(188, 250))
    except PermissionError:
        pytest.skip("only root makes device nodes")

    async def main() -> None:
        with pytest.raises(OSError) as caught:
            await make(path).open(ignore, ignore)
        if caught.value.errno == errno.EACCES:
            pytest.skip("device nodes cannot be opened here")
        assert caught.value.errno in (errno.ENXIO, errno.ENODEV)
        assert caught.value.strerror in ("No such device or address", "No such device")

    asyncio.run(main())


def test_a_port_that_vanishes_while_it_is_set_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def vanish(*_: object) -> NoReturn:
        raise termios.error(errno.EIO, "Input/output error")

    async def main() -> None:
        before = descriptors()
        with pytest.raises(OSError, match="Input/output error") as caught:
            await make(tmp_path / "port").open(ignore, ignore)
        assert caught.value.errno == errno.EIO
        assert descriptors() == before

    monkeypatch.setattr(serial_driver, "reject_damaged_characters", vanish)
    with SerialPeer(tmp_path / "port"):
        asyncio.run(main())

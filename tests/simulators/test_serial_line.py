"""The line between two pseudo-terminals, with octets that a test writes and reads itself."""

from __future__ import annotations

import fcntl
import os
import select
import termios
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roclog.simulators import LineSettings, SerialLine

if TYPE_CHECKING:
    from collections.abc import Iterator

TIOCGEXCL = 0x80045440  # of Linux, missing in the module termios of Python 3.11
EVERY_OCTET = bytes(range(256))
FAST = LineSettings(baud=1_000_000)


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


class Port:
    """A terminal as anyone may open it."""

    def __init__(self, path: str | Path) -> None:
        self.descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def send(self, octets: bytes) -> None:
        os.write(self.descriptor, octets)

    def read(self, count: int) -> bytes:
        """That many octets, or what has come when nothing has for 5 s."""
        octets = b""
        while len(octets) < count and select.select([self.descriptor], [], [], 5)[0]:
            octets += os.read(self.descriptor, 4096)
        return octets

    def close(self) -> None:
        os.close(self.descriptor)


@pytest.fixture(params=[None, FAST], ids=["no baud", "1 MBd"])
def line(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[SerialLine]:
    with SerialLine(tmp_path / "client", tmp_path / "server", settings=request.param) as line:
        yield line


@pytest.fixture
def client(tmp_path: Path, line: SerialLine) -> Iterator[Port]:
    port = Port(tmp_path / "client")
    yield port
    port.close()


@pytest.fixture
def server(tmp_path: Path, line: SerialLine) -> Iterator[Port]:
    port = Port(tmp_path / "server")
    yield port
    port.close()


def test_every_octet_crosses_unchanged_both_ways(client: Port, server: Port) -> None:
    client.send(EVERY_OCTET)
    assert server.read(256) == EVERY_OCTET
    server.send(EVERY_OCTET)
    assert client.read(256) == EVERY_OCTET


def test_both_sides_may_come_and_go(tmp_path: Path, line: SerialLine) -> None:
    for octets in (b"first", b"second", b"third"):
        client, server = Port(tmp_path / "client"), Port(line.server_port)
        client.send(octets)
        assert server.read(len(octets)) == octets
        server.send(octets)
        assert client.read(len(octets)) == octets
        client.close()
        server.close()


def test_exclusive_use_ends_with_the_client(client: Port, server: Port) -> None:
    fcntl.ioctl(client.descriptor, termios.TIOCEXCL)
    client.send(b"x")
    server.read(1)
    exclusive = bytearray(4)
    fcntl.ioctl(client.descriptor, TIOCGEXCL, exclusive)
    assert exclusive == bytes(4)


def test_octets_that_nobody_takes_are_dropped(tmp_path: Path) -> None:
    with SerialLine() as line:
        client, server = Port(line.client_port), Port(line.server_port)
        for _ in range(10_000):
            select.select([], [server.descriptor], [], 5)
            with suppress(BlockingIOError):
                server.send(EVERY_OCTET)
            if line.statistics().dropped_octets:
                break
        assert line.statistics().dropped_octets > 0
        client.send(b"still here")
        assert server.read(10) == b"still here"
        client.close()
        server.close()


def test_more_than_the_line_takes_at_once_arrives_whole(tmp_path: Path) -> None:
    octets = EVERY_OCTET * 40
    with SerialLine(settings=FAST) as line:
        client, server = Port(line.client_port), Port(line.server_port)
        os.set_blocking(client.descriptor, True)
        writer = threading.Thread(target=client.send, args=(octets,))
        writer.start()
        assert server.read(len(octets)) == octets
        writer.join()
        seen = line.statistics()
        client.close()
        server.close()
    assert (seen.request_octets, seen.answer_octets, seen.dropped_octets) == (len(octets), 0, 0)


def test_statistics_stay_after_closing(tmp_path: Path) -> None:
    line = SerialLine(settings=FAST)
    assert line.statistics().requests == 0
    client, server = Port(line.client_port), Port(line.server_port)
    client.send(b"12345678")
    server.read(8)
    client.close()
    server.close()
    line.close()
    seen = line.statistics()
    assert (seen.baud, seen.requests, seen.request_octets, seen.answers) == (1_000_000, 1, 8, 0)
    assert 0 < seen.busy < 1
    assert 0 < seen.lateness_p50_ms <= seen.lateness_p99_ms <= seen.lateness_max_ms
    line.close()
    assert line.statistics() == seen


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    threads, descriptors = threading.active_count(), open_descriptors()
    for settings in (None, FAST, LineSettings(baud=50)):
        line = SerialLine(tmp_path / "client", tmp_path / "server", settings=settings)
        client = Port(tmp_path / "client")
        client.send(EVERY_OCTET)
        assert threading.active_count() == threads + 1
        line.close()
        client.close()
        assert list(tmp_path.iterdir()) == []
    assert (threading.active_count(), open_descriptors()) == (threads, descriptors)


def test_stale_link_is_replaced(tmp_path: Path) -> None:
    link = tmp_path / "line"
    link.symlink_to("/dev/pts/99999")
    with SerialLine(link):
        assert link.exists()


@pytest.mark.parametrize("end", ["client", "server"])
@pytest.mark.parametrize("way", ["file", "link"])
def test_anything_else_in_the_way_stays(tmp_path: Path, end: str, way: str) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    descriptors = open_descriptors()
    links = {"client": tmp_path / "other", "server": tmp_path / "other"} | {end: tmp_path / way}
    with pytest.raises(FileExistsError):
        SerialLine(links["client"], links["server"])
    assert (tmp_path / way).read_text() == "mine"
    assert not (tmp_path / "other").is_symlink()
    assert open_descriptors() == descriptors


def test_link_that_someone_replaced_stays(tmp_path: Path) -> None:
    link = tmp_path / "line"
    with SerialLine(link):
        link.unlink()
        link.symlink_to("/dev/null")
    assert link.is_symlink()

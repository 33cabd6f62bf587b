"""Clients that nobody here wrote read and clear the simulated devices; tshark judges the frames."""

from __future__ import annotations

import csv
import re
import shutil
import socket
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bench.document import decode, identity
from bench.foreign import Capture, free_port, judge_frames
from bench.needs import need
from bench.process import Child, until
from bench.recording import number

if TYPE_CHECKING:
    from collections.abc import Iterator

SERVERS = Path(__file__).with_name("servers")
UNIT = "138"
FLAG = 300
BLOCK = 27
NO_REGISTER = 400


@contextmanager
def simulator(folder: Path, *place: str) -> Iterator[Child]:
    """A sample each 5 s, so that what is read in one go belongs to one."""
    command = [sys.executable, "-m", "roclog", "simulate", "hiac-roc", "--speed", "3"]
    command += [*place, "--truth", str(folder / "truth.csv")]
    with Child(command, folder / "simulator") as child:
        child.while_it_runs(lambda: "serving" in child.talk(), "the simulator")
        yield child


def is_a_sample(registers: list[int], folder: Path) -> bool:
    """Whether the simulator has noted a sample with just these values."""
    with (folder / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = identity(decode(registers))
    names = list(decode(registers))
    found = [{name: number(row[name]) for name in names if row.get(name)} for row in rows]
    return any(identity(values) == wanted for values in found if len(values) == len(names))


class Mbpoll:
    """Uses libmodbus. where: its options for the place."""

    def __init__(self, *where: str) -> None:
        self._where = where

    def read(self, address: int, count: int) -> list[int]:
        said = self._ask("-r", str(address), "-c", str(count))
        found = re.findall(r"^\[(\d+)\]: \t(\d+)", said.stdout, re.MULTILINE)
        assert [int(at) for at, _ in found] == list(range(address, address + count)), said
        return [int(value) for _, value in found]

    def write(self, address: int, value: int) -> None:
        said = self._ask("-r", str(address), value=value)
        assert "Written 1 references" in said.stdout, said

    def refusal(self, address: int) -> str:
        said = self._ask("-r", str(address))
        assert said.returncode != 0
        return said.stderr

    def _ask(self, *options: str, value: int | None = None) -> subprocess.CompletedProcess[str]:
        command = ["mbpoll", "-a", UNIT, "-0", "-1", "-q", *options, *self._where]
        command += [] if value is None else [str(value)]
        return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


def read_clear_and_refuse(client: Mbpoll, folder: Path) -> None:
    until(lambda: client.read(FLAG, 1) == [1], "a sample")
    block = client.read(FLAG, BLOCK)
    assert block[0] == 1
    assert is_a_sample(block, folder)
    client.write(FLAG, 0)
    assert client.read(FLAG, BLOCK) == [0, *block[1:]]
    assert "Illegal data address" in client.refusal(NO_REGISTER)


def need_mbpoll() -> None:
    need("mbpoll", shutil.which("mbpoll") is not None)


def test_mbpoll_on_a_serial_line(tmp_path: Path) -> None:
    need_mbpoll()
    line = str(tmp_path / "line")
    with simulator(tmp_path, "--pty", line, "--baud", "9600"):
        client = Mbpoll("-m", "rtu", "-b", "9600", "-P", "none", line)
        read_clear_and_refuse(client, tmp_path)


@pytest.mark.root
def test_mbpoll_over_tcp(tmp_path: Path) -> None:
    need_mbpoll()
    port = free_port()
    with ExitStack() as stack:
        capture = stack.enter_context(Capture(tmp_path / "frames.pcap", port))
        stack.enter_context(simulator(tmp_path, "--tcp", f"127.0.0.1:{port}"))
        read_clear_and_refuse(Mbpoll("-m", "tcp", "-p", str(port), "127.0.0.1"), tmp_path)
        check_frames(capture, tmp_path, "mbtcp", port)


@pytest.mark.root
def test_mbpoll_behind_a_gateway(tmp_path: Path) -> None:
    """socat makes a terminal of the connection."""
    need_mbpoll()
    need("socat", shutil.which("socat") is not None)
    port, link = free_port(), tmp_path / "line"
    with ExitStack() as stack:
        capture = stack.enter_context(Capture(tmp_path / "frames.pcap", port))
        stack.enter_context(simulator(tmp_path, "--rtu-over-tcp", f"127.0.0.1:{port}"))
        command = ["socat", f"PTY,link={link},raw,echo=0", f"TCP:127.0.0.1:{port}"]
        gateway = stack.enter_context(Child(command, tmp_path / "socat"))
        gateway.while_it_runs(link.is_symlink, "the terminal")
        client = Mbpoll("-m", "rtu", "-b", "9600", "-P", "none", str(link))
        read_clear_and_refuse(client, tmp_path)
        check_frames(capture, tmp_path, "mbrtu", port)


def check_frames(capture: Capture, folder: Path, kind: str, port: int) -> None:
    capture.finish()
    verdict = judge_frames(folder / "frames.pcap", kind, port)
    assert verdict.complaints == []
    assert verdict.queries == verdict.responses >= 5
    assert verdict.exceptions == 1


@pytest.mark.root
@pytest.mark.parametrize(("transport", "kind"), [("tcp", "mbtcp"), ("udp", "mbudp")])
def test_modbus_serial(tmp_path: Path, transport: str, kind: str) -> None:
    npm = shutil.which("npm")
    need("npm and node", npm is not None and shutil.which("node") is not None)
    for name in ("package.json", "modbus_serial_client.mjs"):
        shutil.copy(SERVERS / name, tmp_path)
    install = [str(npm), "install", "--no-audit", "--no-fund", "--ignore-scripts"]
    install.append("--omit=optional")
    done = subprocess.run(install, cwd=tmp_path, capture_output=True, timeout=100, check=False)
    need("access to the npm package modbus-serial", done.returncode == 0)
    port = free_port(socket.SOCK_DGRAM if transport == "udp" else socket.SOCK_STREAM)
    with ExitStack() as stack:
        capture = stack.enter_context(Capture(tmp_path / "frames.pcap", port))
        stack.enter_context(simulator(tmp_path, f"--{transport}", f"127.0.0.1:{port}"))
        command = ["node", str(tmp_path / "modbus_serial_client.mjs"), transport, str(port), UNIT]
        done = subprocess.run(command, capture_output=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        check_frames(capture, tmp_path, kind, port)
    before, echo, after, refused = done.stdout.decode().splitlines()
    block = [int(word) for word in before.split()]
    assert len(block) == BLOCK
    assert is_a_sample(block, tmp_path)
    assert echo.split() == [str(FLAG), "0"]
    assert [int(word) for word in after.split()] == [0, *block[1:]]
    assert refused == "2"

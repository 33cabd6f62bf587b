"""Programs that nobody here wrote, at the other end of the line and listening in."""

from __future__ import annotations

import os
import select
import shutil
import socket
import struct
import subprocess
import threading
import time
import tty
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final, Self

from bench.needs import need
from bench.process import Child, until

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_RAW_IPV4: Final = 228
"""Link type of a capture whose packets begin with an IPv4 header."""
_CLIENT_PORT: Final = 40000
_PAUSE: Final = 0.1
"""Seconds between two frames of one side when the other says nothing."""
_DISCARD: Final = 9


class Server:
    """A third-party server; the programs of tests/third_party/servers tell what is written."""

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self.child = Child(command, log)
        try:
            self.child.while_it_runs(lambda: "listening" in self.child.said(), "it to listen")
        except BaseException:
            self.child.kill()
            raise

    @property
    def written(self) -> list[tuple[int, int]]:
        """Registers and values, as the library has understood them."""
        lines = [line.split() for line in self.child.said().splitlines()]
        return [(int(line[1]), int(line[2])) for line in lines if line[0] == "wrote"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class _Piece:
    at: float
    from_client: bool
    octets: bytes


class Tap:
    """Two terminals with a wire between them; whatever passes is kept."""

    def __init__(self) -> None:
        self._pieces: list[_Piece] = []
        self._ends = [os.openpty() for _ in range(2)]
        for _, terminal in self._ends:
            tty.setraw(terminal)
        self.client_port, self.server_port = (os.ttyname(terminal) for _, terminal in self._ends)
        self._stop, self._stopper = os.pipe()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def frames(self) -> list[tuple[bool, bytes]]:
        """Whether the client sent it, and its octets: what one side says in one go."""
        found: list[tuple[bool, bytes]] = []
        silence = [float("inf"), *(b.at - a.at for a, b in pairwise(self._pieces))]
        for pause, piece in zip(silence, self._pieces, strict=True):
            if found and found[-1][0] == piece.from_client and pause < _PAUSE:
                found[-1] = (piece.from_client, found[-1][1] + piece.octets)
            else:
                found.append((piece.from_client, piece.octets))
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stopper, b"\0")
        self._thread.join()
        for end in (*self._ends[0], *self._ends[1], self._stop, self._stopper):
            os.close(end)

    def _carry(self) -> None:
        client, server = (end for end, _ in self._ends)
        while True:
            ready, _, _ = select.select([client, server, self._stop], [], [])
            if self._stop in ready:
                return
            for end in ready:
                octets = os.read(end, 4096)
                self._pieces.append(_Piece(time.monotonic(), end == client, octets))
                os.write(server if end == client else client, octets)


def write_capture(path: Path, frames: Sequence[tuple[bool, bytes]], port: int) -> None:
    """Frames of a serial line as if they had come over TCP, so that their direction is told."""
    sequence = {True: 1, False: 1}
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, _RAW_IPV4))
        for number, (from_client, octets) in enumerate(frames):
            ports = (_CLIENT_PORT, port) if from_client else (port, _CLIENT_PORT)
            numbers = sequence[from_client], sequence[not from_client]
            packet = struct.pack(">HHIIBBHHH", *ports, *numbers, 5 << 4, 0x18, 65535, 0, 0) + octets
            home = socket.inet_aton("127.0.0.1")
            head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(packet), number, 0, 64, 6, 0)
            packet = head + home + home + packet
            file.write(struct.pack("<IIII", number, 0, len(packet), len(packet)) + packet)
            sequence[from_client] += len(octets)


class Capture:
    """dumpcap on the loopback interface: all octets to and from one port."""

    def __init__(self, path: Path, port: int) -> None:
        dumpcap = shutil.which("dumpcap")
        need("root and dumpcap (package tshark)", os.geteuid() == 0 and dumpcap is not None)
        self._path = path
        self._mark = f"end of {path}".encode()  # other captures hear it too
        wanted = f"port {port} or udp port {_DISCARD}"
        command = [str(dumpcap), "-q", "-P", "-i", "lo", "-f", wanted, "-w", str(path)]
        self._child = Child(command, path.with_suffix(".log"))
        self._child.while_it_runs(lambda: "File:" in self._child.talk(), "the capture")

    def finish(self) -> None:
        """Until everything that was sent before is in the file."""

        def is_marked() -> bool:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.sendto(self._mark, ("127.0.0.1", _DISCARD))
            return self._mark in self._path.read_bytes()

        until(is_marked, "the end of the capture")
        self._child.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.kill()


@dataclass
class Verdict:
    """What tshark makes of a capture. complaints: frames it cannot place, or finds fault with."""

    queries: int = 0
    responses: int = 0
    exceptions: int = 0
    complaints: list[str] = field(default_factory=list)


def judge_frames(path: Path, kind: str, port: int) -> Verdict:
    """kind: mbtcp, mbudp or mbrtu, the dissector."""
    need("tshark", shutil.which("tshark") is not None)
    command = ["tshark", "-r", str(path), "-o", "mbrtu.crc_verification:TRUE"]
    command += ["-o", f"{'mbrtu' if kind == 'mbrtu' else 'mbtcp'}.tcp.port:{port}"]
    command += ["-o", f"mbudp.udp.port:{port}"] if kind == "mbudp" else []
    columns = ("_ws.col.Protocol", "_ws.col.Info", "_ws.malformed", "mbrtu.crc16.status")
    command += ["-Y", f"(tcp.len > 0 or udp) and not udp.port == {_DISCARD}", "-T", "fields"]
    for column in columns:
        command += ["-e", column]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    names = {"mbtcp": "Modbus/TCP", "mbudp": "Modbus/UDP", "mbrtu": "Modbus RTU"}
    verdict = Verdict()
    for line in done.stdout.splitlines():
        protocol, info, malformed, checksum = line.split("\t")
        is_query, is_response = (info.strip().startswith(w) for w in ("Query:", "Response:"))
        verdict.queries += is_query
        verdict.responses += is_response
        verdict.exceptions += "Exception returned" in info
        right = checksum == ("1" if kind == "mbrtu" else "")
        if protocol != names[kind] or not (is_query or is_response) or malformed or not right:
            verdict.complaints.append(line)
    return verdict

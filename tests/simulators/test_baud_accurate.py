"""`roclog simulate --baud` measured from outside: pyserial, a clock and octets from the document.

A busy machine may deliver late, never early: what is too early fails at once, lateness is judged
by medians.
"""

from __future__ import annotations

import re
import select
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from statistics import median
from typing import TYPE_CHECKING

import pytest
import serial

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

READ_BLOCK = bytes.fromhex("8A 03 01 2C 00 1B DB 4F")
BLOCK_SIZE = 59
READ_FLAG = {138: "8A 03 01 2C 00 01 5A 84", 139: "8B 03 01 2C 00 01 5B 55"}
READ_FLAG_OF_140 = bytes.fromhex("8C 03 01 2C 00 01 5A E2")

CHARACTER = 10 / 9600
TURNAROUND = 0.010
SILENCE = 5.5 * CHARACTER
"""The document of the device asks for five characters."""

BATCH = 9
BATCHES = 5


class Simulation:
    def __init__(self, link: Path, *arguments: str) -> None:
        command = [sys.executable, "-m", "roclog", "simulate", "hiac-roc", "hiac-roc:139"]
        self._process = subprocess.Popen(
            [*command, "--pty", str(link), *arguments], stderr=subprocess.PIPE, text=True
        )
        assert self._process.stderr is not None
        assert select.select([self._process.stderr], [], [], 20)[0], "says nothing"
        self.line = self._process.stderr.readline()

    def stop(self) -> str:
        self._process.send_signal(signal.SIGTERM)
        _, rest = self._process.communicate(timeout=20)
        assert self._process.returncode == 0
        return rest

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def simulation(link: Path, *arguments: str) -> Iterator[tuple[Simulation, serial.Serial]]:
    simulated = Simulation(link, *arguments)
    try:
        with serial.Serial(str(link), 9600, timeout=5) as port:
            yield simulated, port
    finally:
        simulated.kill()


def ask(port: serial.Serial, request: bytes, size: int) -> float:
    """Seconds from the first octet of the request until the last one of the answer."""
    time.sleep(SILENCE)
    begin = time.monotonic()
    port.write(request)
    answer = port.read(size)
    took = time.monotonic() - begin
    assert len(answer) == size
    assert answer[0] == request[0]
    return took


def test_read_of_27_registers_at_9600_bd(tmp_path: Path) -> None:
    expected = 8 * CHARACTER + TURNAROUND + BLOCK_SIZE * CHARACTER
    assert expected == pytest.approx(0.07979, abs=0.00001)
    with simulation(tmp_path / "line", "--baud", "9600", "--turnaround", "10ms") as (
        simulated,
        port,
    ):
        reads = 0
        for _ in range(BATCHES):
            took = [ask(port, READ_BLOCK, BLOCK_SIZE) for _ in range(BATCH)]
            reads += BATCH
            assert min(took) >= expected - 1e-5
            if median(took) <= expected + 0.0015:
                break
        else:
            pytest.fail(f"{median(took)} s instead of {expected}")
        rest = simulated.stop()
    assert ", 9600 Bd, turnaround 10ms at speed 1, Ctrl-C ends\n" in simulated.line
    said = f"line: {reads} requests, {reads} answers, 0 short gaps, 0 collisions, line used "
    assert rest.startswith(said)
    share = re.search(r"line used ([0-9.]+)% of ([0-9.]+) s", rest)
    assert share is not None
    used = float(share[1]) / 100 * float(share[2])
    assert used == pytest.approx(reads * (8 + BLOCK_SIZE) * CHARACTER, rel=0.1)


def test_two_units_answer_and_a_third_address_is_silent(tmp_path: Path) -> None:
    with simulation(tmp_path / "line", "--baud", "9600") as (simulated, port):
        for unit in (138, 139, 138):
            ask(port, bytes.fromhex(READ_FLAG[unit]), 7)
        time.sleep(SILENCE)
        port.timeout = 0.25
        port.write(READ_FLAG_OF_140)
        assert port.read(1) == b""
        port.timeout = 5
        ask(port, bytes.fromhex(READ_FLAG[139]), 7)
        rest = simulated.stop()
    assert rest.startswith("line: 5 requests, 4 answers, 0 short gaps, 0 collisions,")


def test_request_during_an_answer_is_a_collision(tmp_path: Path) -> None:
    with simulation(tmp_path / "line", "--baud", "1200") as (simulated, port):
        port.write(READ_BLOCK)
        begin = port.read(3)
        port.write(READ_BLOCK)  # the answer goes on for 56 characters of 8.3 ms
        collided = begin + port.read(BLOCK_SIZE - 3)
        time.sleep(0.05)  # five characters at 1200 Bd
        ask(port, bytes.fromhex(READ_FLAG[138]), 7)
        rest = simulated.stop()
    assert begin == bytes.fromhex("8A 03 36")
    assert len(collided) == BLOCK_SIZE
    # The sample block is empty as yet, apart from what is garbled.
    assert 8 <= BLOCK_SIZE - 3 - 2 - collided[3:-2].count(0) <= 10
    assert rest.startswith("line: 3 requests, 2 answers, 0 short gaps, 1 collisions,")


def test_usb_adapter_gives_octets_at_ticks(tmp_path: Path) -> None:
    arguments = ("--baud", "9600", "--turnaround", "10ms", "--usb-latency", "16ms")
    with simulation(tmp_path / "line", *arguments) as (simulated, port):
        arrivals: list[float] = []
        while len(arrivals) < 20 or (len(arrivals) < 200 and on_ticks(arrivals) < 0.7):
            arrivals += bursts(port)
        simulated.stop()
    assert "9600 Bd, turnaround 10ms, USB latency 16ms at speed 1" in simulated.line
    assert on_ticks(arrivals) >= 0.7  # a quarter would be by chance


def on_ticks(arrivals: list[float]) -> float:
    """Share of the arrivals within 4 ms of ticks 16 ms apart, for the ticks that fit best."""
    phases = [arrival % 0.016 for arrival in arrivals]
    return max(
        sum((phase - first) % 0.016 < 0.004 for phase in phases) / len(phases) for first in phases
    )


def bursts(port: serial.Serial) -> list[float]:
    """When octets of one answer arrived; 59 characters touch five ticks at most."""
    time.sleep(SILENCE)
    port.write(READ_BLOCK)
    arrivals = []
    missing = BLOCK_SIZE
    while missing:
        assert select.select([port], [], [], 5)[0]
        arrivals.append(time.monotonic())
        missing -= len(port.read(port.in_waiting))
    assert len(arrivals) <= 5
    return arrivals

"""`python -m roclog.simulators.serial_line` between two programs that know nothing of it."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import serial
from click.testing import CliRunner

from roclog.simulators.serial_line.__main__ import main

if TYPE_CHECKING:
    from collections.abc import Iterator

COMMAND = [sys.executable, "-m", "roclog.simulators.serial_line"]
REQUEST, ANSWER = b"request.", b"answer!"


class Command:
    """The command, once it has told its terminals."""

    def __init__(self, *arguments: str | Path) -> None:
        self.process = subprocess.Popen(
            [*COMMAND, *(str(each) for each in arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], 20)[0], "says nothing"
        self.client = self.process.stdout.readline().strip()
        self.server = self.process.stdout.readline().strip()

    def end(self, number: int | None = None) -> Any:
        """Statistics after a signal, or after the end of standard input."""
        if number is not None:
            self.process.send_signal(number)
        output, errors = self.process.communicate(timeout=20)
        assert (self.process.returncode, errors, output.count("\n")) == (0, "", 1)
        return json.loads(output)


class Answering(threading.Thread):
    """A server that answers every 8 octets; it ends when its terminal goes away."""

    def __init__(self, port: str) -> None:
        super().__init__()
        self.descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY)

    def run(self) -> None:
        octets = b""
        try:
            while octets := octets + os.read(self.descriptor, 4096):
                if len(octets) >= len(REQUEST):
                    octets = b""
                    os.write(self.descriptor, ANSWER)
        except OSError:  # the line is down
            pass
        os.close(self.descriptor)


@pytest.fixture
def line() -> Iterator[Command]:
    command = Command("--baud", "38400", "--silence", "10s", "--turnaround", "1ms")
    yield command
    command.process.kill()
    command.process.communicate()


@pytest.mark.parametrize("number", [None, signal.SIGTERM, signal.SIGINT])
def test_ends_with_a_line_of_json_and_takes_its_links_away(
    tmp_path: Path, number: int | None
) -> None:
    command = Command("--link-a", tmp_path / "a", "--link-b", tmp_path / "b", "--baud", "9600")
    assert os.readlink(tmp_path / "a") == command.client  # noqa: PTH115 - texts are compared
    assert os.readlink(tmp_path / "b") == command.server  # noqa: PTH115
    seen = command.end(number)
    assert (seen["baud"], seen["requests"], seen["busy"]) == (9600, 0, 0)
    assert list(tmp_path.iterdir()) == []


def test_eight_requests_without_silence_are_eight_short_gaps(line: Command) -> None:
    server = Answering(line.server)
    server.start()
    with serial.Serial(line.client, 38400, timeout=5) as client:
        for _ in range(9):
            client.write(REQUEST)
            assert client.read(len(ANSWER)) == ANSWER
        seen = line.end(signal.SIGTERM)
    server.join(5)
    assert not server.is_alive()
    assert (seen["requests"], seen["answers"], seen["collisions"]) == (9, 9, 0)
    assert seen["short_gaps"] == 8


def test_client_may_open_its_side_again(line: Command) -> None:
    server = Answering(line.server)
    server.start()
    for baudrate in (9600, 38400, 115200):
        with serial.Serial(line.client, baudrate, timeout=5, exclusive=True) as client:
            client.write(REQUEST)
            assert client.read(len(ANSWER)) == ANSWER
    assert line.end()["answers"] == 3
    server.join(5)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--baud", "0"], "0 is not in the range"),
        (["--format", "9N1"], "'9N1' is not like 8N1, 8E1 or 8N2"),
        (["--turnaround", "10"], "'10' is not a duration"),
        (["--silence", "5 bits"], "'5 bits' is not a duration"),
        (["--link-a", "/dev/null"], "File exists"),
    ],
)
def test_wrong_usage(arguments: list[str], text: str) -> None:
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert len(list(Path("/proc/self/fd").iterdir())) == descriptors
    assert text in " ".join(result.stderr.split())

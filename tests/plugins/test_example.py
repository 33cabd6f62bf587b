"""The example package, installed for real, against an instrument of its own."""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import socketserver
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from roclog.config import load
from roclog.decode import decode, named_values
from roclog.testing import check_register_map

if TYPE_CHECKING:
    from collections.abc import Iterator

ROCLOG = [sys.executable, "-m", "roclog"]
TOML = Path(__file__).parents[2] / "examples" / "met-one-6000.toml"


def roclog(*arguments: object, site: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [*ROCLOG, *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment(site)
    )


def environment(site: Path | None) -> dict[str, str]:
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return own if site is None else own | {"PYTHONPATH": str(site)}


def test_profiles_lists_it_with_its_package(example: Path) -> None:
    done = roclog("profiles", site=example)
    row = next(line for line in done.stdout.splitlines() if line.startswith("met-one-6000 "))
    assert "  roclog-met-one 1.0.0  " in row
    assert "19200 Bd 8N1" in row
    assert (done.returncode, done.stderr) == (0, "")
    assert "met-one" not in roclog("profiles").stdout


def test_profile_prints_its_map(example: Path) -> None:
    done = roclog("profiles", "met-one-6000", site=example)
    assert "package     roclog-met-one 1.0.0\n" in done.stdout
    assert "trigger     a change of registers 500-503 is another sample\n" in done.stdout
    data = json.loads(roclog("profiles", "met-one-6000", "--json", site=example).stdout)
    assert data["profiles"][0]["package"] == {"name": "roclog-met-one", "version": "1.0.0"}


def test_its_own_tests(example: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        cwd=example.parent / "source",
        env=environment(example),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout


def test_it_reads_what_the_same_map_in_toml_reads(
    example: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(str(example))
    config = tmp_path / "roclog.toml"
    config.write_text(
        TOML.read_text().partition("[devices.met1]")[0]
        + '[devices.met1]\nprofile = "met-one-6000"\nconnection = "cleanroom"\npoll = "5s"\n'
    )
    plugin = load(config).devices["met1"]
    toml = load(TOML).devices["met1"]
    check_register_map(plugin.profile)
    assert (plugin.unit, plugin.poll) == (toml.unit, toml.poll)
    generator = random.Random(6000)
    for name in ("identity", "sample"):
        mine, same = plugin.profile.block(name), toml.profile.block(name)
        assert (mine.table, mine.address, mine.count) == (same.table, same.address, same.count)
        for _ in range(200):
            words = [generator.getrandbits(16) for _ in range(mine.count)]
            one, other = decode(mine, words), decode(same, words)
            assert named_values(mine, one) == named_values(same, other)
            assert one[1:] == other[1:]


class Instrument(socketserver.ThreadingTCPServer):
    """Serves registers over Modbus TCP, written from the manual; another record after ten reads."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, records: list[dict[int, int]], identity: dict[int, int]) -> None:
        super().__init__(("127.0.0.1", 0), Session)
        self.records = records
        self.identity = identity
        self.reads = 0

    def word(self, address: int) -> int:
        record = self.records[min(self.reads // 10, len(self.records) - 1)]
        return record.get(address, self.identity.get(address, 0))


class Session(socketserver.StreamRequestHandler):
    server: Instrument

    def handle(self) -> None:
        while head := self.rfile.read(7):
            number, _, length, unit = struct.unpack(">HHHB", head)
            function, address, count = struct.unpack(">BHH", self.rfile.read(length - 1))
            if unit != 1 or function != 3:
                pdu = struct.pack(">BB", function | 0x80, 1)
            else:
                words = [self.server.word(address + n) for n in range(count)]
                pdu = struct.pack(f">BB{count}H", function, 2 * count, *words)
                self.server.reads += address == 500
            self.wfile.write(struct.pack(">HHHB", number, 0, len(pdu) + 1, unit) + pdu)


def registers(blocks: dict[int, str]) -> dict[int, int]:
    return {
        first + index: int(word, 16)
        for first, words in blocks.items()
        for index, word in enumerate(words.split())
    }


RECORDS = [  # year, month and day, hour, minute and second, period, volume, status, counts; analog
    registers(
        {
            500: "07EA 0B17 0006 0005 0000 0100 0000 0000 001C 0000 0000 FFFF FFFF 0000 270F",
            543: "09C4 00D7 01F7 0000 04B0",
        }
    ),
    registers(
        {
            500: "07EA 0B17 0006 010A 0000 0100 0000 0000 001C 0001 0000 0001 0000 0000 0011",
            543: "09C3 FFFF 01F8 0000 04B1",
        }
    ),
]
IDENTITY = registers({15: "3838 3031 0000", 38: "0064 0064"})
"""Table 16, note 1: the model number "8801"; 100 is version 1.00."""
ROWS = [
    {
        "device_time": "2026-11-23T06:00:05Z",
        "count_1": "4294967295",
        "count_2": "9999",
        "temperature": "21.5",
        "humidity": "50.3",
        "flow": "2500",
        "period": "60",
        "day": "1123",
    },
    {
        "device_time": "2026-11-23T06:01:10Z",
        "count_1": "65536",
        "count_2": "17",
        "temperature": "-0.1",
        "humidity": "50.4",
        "flow": "2499",
        "status": "1",
    },
]


@pytest.fixture
def instrument() -> Iterator[Instrument]:
    with Instrument(RECORDS, IDENTITY) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def config(instrument: Instrument, tmp_path: Path) -> Path:
    path = tmp_path / "roclog.toml"
    path.write_text(
        "[connections.cleanroom]\ntransport = 'tcp'\nhost = '127.0.0.1'\n"
        f"port = {instrument.server_address[1]}\n"
        "[devices.met1]\nprofile = 'met-one-6000'\nconnection = 'cleanroom'\npoll = '50ms'\n"
    )
    path.chmod(0o644)
    return path


def test_check_and_read_reach_the_instrument(example: Path, config: Path) -> None:
    checked = roclog("check", config, "--probe", site=example)
    assert (checked.returncode, checked.stderr) == (0, "")
    assert "met1: met-one-6000, unit 1 on cleanroom, poll 50ms" in checked.stdout
    assert "answers     met1: " in checked.stdout
    shown = json.loads(roclog("read", config, "met1", "--json", site=example).stdout)["blocks"]
    assert shown["identity"]["values"]["model"] == "8801"
    assert shown["identity"]["values"]["firmware_version"] == 1.0


def test_it_is_recorded_and_read_back_without_it(
    example: Path, config: Path, instrument: Instrument, tmp_path: Path
) -> None:
    command = [*ROCLOG, "record", str(config)]
    with subprocess.Popen(command, env=environment(example), stderr=subprocess.PIPE) as process:
        limit = time.monotonic() + 20
        while instrument.reads < 30 and process.poll() is None and time.monotonic() < limit:
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=20)
    assert process.returncode == 0, said
    recordings = tmp_path / "recordings"
    (sealed,) = recordings.glob("*/*/*/*.mcap")
    facts = " ".join(json.dumps(each) for each in metadata(sealed))
    assert "8801" in facts
    done = roclog("export", recordings, "--format", "csv", "--out", tmp_path / "csv")
    assert done.returncode == 0, done.stderr
    with (tmp_path / "csv" / "met1.sample.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [{name: row[name] for name in want} for row, want in zip(rows, ROWS, strict=True)] == (
        ROWS
    )
    assert roclog("verify", recordings).returncode == 0
    assert "/met1/sample" in roclog("info", recordings).stdout


def metadata(path: Path) -> list[dict[str, Any]]:
    with path.open("rb") as file:
        return [
            dict(record.metadata)
            for record in StreamReader(file).records
            if isinstance(record, Metadata)
        ]

"""The logger reads, records and clears servers that nobody here wrote; tshark judges the frames.

Of UDP servers there is only the one of pymodbus, whose encoder the logger uses as well; there the
answers and their judge are independent.
"""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bench.document import decode
from bench.foreign import Capture, Server, Tap, free_port, judge_frames, write_capture
from bench.needs import need
from bench.process import Child
from bench.recorder import Recorder, roclog
from bench.recording import csv_rows, items, number
from roc_map import configuration, identity
from roc_samples import SampleSource

if TYPE_CHECKING:
    from bench.foreign import Verdict

SERVERS = Path(__file__).with_name("servers")
UNIT = 138
SAMPLE = SampleSource(seed=5, word_order="ABCD", period=10, identical_every=0).make().registers
REGISTERS = {
    **dict(enumerate(identity("1203270042"))),
    **configuration(UNIT, 15),
    **dict(enumerate(SAMPLE, 300)),
}
COUNTS = ("timeouts", "late_answers", "crc_errors", "wrong_answers", "discarded_octets")


@dataclass(frozen=True)
class Peer:
    """kind: the dissector that knows its frames."""

    server: Server
    connection: str
    kind: str
    port: int
    capture: Capture | Tap


def modbus_tk(_: Path, *arguments: str) -> list[str]:
    need("modbus-tk", find_spec("modbus_tk") is not None)
    return [sys.executable, str(SERVERS / "modbus_tk_server.py"), *arguments]


def pymodbus(_: Path, *arguments: str) -> list[str]:
    return [sys.executable, str(SERVERS / "pymodbus_server.py"), *arguments]


def libmodbus(folder: Path, *arguments: str) -> list[str]:
    tools = all(shutil.which(tool) for tool in ("gcc", "pkg-config"))
    need("gcc and pkg-config", tools)
    asked = ["pkg-config", "--cflags", "--libs", "libmodbus"]
    flags = subprocess.run(asked, capture_output=True, text=True, check=False)
    need("libmodbus-dev", flags.returncode == 0)
    program = folder / "libmodbus_server"
    source = SERVERS / "libmodbus_server.c"
    subprocess.run(["gcc", "-o", program, source, *flags.stdout.split()], check=True)
    return [str(program), *arguments]


def modbus_serial(folder: Path, *arguments: str) -> list[str]:
    npm = shutil.which("npm")
    need("npm and node", npm is not None and shutil.which("node") is not None)
    for name in ("package.json", "modbus_serial_server.mjs"):
        shutil.copy(SERVERS / name, folder)
    install = [str(npm), "install", "--no-audit", "--no-fund", "--ignore-scripts"]
    install.append("--omit=optional")  # the serial binding, which only builds with scripts
    done = subprocess.run(install, cwd=folder, capture_output=True, timeout=100, check=False)
    need("access to the npm package modbus-serial", done.returncode == 0)
    return ["node", str(folder / "modbus_serial_server.mjs"), *arguments]


MAKERS = {
    "modbus-tk": modbus_tk,
    "libmodbus": libmodbus,
    "modbus-serial": modbus_serial,
    "pymodbus": pymodbus,
}
CASES = [
    ("modbus-tk", "tcp"),
    ("libmodbus", "tcp"),
    ("modbus-serial", "tcp"),
    ("modbus-tk", "rtu"),
    ("libmodbus", "rtu"),
    ("modbus-tk", "rtu-over-tcp"),
    ("libmodbus", "rtu-over-tcp"),
    ("pymodbus", "udp"),
]


def start(stack: ExitStack, folder: Path, library: str, transport: str) -> Peer:
    registers = folder / "registers"
    registers.write_text("".join(f"{a} {value}\n" for a, value in sorted(REGISTERS.items())))
    is_line = transport.startswith("rtu")
    kind = socket.SOCK_DGRAM if transport == "udp" else socket.SOCK_STREAM
    port = free_port(kind)
    tap = stack.enter_context(Tap()) if is_line else None
    where = ("rtu", tap.server_port) if tap else (transport, str(port))
    command = MAKERS[library](folder, *where, str(UNIT), str(registers))
    server = stack.enter_context(Server(command, folder / "server"))
    connection = f'transport = "{transport}"\nhost = "127.0.0.1"\nport = {port}'
    if tap is None:
        capture = stack.enter_context(Capture(folder / "frames.pcap", port))
        dissector = "mbudp" if transport == "udp" else "mbtcp"
        return Peer(server, connection, dissector, port, capture)
    if transport == "rtu":
        connection = f'transport = "rtu"\nport = "{tap.client_port}"'
    else:
        stack.enter_context(gateway(folder, port, tap.client_port))
    return Peer(server, connection, "mbrtu", port, tap)


def gateway(folder: Path, port: int, terminal: str) -> Child:
    """socat passes octets between a socket and the line, as a serial gateway does.

    ``-t 0``: whose client has gone does not read the line any more, or it takes the next one's
    octets.
    """
    need("socat", shutil.which("socat") is not None)
    listen = f"TCP-LISTEN:{port},bind=127.0.0.1,reuseaddr,fork"
    command = ["socat", "-d", "-d", "-t", "0", listen, f"FILE:{terminal},raw,echo=0"]
    child = Child(command, folder / "socat")
    try:
        child.while_it_runs(lambda: "listening on" in child.talk(), "the gateway")
    except BaseException:
        child.kill()
        raise
    return child


def judged(peer: Peer, folder: Path) -> Verdict:
    capture = folder / "frames.pcap"
    if isinstance(peer.capture, Tap):
        write_capture(capture, peer.capture.frames(), peer.port)
    else:
        peer.capture.finish()
    return judge_frames(capture, peer.kind, peer.port)


def read(config: Path) -> dict[str, Any]:
    done = roclog("read", config, "roc1", "--json")
    assert done.returncode == 0, done.stderr
    blocks: dict[str, Any] = json.loads(done.stdout)["blocks"]
    assert not [block["problem"] for block in blocks.values() if "problem" in block]
    return blocks


def same(values: dict[str, Any]) -> bool:
    return all(number(str(values[name])) == value for name, value in decode(SAMPLE).items())


@pytest.mark.root
@pytest.mark.parametrize(("library", "transport"), CASES)
def test_reads_records_and_clears(tmp_path: Path, library: str, transport: str) -> None:
    with ExitStack() as stack:
        peer = start(stack, tmp_path, library, transport)
        device = f'profile = "hiac-roc"\nconnection = "line"\nunit = {UNIT}\npoll = "100ms"\n'
        toml = f"[connections.line]\n{peer.connection}\n[devices.roc1]\n{device}"
        recorder = Recorder(tmp_path, toml)

        before = read(recorder.config)
        for name, address in (("identity", 0), ("configuration", 100), ("sample", 300)):
            words = before[name]["registers"]
            assert words == [REGISTERS[address + at] for at in range(len(words))], name
        assert same(before["sample"]["values"])
        assert before["identity"]["values"]["manufacturer"] == "HIAC"
        assert before["configuration"]["values"]["hold_period"] == 5
        assert peer.server.written == []

        with recorder.start() as child:
            child.while_it_runs(lambda: peer.server.written, "the clear")
            assert child.stop() == 0, child.talk()
        assert peer.server.written == [(300, 0)]
        after = read(recorder.config)
        assert after["sample"]["registers"] == [0, *SAMPLE[1:]]

        (sample,) = items(recorder.directory, "/roc1/sample")
        assert sample.values.raw == b"".join(word.to_bytes(2, "big") for word in SAMPLE)
        (row,) = csv_rows(recorder.directory, tmp_path / "csv")
        assert same(row)
        (clear,) = items(recorder.directory, "/roc1/clear")
        assert clear.values.result == 1  # done
        requests = 0
        for link in items(recorder.directory, "/roc1/link"):
            requests += link.values.requests
            assert link.values.answers == link.values.requests
            assert [getattr(link.values, name) for name in COUNTS] == [0] * len(COUNTS)

        verdict = judged(peer, tmp_path)
        assert verdict.complaints == []
        assert verdict.queries == verdict.responses == requests + 3 + 3  # the two `roclog read`
        assert verdict.exceptions == 0


@pytest.mark.root
@pytest.mark.parametrize(
    ("library", "transport"), [case for case in CASES if case[0] != "modbus-serial"]
)
def test_a_scan_finds_it_and_leaves_it_in_step(
    tmp_path: Path, library: str, transport: str
) -> None:
    """libmodbus over TCP and pymodbus over UDP do not look at the unit."""
    with ExitStack() as stack:
        peer = start(stack, tmp_path, library, transport)
        line = f'[connections.line]\n{peer.connection}\ntimeout = "300ms"\n'
        device = '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "line"\nunit = '
        recorder = Recorder(tmp_path, f"{line}{device}{UNIT}")
        config = tmp_path / "scan.toml"
        config.write_text(f"{line}{device}9")  # nobody, and so the unit is not known
        words = ("--connection", "line", "--units", "137-140", "--json")
        done = roclog("scan", config, *words)
        assert done.returncode == 0, done.stderr
        found = {unit["unit"]: unit for unit in json.loads(done.stdout)["units"]}
        heedless = (library, transport) in (("libmodbus", "tcp"), ("pymodbus", "udp"))
        assert list(found) == (list(range(137, 141)) if heedless else [UNIT])
        assert all(unit["state"] == "answers" for unit in found.values())
        assert {unit["alike"] for unit in found.values()} == {heedless}
        text = {"libmodbus": "LMB3", "pymodbus": "Pymodbus", "modbus-tk": ""}[library]
        assert found[UNIT]["identity"].startswith(text)
        assert found[UNIT]["exception"] == (1 if library == "modbus-tk" else None)
        sample = read(recorder.config)["sample"]
        assert sample["registers"] == [*SAMPLE]
        assert same(sample["values"])
        assert peer.server.written == []

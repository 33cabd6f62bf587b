"""The MPA-48 test device against the octets of its manual, pages 23 and 25, and every fault."""

from __future__ import annotations

import ast
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from mpa import MpaDevice
from mpa_options import Options, parse_options

ANY = "127.0.0.1:0"
PATIENCE = 5.0
RELAYS = bytes.fromhex("01 01 00 00 00 08 3D CC")
CHANNEL_2 = bytes.fromhex("01 04 00 03 00 03 40 0B")
"""Frames of a serial line; the CRCs were computed apart from this device."""


def mpa(**options: Any) -> MpaDevice:
    return MpaDevice(Options(**{"tcp": ANY, "period": 0.0, **options}))


def set_as_printed(device: MpaDevice) -> None:
    """Relays 1 and 3 are on; channel 2 measures 8.30 ppm at 25.0 degrees."""
    device.model.relays = [True, False, True, *[False] * 5]
    device.model.channels[3].measure(0, [Decimal("8.30"), Decimal("25.0")])


def connect(device: MpaDevice) -> socket.socket:
    return socket.create_connection(("127.0.0.1", int(device.address)), PATIENCE)


def ask(device: MpaDevice, pdu: str) -> str:
    """The answer of unit 1 on TCP, from its unit on."""
    request = bytes.fromhex(pdu)
    with connect(device) as line:
        line.sendall(b"\0\7\0\0\0" + bytes([len(request) + 1]) + b"\1" + request)
        head = line.recv(6, socket.MSG_WAITALL)
        assert head[:5] == b"\0\7\0\0\0"
        return line.recv(head[5], socket.MSG_WAITALL).hex(" ")


def read_line(descriptor: int, count: int) -> bytes:
    """What comes from a serial line until there are so many octets."""
    octets = b""
    while len(octets) < count:
        assert select.select([descriptor], [], [], PATIENCE)[0], octets.hex(" ")
        octets += os.read(descriptor, 256)
    return octets


def test_the_printed_examples_on_tcp() -> None:
    with mpa() as device:
        set_as_printed(device)
        assert ask(device, "01 00 00 00 08") == "01 01 01 05"
        assert ask(device, "04 00 03 00 03") == "01 04 06 00 00 03 3e 00 fa"
        relays, channel = (line for line in device.truth.lines if line["event"] == "answer")
    assert relays["relays"] == [True, False, True, *[False] * 5]
    told = {"dissolved_oxygen": "8.30", "temperature": "25.0"}
    assert channel["channels"] == {"3": {"model": "10", "status": 0, "told": told}}
    assert (channel["request"], channel["fate"]) == ("0400030003", "ok")


def test_the_printed_examples_on_a_serial_line(tmp_path: Path) -> None:
    with mpa(tcp=None, pty=str(tmp_path / "line")) as device:
        set_as_printed(device)
        line = os.open(device.address, os.O_RDWR | os.O_NOCTTY)
        for request, answer in (
            (RELAYS, "01 01 01 05 91 8B"),
            (CHANNEL_2, "01 04 06 00 00 03 3E 00 FA 81 58"),
        ):
            os.write(line, request)
            expected = bytes.fromhex(answer)
            assert read_line(line, len(expected)) == expected
        os.write(line, RELAYS[:-1] + b"\0")  # not its CRC
        limit = time.monotonic() + PATIENCE
        while not device.truth.counts["noise"]:
            assert time.monotonic() < limit
            time.sleep(0.001)
        os.write(line, CHANNEL_2)
        assert read_line(line, 11) == expected
        os.close(line)


@pytest.mark.parametrize(
    ("model", "values", "words"),
    [
        ("10", ("0.57", "-0.1"), "00 39 ff ff"),
        ("51", ("7.01", "-20.0"), "02 bd ff 38"),
        ("15", ("1234",), "04 d2"),
        ("52", ("-2000",), "00 00"),
        ("52", ("-500",), "05 dc"),
        ("52", ("2000",), "0f a0"),
    ],
)
def test_each_model(model: str, values: tuple[str, ...], words: str) -> None:
    with mpa(channels=f"0:{model}") as device:
        device.model.channels[0].measure(0, [Decimal(value) for value in values])
        answer = ask(device, "04 00 00 00 03")
        assert answer.startswith(f"01 04 06 00 00 {words}")
        device.model.channels[0].measure(3, [Decimal(value) for value in values])
        answer = ask(device, "04 00 00 00 03")
        assert answer.startswith("01 04 06 00 03")
        assert not answer.startswith(f"01 04 06 00 03 {words}")


@pytest.mark.parametrize(
    ("request_pdu", "code"),
    [
        ("03 00 00 00 01", 1),
        ("02 00 00 00 08", 1),
        ("05 00 00 FF 00", 1),
        ("06 00 00 00 01", 1),
        ("2B 0E 01 00", 1),
        ("01 00 08 00 01", 2),
        ("01 00 00 00 09", 2),
        ("04 00 06 00 01", 2),
        ("04 00 03 00 04", 2),
        ("04 FF FF 00 02", 2),
        ("01 00 00 00 00", 3),
        ("01 00 00 07 D1", 3),
        ("04 00 00 00 00", 3),
        ("04 00 00 00 7E", 3),
        ("04 00 00 00", 3),
        ("04", 3),
    ],
)
def test_refusals(request_pdu: str, code: int) -> None:
    with mpa() as device:
        answer = ask(device, request_pdu)
        (line,) = (line for line in device.truth.lines if line["event"] == "exception")
    assert answer == f"01 {int(request_pdu[:2], 16) | 0x80:02x} {code:02x}"
    assert line["code"] == code
    assert line["request"] == bytes.fromhex(request_pdu).hex()


def test_parts_of_the_relays_and_channels_in_one_answer() -> None:
    with mpa() as device:
        device.model.relays = [False, True, True, False, False, True, False, True]
        assert ask(device, "01 00 01 00 03") == "01 01 01 03"
        assert ask(device, "01 00 05 00 03") == "01 01 01 05"
        device.model.channels[0].measure(2, [])
        assert ask(device, "04 00 00 00 06").startswith("01 04 0c 00 02")
        both = device.truth.lines[-1]["channels"]
        assert isinstance(both, dict)
        assert both.keys() == {"0", "3"}


def test_everything_changes_and_every_status_comes() -> None:
    with mpa(period=0.001, channels="0:15;3:10;16:51;40:52", trouble=0.5) as device:
        limit = time.monotonic() + PATIENCE
        seen: dict[int, set[int]] = {at: set() for at in device.model.channels}
        relays = set()
        while time.monotonic() < limit and not all(s == {0, 1, 2, 3} for s in seen.values()):
            relays.add(tuple(device.model.relays))
            for at, channel in device.model.channels.items():
                seen[at].add(channel.status)
            time.sleep(0.001)
    assert all(statuses == {0, 1, 2, 3} for statuses in seen.values())
    assert len(relays) > 3


def test_faults_on_tcp() -> None:
    with mpa(short=1.0) as device:
        assert ask(device, "04 00 03 00 03").startswith("01 04 03 00")
        assert ask(device, "01 00 00 00 08") == "01 01 00"
    with mpa(other_unit=1.0) as device:
        assert ask(device, "01 00 00 00 08").startswith("02 01 01")
    with mpa(late=1.0, late_by=0.2) as device:
        begun = time.monotonic()
        ask(device, "01 00 00 00 08")
        assert time.monotonic() - begun >= 0.2
    with mpa(drop=1.0) as device, connect(device) as line:
        line.sendall(bytes.fromhex("00 07 00 00 00 06 01 01 00 00 00 08"))
        line.settimeout(0.1)
        with pytest.raises(TimeoutError):
            line.recv(1)
    for fail, answers in (("4:4:4:1", ["84 04", "04 06"]), ("1:0:6:0", ["81 06", "81 06"])):
        with mpa(fail=fail) as device:
            request = "04 00 03 00 03" if fail.startswith("4") else "01 00 00 00 08"
            assert [ask(device, request)[3:8] for _ in answers] == answers


def test_a_wrong_crc(tmp_path: Path) -> None:
    with mpa(tcp=None, pty=str(tmp_path / "line"), corrupt=1.0) as device:
        set_as_printed(device)
        line = os.open(device.address, os.O_RDWR | os.O_NOCTTY)
        os.write(line, RELAYS)
        answer = int.from_bytes(read_line(line, 6), "big")
        os.close(line)
    assert (answer ^ 0x01010105918B).bit_count() == 1


def test_other_units_are_ignored() -> None:
    with mpa(unit=9) as device, connect(device) as line:
        line.sendall(bytes.fromhex("00 07 00 00 00 06 01 01 00 00 00 08"))
        line.sendall(bytes.fromhex("00 08 00 00 00 06 09 01 00 00 00 08"))
        assert line.recv(9, socket.MSG_WAITALL)[:2] == b"\0\x08"
        assert device.truth.counts["ignored"] == 1


def test_as_a_process(tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    command = [sys.executable, str(Path(__file__).with_name("mpa.py"))]
    arguments = ["--tcp", ANY, "--truth", str(truth), "--unit", "7"]
    with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().removeprefix("listening "))
        with socket.create_connection(("127.0.0.1", port), PATIENCE) as line:
            line.sendall(bytes.fromhex("00 07 00 00 00 06 07 01 00 00 00 08"))
            assert line.recv(10, socket.MSG_WAITALL)[:9] == bytes.fromhex("0007 0000 0004 07 01 01")
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    assert [line["event"] for line in lines] == ["start", "answer", "end"]


@pytest.mark.parametrize(
    "bad",
    [
        {"tcp": None},
        {"pty": "line"},
        {"busy": "never"},
        {"drop": 0.6, "short": 0.6},
        {"channels": "0:10;2:15"},
        {"channels": "0:16"},
        {"channels": "65534:10"},
        {"fail": "4:x"},
    ],
)
def test_options_that_make_no_sense(bad: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError)):
        Options(**{"tcp": ANY, **bad})
    with pytest.raises(SystemExit):
        parse_options([])


def test_nothing_of_the_logger_or_of_a_library() -> None:
    allowed = {"mpa_model", "mpa_options", "roc_links", "roc_options", "roc_truth", "served"}
    allowed |= {"peer_options", "wire", "argparse", "asyncio", "collections", "concurrent"}
    allowed |= {"contextlib"}
    allowed |= {"dataclasses", "decimal", "itertools", "json", "os", "pathlib", "pty", "random"}
    allowed |= {"signal", "socket", "struct", "threading", "time", "tty", "typing", "__future__"}
    own = (
        "mpa.py",
        "mpa_model.py",
        "mpa_options.py",
        "peer_options.py",
        "served.py",
        "roc_links.py",
        "wire.py",
    )
    for name in own:
        for node in ast.walk(ast.parse(Path(__file__).with_name(name).read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                continue
            assert {found.partition(".")[0] for found in names} <= allowed | {"roc_model"}, name

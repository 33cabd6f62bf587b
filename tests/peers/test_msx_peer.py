"""The MSX-E3317 test device against raw octets: the document's frames, and every fault."""

from __future__ import annotations

import ast
import json
import signal
import socket
import struct
import subprocess
import sys
import time
import tomllib
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pytest
from msx import MsxDevice
from msx_options import Options, parse_options

if TYPE_CHECKING:
    from collections.abc import Iterator

FUNCTIONS = tomllib.loads(
    (Path(__file__).parents[1] / "vectors/msx/functions.toml").read_text(encoding="utf-8")
)["function"]
ANY = "127.0.0.1:0"
PATIENCE = 5.0
TIME_EX = bytes.fromhex("00 07 00 00 00 06 00 03 29 04 00 04")
TIME_EX_NEXT = bytes.fromhex("00 08 00 00 00 06 00 03 29 04 00 04")
STATUS_EX = bytes.fromhex("00 00 00 00 00 06 00 03 27 10 00 36")

both_orders = pytest.mark.parametrize("order", ["big", "little"])
both_ways = pytest.mark.parametrize("way", ["tcp", "udp"])


@contextmanager
def running(**options: Any) -> Iterator[MsxDevice]:
    with MsxDevice(Options(**{"tcp": ANY, "udp": ANY, **options})) as device:
        yield device


@contextmanager
def client(device: MsxDevice, way: str) -> Iterator[socket.socket]:
    kind = socket.SOCK_STREAM if way == "tcp" else socket.SOCK_DGRAM
    with closing(socket.socket(socket.AF_INET, kind)) as sock:
        sock.settimeout(PATIENCE)
        sock.connect(("127.0.0.1", device.ports[way]))
        yield sock


def ask(device: MsxDevice, way: str, octets: bytes) -> bytes:
    with client(device, way) as sock:
        sock.send(octets)
        return sock.recv(600)


@both_orders
@both_ways
def test_every_function_of_the_document(order: str, way: str) -> None:
    with running(order=order) as device, client(device, way) as sock:
        for function in FUNCTIONS:
            sock.send(bytes.fromhex(function["query"][order]))
            answer = sock.recv(600)
            assert answer.startswith(bytes.fromhex(function["answer"][order]))
            assert len(answer) == 6 + function["length"]
        assert [(c["register"], c["words"]) for c in device.calls()] == [
            (f["register"], f["words"]) for f in FUNCTIONS
        ]


@both_orders
def test_functions_that_no_document_describes(order: str) -> None:
    mark = ">" if order == "big" else "<"

    def answer(device: MsxDevice, register: int, words: int, size: int) -> bytes:
        """Checked up to the byte count of `size` octets."""
        query = struct.pack(f"{mark}HHHBBHH", 1, 0, 6, 1, 3, register, words)
        octets = ask(device, "udp", query)
        head = struct.unpack(f"{mark}HHHBB", octets[:8])
        assert head == (1, 0, len(octets) - 6, 1, 3)
        count, payload = octets[8 : 8 + size], octets[8 + size :]
        assert int.from_bytes(count, "big" if order == "big" else "little") == len(payload)
        return payload

    with running(order=order, acquisition=1000.0) as device:
        values = struct.unpack(f"{mark}I16fII", answer(device, 15300, 38, 1))
        old = struct.unpack(f"{mark}I16i", answer(device, 101, 34, 2))
        packed = answer(device, 15450, 66, 1)
        assert ask(device, "udp", struct.pack(f"{mark}HHHBBHH", 1, 0, 6, 1, 3, 15450, 67))[-1] == 3
    told = [line for line in device.truth.lines if line["event"] == "answer"]
    assert values[:17] == (0, *cast("list[float]", told[0]["values"]))
    assert values[18] * 10**6 + values[17] == told[0]["at_us"]
    assert [n / 16 for n in old[1:]] == list(values[1:17])
    assert len(packed) == 133
    assert int.from_bytes(packed[1:5], "big" if order == "big" else "little") == told[2]["serial"]
    assert packed[49:82].hex() == told[2]["key"]


@both_orders
def test_the_clock_runs_with_its_offset(order: str) -> None:
    mark = ">" if order == "big" else "<"
    query = next(f for f in FUNCTIONS if f["register"] == 10500)["query"][order]
    with running(order=order, clock_offset=-3600.0) as device:
        before = time.time()
        answer = ask(device, "udp", bytes.fromhex(query))
        after = time.time()
    seconds, microseconds = struct.unpack(f"{mark}II", answer[9:])
    assert before - 1e-3 <= seconds + microseconds / 1e6 + 3600 <= after + 1e-3
    told = next(line for line in device.truth.lines if line["event"] == "answer")
    assert (told["seconds"], told["microseconds"]) == (seconds, microseconds)


def test_a_failing_function_leaves_its_status_to_the_next_call() -> None:
    with running(fail="10500:-100:22:Invalid argument", fail_count=1) as device:
        assert ask(device, "tcp", TIME_EX) == bytes.fromhex("00 07 00 00 00 03 00 83 09")
        for _ in range(2):  # asking for the status does not change it
            status = ask(device, "tcp", STATUS_EX)
            assert struct.unpack(">ii", status[9:17]) == (-100, 22)
            assert status[17:] == b"Invalid argument".ljust(100, b"\0")
        assert len(ask(device, "tcp", TIME_EX)) == 17
        assert ask(device, "tcp", STATUS_EX)[9:] == bytes(108)


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        ("04 29 04 00 04", "84 01"),
        ("03 29 05 00 04", "83 02"),
        ("03 3B C4 00 02", "83 02"),
        ("03 29 04 00 03", "83 03"),
        ("03 29 04 00", "83 03"),
        ("10 2A F8 00 04 08 00 00 00 04 00 00 00 00", "10 2A F8 00 04"),
        ("10 00 64 00 04 00 08 00 00 00 04 00 00 00 00", "10 00 64 00 04"),
        ("10 00 64 00 04 08 00 00 00 04 00 00 00 00", "90 03"),
        ("10 2A F8 00 02 04 00 00 00 04", "90 03"),
        ("17 52 08 00 02 2A F8 00 04 08 00 00 00 04 00 00 00 00", "17 04 00 00 00 08"),
        ("17 00 02 00 04 27 11 00 01 02 00 00", "97 02"),
    ],
)
@both_ways
def test_calls_and_refusals(pdu: str, answer: str, way: str) -> None:
    def frame(octets: str) -> bytes:
        body = bytes.fromhex(octets)
        return bytes.fromhex("12 34 00 00 00") + bytes([len(body) + 1, 1]) + body

    with running() as device:
        assert ask(device, way, frame(pdu)) == frame(answer)


@both_ways
def test_octets_of_the_other_order_are_noise(way: str) -> None:
    with running(order="little") as device, client(device, way) as sock:
        sock.send(TIME_EX)
        if way == "tcp":
            with suppress(ConnectionResetError):
                assert sock.recv(1) == b""
        else:
            sock.send(bytes.fromhex("00 00 00 00 06 00 00 03 04 29 04 00"))
            assert len(sock.recv(600)) == 17
        assert device.truth.counts["noise"] == 1
        assert device.truth.counts["call"] == (way == "udp")


def test_lost_answers_were_calls_and_lost_requests_were_not() -> None:
    for fault, calls in (("drop", 1), ("drop_request", 0)):
        with running(**{fault: 1.0}) as device, client(device, "udp") as sock:
            sock.settimeout(0.2)
            sock.send(TIME_EX)
            with pytest.raises(TimeoutError):
                sock.recv(600)
            assert len(device.calls()) == calls


def test_doubled_and_swapped_datagrams() -> None:
    with running(duplicate=1.0) as device, client(device, "udp") as sock:
        sock.send(TIME_EX)
        assert sock.recv(600) == sock.recv(600)
        assert len(device.calls()) == 1
    with running(reorder=1.0, held_for=60.0) as device, client(device, "udp") as sock:
        sock.send(TIME_EX)
        sock.send(TIME_EX_NEXT)
        assert [sock.recv(600)[:2] for _ in range(2)] == [b"\0\x08", b"\0\x07"]


def test_answers_that_are_none() -> None:
    with running(short=1.0) as device:
        assert ask(device, "tcp", TIME_EX)[:9] == bytes.fromhex("00 07 00 00 00 07 00 03 04")
    with running(other_count=1.0) as device:
        assert ask(device, "tcp", TIME_EX)[:10] == bytes.fromhex("00 07 00 00 00 0C 00 03 00 08")
    with running(other_unit=1.0) as device:
        assert ask(device, "tcp", TIME_EX)[:9] == bytes.fromhex("00 07 00 00 00 0B 01 03 08")


def test_other_units_are_ignored() -> None:
    with running() as device, client(device, "udp") as sock:
        sock.send(TIME_EX[:6] + b"\2" + TIME_EX[7:])
        sock.send(TIME_EX)
        assert sock.recv(600)[6] == 0
        assert device.truth.counts["ignored"] == 1


def test_as_a_process(tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    command = [sys.executable, str(Path(__file__).with_name("msx.py"))]
    arguments = ["--udp", ANY, "--truth", str(truth), "--channels", "3"]
    with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        ports = ast.literal_eval(process.stdout.readline().removeprefix("listening "))
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sock:
            sock.settimeout(PATIENCE)
            sock.connect(("127.0.0.1", ports["udp"]))
            sock.send(bytes.fromhex("00 01 00 00 00 06 01 03 52 08 00 02"))
            assert sock.recv(600) == bytes.fromhex("00 01 00 00 00 07 01 03 04 00 00 00 03")
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    assert [line["event"] for line in lines] == ["start", "call", "answer"]
    assert lines[2]["number"] == 3


@pytest.mark.parametrize(
    "bad",
    [
        {"tcp": None, "udp": None},
        {"order": "middle"},
        {"channels": 17},
        {"drop": 0.6, "short": 0.6},
        {"fail": "10500:x"},
    ],
)
def test_options_that_make_no_sense(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        Options(**{"udp": ANY, **bad})
    with pytest.raises(SystemExit):
        parse_options([])

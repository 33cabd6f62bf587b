"""The device with time-stamped inputs against the octets of its document and a hand-made stamp."""

from __future__ import annotations

import ast
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from mei import MeiDevice
from mei_options import Options
from mei_stamps import octets

ANY = "127.0.0.1:0"


def ask(device: MeiDevice, pdu: str) -> bytes:
    """The answer's PDU."""
    request = bytes.fromhex(pdu)
    with socket.create_connection(("127.0.0.1", int(device.address)), 5) as line:
        line.sendall(b"\0\7\0\0" + (len(request) + 1).to_bytes(2) + b"\1" + request)
        head = line.recv(7, socket.MSG_WAITALL)
        assert (head[:4], head[6]) == (b"\0\7\0\0", 1)
        return line.recv(int.from_bytes(head[4:6]) - 1, socket.MSG_WAITALL)


def states(device: MeiDevice, table: str) -> list[dict[str, Any]]:
    return [line for line in device.truth.lines if line.get("table") == table]


def test_a_stamp_bit_by_bit() -> None:
    """2026-07-01 is a Wednesday; Berlin shows 12:20:30.456 then: 30456 = 0x76F8."""
    at = int(datetime(2026, 7, 1, 10, 20, 30, tzinfo=UTC).timestamp()) * 10**9 + 456_999_999
    assert octets(at, "Europe/Berlin").hex() == "f87614" + "8c" + "61" + "07" + "1a"
    assert octets(at, dow="sunday", iv=True).hex() == "f87694" + "0a" + "81" + "07" + "1a"
    assert octets(at, dow="unused").hex() == "f87614" + "0a" + "01" + "07" + "1a"


def test_discrete_inputs_as_in_the_example() -> None:
    """22 inputs from 196 on: byte count 0x9F, 3 octets of status, 0x9A octets of stamps."""
    with MeiDevice(Options(tcp=ANY, first=196, discrete=22)) as device:
        answer = ask(device, "2B 82 00 C4 00 16")
        short = ask(device, "2B 92 00 C4 00 16")
        truth = states(device, "discrete_inputs")
    assert (answer[:4].hex(), answer[7], len(answer)) == ("2b829f03", 0x9A, 3 + 0x9F)
    assert (short[:4].hex(), short[7], len(short)) == ("2b925d03", 0x58, 3 + 0x5D)
    for index, state in enumerate(truth):
        assert answer[4 + index // 8] >> index % 8 & 1 == state["value"]
        assert answer[8 + 7 * index : 15 + 7 * index].hex() == state["octets"]
        assert short[8 + 4 * index : 12 + 4 * index].hex() == state["octets"][:8]


@pytest.mark.parametrize("layout", ["interleaved", "grouped"])
def test_both_layouts(layout: str) -> None:
    with MeiDevice(Options(tcp=ANY, registers=2, first=8, layout=layout)) as device:
        answers = {7: ask(device, "2B 84 00 08 00 02"), 4: ask(device, "2B 94 00 08 00 02")}
        one, two = states(device, "input_registers")
    for size, answer in answers.items():
        a, b = (f"{state['value']:04x}" for state in (one, two))
        s, t = (state["octets"][: 2 * size] for state in (one, two))
        assert answer[2] == 2 * (2 + size)
        assert answer[3:].hex() == (a + s + b + t if layout == "interleaved" else a + b + s + t)


@pytest.mark.parametrize(("form", "more"), [("long", True), ("short", False)])
def test_both_exceptions(form: str, more: bool) -> None:
    fail = "0x94:1:4:1"
    with MeiDevice(Options(tcp=ANY, registers=50, exceptions=form, fail=fail)) as device:
        refused = {
            "2B 94 00 00 00 02": 4,
            "2B 94 00 31 00 02": 2,
            "2B 94 00 00 00 2A": 3,
            "2B 94 00 00 00 00": 3,
            "2B 0E 01 00": 1,
        }
        for request, code in refused.items():
            mei = request[3:5] if more else ""
            assert ask(device, request).hex() == f"ab{mei}{code:02x}".lower()
        assert ask(device, "03 00 00 00 01").hex() == "8301"
        assert ask(device, "2B 94 00 00 00 02")[0] == 0x2B


def test_nothing_of_the_logger_or_of_a_library() -> None:
    allowed = {"mei_model", "mei_options", "mei_stamps", "roc_links", "roc_options", "roc_truth"}
    allowed |= {
        "peer_options",
        "served",
        "wire",
        "argparse",
        "asyncio",
        "collections",
        "concurrent",
        "dataclasses",
    }
    allowed |= {"datetime", "functools", "signal", "threading", "time", "typing", "zoneinfo"}
    for path in Path(__file__).parent.glob("mei*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                continue
            assert {name.partition(".")[0] for name in names} <= allowed | {"__future__"}, path

"""The simulator's answers against the octets of the document."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from roclog.simulators.stamped_pdu import (
    Refused,
    as_printed,
    discrete_answer,
    exception_answer,
    parse_request,
    register_answer,
)

VECTORS: dict[str, Any] = tomllib.loads(
    (Path(__file__).parents[1] / "vectors/stamped/frames.toml").read_text(encoding="utf-8")
)


def by_source(key: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("vector", VECTORS[key], ids=lambda v: v["source"][:50])


def inputs_of_status(size: int) -> list[tuple[int, bytes]]:
    on = VECTORS["status"]["on"]
    return [(int(number in on), bytes([number & 0xFF] * size)) for number in range(197, 219)]


@by_source("request")
def test_requests(vector: dict[str, Any]) -> None:
    request = parse_request(bytes.fromhex(vector["pdu"]))
    assert (request.mei, request.address, request.count) == (
        vector["mei"], vector["address"], vector["count"],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("pdu", "code"),
    [
        ("2B 0E 01 00", 1),
        ("2B", 1),
        ("2B 83 00 00 00 01", 1),
        ("2B 82 00 00 00", 3),
        ("2B 82 00 00 00 01 00", 3),
        ("2B 82 00 00 00 00", 3),
        ("2B 82 00 00 00 23", 3),
        ("2B 84 00 00 00 1C", 3),
        ("2B 92 00 00 00 3D", 3),
        ("2B 94 00 00 00 2A", 3),
        ("2B 94 00 00 01 01", 3),
        ("2B 94 FF FF 00 02", 2),
    ],
)
def test_refusals(pdu: str, code: int) -> None:
    with pytest.raises(Refused) as caught:
        parse_request(bytes.fromhex(pdu))
    assert caught.value.code == code


@pytest.mark.parametrize("pdu", ["2B 82 00 00 00 22", "2B 84 FF E5 00 1B", "2B 92 00 00 00 3C"])
def test_the_largest_requests(pdu: str) -> None:
    assert parse_request(bytes.fromhex(pdu)).count == int(pdu[-2:], 16)


@by_source("registers")
def test_registers(vector: dict[str, Any]) -> None:
    inputs = list(zip(vector["values"], map(bytes.fromhex, vector["stamps"]), strict=True))
    answer = register_answer(vector["mei"], inputs, grouped=vector["layout"] == "grouped")
    assert answer == bytes.fromhex(vector["answer"])


@pytest.mark.parametrize(("mei", "head"), [(0x82, "2B 82 9F 03"), (0x92, "2B 92 5D 03")])
def test_discrete_inputs(mei: int, head: str) -> None:
    size = 7 if mei == 0x82 else 4
    answer = discrete_answer(mei, inputs_of_status(size))
    status = bytes.fromhex(VECTORS["status"]["octets"])
    assert answer[:8] == bytes.fromhex(head) + status + bytes([22 * size])
    assert answer[8:] == bytes(number & 0xFF for number in range(197, 219) for _ in range(size))


@by_source("exception")
def test_exceptions(vector: dict[str, Any]) -> None:
    pdu = bytes.fromhex(vector["pdu"])
    assert exception_answer(0x84, vector["code"], with_mei=len(pdu) == 3) == pdu


def test_the_misprinted_answer() -> None:
    right = discrete_answer(0x92, inputs_of_status(4))
    printed = bytes.fromhex(VECTORS["misprint"]["head"])
    assert as_printed(right) == printed + right[8:]
    assert as_printed(right, counts=False) == right[:1] + b"\x82" + right[2:]
    bent = as_printed(right, mei=False)
    assert [n for n, octet in enumerate(bent) if octet != right[n]] == [2, 7]
    assert (bent[2], bent[7]) == (0x98, 0x94)

"""``roclog decode``."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from roclog.cli.decode import decode


def run(*arguments: str) -> str:
    result = CliRunner().invoke(decode, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def values(*arguments: str) -> dict[tuple[str, str, str], Any]:
    found = json.loads(run(*arguments, "--json"))
    assert found["schema"] == "roclog.decode/1"
    return {(v["words"], v["type"], v["order"]): v["value"] for v in found["values"]}


def test_every_type_and_order() -> None:
    """Vaisala prints 41F47AE1 as 30.56, the lower word first."""
    found = values("7AE1", "41F4", "--try-all")
    assert found["1-2", "float32", "CDAB"] == 30.56
    assert found["1-2", "uint32", "CDAB"] == 0x41F47AE1
    assert found["1-2", "uint32", "BADC"] == 0xE17AF441
    assert found["1-2", "uint32", "DCBA"] == 0xF441E17A
    assert found["1", "uint16", "BA"] == 0xE17A
    assert found["2", "int16", "AB"] == 0x41F4
    assert found["1-2", "bcd32", "ABCD"] is None
    orders = {order for words, _, order in found if words == "1-2"}
    assert orders == {"ABCD", "CDAB", "BADC", "DCBA", "AB", "BA"}


def test_types_of_four_registers() -> None:
    """JUMO prints 1234567.89 as 4132D687E3D70A3D."""
    found = values("4132", "D687", "E3D7", "0A3D", "--try-all")
    assert found["1-4", "float64", "ABCD"] == 1234567.89
    assert {words for words, type_, _ in found if type_ == "uint32"} == {"1-2", "3-4"}


@pytest.mark.parametrize("words", [("0x4145", "0x70A4"), ("4145", "70a4"), ("16709", "28836")])
def test_words_in_every_form(words: tuple[str, ...]) -> None:
    assert values(*words, "--type", "float32") == {("1-2", "float32", "ABCD"): 12.34}


def test_decimal_words() -> None:
    assert values("1234", "--type", "uint16")["1", "uint16", "AB"] == 0x1234
    assert values("1234", "--type", "uint16", "--decimal")["1", "uint16", "AB"] == 1234
    assert values("-1", "--type", "int16")["1", "int16", "AB"] == -1


def test_one_order() -> None:
    found = values("5678", "1234", "--type", "uint32", "--order", "CDAB")
    assert found == {("1-2", "uint32", "CDAB"): 0x12345678}
    assert values("3412", "--type", "uint16", "--order", "BA") == {("1", "uint16", "BA"): 0x1234}


def test_infinity_is_text_in_json() -> None:
    assert values("7F80", "0000", "--type", "float32") == {("1-2", "float32", "ABCD"): "inf"}


def test_table() -> None:
    lines = run("3838", "3031", "0000", "--type", "text").splitlines()
    assert [line.split() for line in lines[2:]] == [
        ["words", "type", "order", "value"],
        ["1-3", "text", "AB", "8801"],
    ]
    assert "not decimal digits" in run("00FA", "--type", "bcd16")
    assert "\x1b" not in run("1B5B", "--type", "text")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((), "Missing argument"),
        (("zz",), "'zz' is not a word"),
        (("70000",), "70000 is not -32768 to 65535"),
        (("12345678",), "is not a word"),
        (("1", "--type", "float64"), "float64 needs 4 words, not 1"),
        (("1", "2", "3", "--type", "float32"), "2 words or a multiple of 2, not 3"),
        (("1", "--type", "float16"), "'float16' is not one of"),
        (("1",) * 126, "126 words are more than 125"),
    ],
)
def test_wrong_use(arguments: tuple[str, ...], text: str) -> None:
    result = CliRunner().invoke(decode, arguments)
    assert result.exit_code == 2
    assert text in result.output

"""What the build holds about the shape of the code, beyond the import contracts."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import roclog

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "src" / "roclog").rglob("*.py"))
PEERS = sorted((ROOT / "tests" / "peers").glob("*.py"))
MODBUS_LIBRARIES = {"pymodbus", "modbus_tk", "minimalmodbus", "umodbus", "pyModbusTCP", "tmodbus"}


def imported(path: Path) -> set[str]:
    """First parts of everything a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").partition(".")[0])
    return found


@pytest.mark.parametrize("path", PEERS, ids=lambda path: path.name)
def test_a_peer_shares_no_code_with_the_logger(path: Path) -> None:
    assert not imported(path) & ({"roclog"} | MODBUS_LIBRARIES)


def test_there_are_peers() -> None:
    assert len(PEERS) > 3


def code_lines(path: Path) -> int:
    lines = path.read_text().splitlines()
    return sum(1 for line in lines if line.strip() and not line.strip().startswith("#"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_a_module_stays_readable(path: Path) -> None:
    assert code_lines(path) <= 400
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            assert node.end_lineno - node.lineno < 60, node.name


def test_public_names_exist() -> None:
    assert sorted(roclog.__all__, key=str.lower) == sorted(set(roclog.__all__), key=str.lower)
    for name in roclog.__all__:
        assert getattr(roclog, name) is not None


def test_unknown_public_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = roclog.nonsense

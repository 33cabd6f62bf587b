"""Every way in which a configuration can be wrong, and the line that says so."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roclog.config import load
from roclog.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

TABLES = {
    "@rtu": '[connections.bus]\ntransport = "rtu"\nport = "/dev/ttyS9"\n',
    "@tcp": '[connections.net]\ntransport = "tcp"\nhost = "10.0.0.1"\n',
    "@gateway": '[connections.bus]\ntransport = "rtu-over-tcp"\nhost = "10.0.0.2"\nport = 4001\n',
    "@roc": '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "bus"\n',
    "@net_roc": '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "net"\n',
}
RTU, ROC = TABLES["@rtu"], TABLES["@roc"]
CASES = tomllib.loads(Path(__file__).with_name("problems.toml").read_text())["case"]


@pytest.mark.parametrize("case", CASES, ids=[case["problem"][:60] for case in CASES])
def test_problem_is_told(case: dict[str, str], refusal: Callable[[str], list[str]]) -> None:
    text = case["config"]
    for mark, table in TABLES.items():
        text = text.replace(f"{mark}\n", table)
    lines = refusal(text)
    assert case["problem"] in lines
    assert all(line.isprintable() for line in lines)


def test_all_problems_at_once(refusal: Callable[[str], list[str]]) -> None:
    lines = refusal("""
        extra = 1
        [recording]
        segment = { duration = "1 hour" }
        [connections.bus]
        transport = "rtu"
        port = "/dev/ttyS9"
        baudrate = true
        silence = "2 chars"
        [connections.net]
        transport = "tcp"
        port = 70000
        [devices.roc1]
        profile = "hiac-rock"
        connection = "buss"
        unit = 300
        [devices.roc2]
        profile = "weather"
    """)
    assert [line.partition(":")[0] for line in lines] == [
        "extra",
        "recording.segment.duration",
        "connections.bus.baudrate",
        "connections.net.host",
        "connections.net.port",
        "devices.roc1.profile",
        "devices.roc1.unit",
        "devices.roc2.profile",
        "devices.roc2.connection",
        "devices.roc1.connection",
    ]


def test_a_wrong_value_causes_no_second_problem(refusal: Callable[[str], list[str]]) -> None:
    """late_answer fits the timeout that was meant, not the default."""
    assert len(refusal(RTU + "timeout = '1 00ms'\nlate_answer = '200ms'\n" + ROC)) == 1


def test_serial_ports_are_compared_through_links(
    tmp_path: Path, refusal: Callable[[str], list[str]]
) -> None:
    (tmp_path / "by-id").symlink_to("/dev/ttyS9")
    text = RTU + RTU.replace("bus", "other").replace("/dev/ttyS9", "by-id") + ROC
    assert len(refusal(text)) == 1


SYNTAX = [
    ("[devices", "line 1, column 9: not TOML: "),
    ("a = 1\nb = \nc = 2", "line 2, column 5: not TOML: "),
    ("a = 1\na = 2", "line 2, column 6: not TOML: "),
    ('a = "abc', "line 1, column 9: not TOML: "),
    ("a = " + "[" * 100_000, "arrays or tables are nested too deeply"),
    ("a = " + "9" * 100_000, "not a TOML value: "),
    ("# " + "x" * (1 << 20), "is larger than 1 MiB, so not a configuration"),
]


@pytest.mark.parametrize(("text", "start"), SYNTAX, ids=[start[:30] for _, start in SYNTAX])
def test_syntax_errors_name_the_place(
    text: str, start: str, refusal: Callable[[str], list[str]]
) -> None:
    (line,) = refusal(text)
    assert line.startswith(start)
    assert "\n" not in line


def test_a_date_that_does_not_exist(refusal: Callable[[str], list[str]]) -> None:
    (line,) = refusal("a = 2026-02-30")
    assert re.match("line 1, column [0-9]+: not TOML: |not a TOML value: ", line)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read: No such file"):
        load(tmp_path / "none.toml")


def test_directory(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is a directory, not a configuration file"):
        load(tmp_path)


def test_unreadable_file(unprivileged_path: Path) -> None:
    path = unprivileged_path / "roclog.toml"
    path.touch(mode=0)
    with pytest.raises(ConfigError, match="cannot be read: Permission denied"):
        load(path)


def test_not_text(tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
    path.write_bytes(b"a = 1\n# \xff\n")
    with pytest.raises(ConfigError, match=r"roclog\.toml: line 2: is not UTF-8 text"):
        load(path)


def test_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
    path.write_bytes(b"\xef\xbb\xbf" + (RTU + ROC).encode())
    assert "roc1" in load(path).devices


def test_nul_in_the_name_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path / "a\0b")

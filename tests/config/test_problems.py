"""Every way in which a configuration can be wrong, and the line that says so."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

import pytest

from roclog.config import load
from roclog.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

RTU = '[connections.bus]\ntransport = "rtu"\nport = "/dev/ttyS9"\n'
TCP = '[connections.net]\ntransport = "tcp"\nhost = "10.0.0.1"\n'
ROC = '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "bus"\n'
NET_ROC = '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "net"\n'

DURATION = "a number and one of us, ms, s, min, h, d, like 500ms or 15s"
SIZE = "a number and one of B, KiB, MiB, GiB, TiB, like 64 MiB"
NAMING = "name is not 1 to 32 of a-z, 0-9, - and _, with a letter or digit first"

CASES = [
    # unknown keys
    (RTU + ROC + 'pol = "1s"', 'devices.roc1.pol: unknown key, did you mean "poll"?'),
    (RTU + 'baud = 9600\n' + ROC, 'connections.bus.baud: unknown key, did you mean "baudrate"?'),
    (TCP + "parity = 'N'\n" + NET_ROC, "connections.net.parity: unknown key"),
    (TCP + 'late_answer = "2s"\n' + NET_ROC, "connections.net.late_answer: unknown key"),
    ('"x\\u001by" = 1\n' + RTU + ROC, '"x\\u001by": unknown key'),
    ("[device.roc2]\n" + RTU + ROC, 'device: unknown key, did you mean "devices"?'),
    ("[recording.sgment]\n" + RTU + ROC, 'recording.sgment: unknown key, did you mean "segment"?'),
    # types
    (RTU + ROC + "poll = 1", 'devices.roc1.poll: 1 is not a duration in quotes, like "500ms" or "15s"'),
    (RTU + ROC + "poll = inf", 'devices.roc1.poll: inf is not a duration in quotes, like "500ms" or "15s"'),
    (RTU + ROC + "unit = true", "devices.roc1.unit: true is not a unit: 1 to 247 on serial lines, 0 to 255 on TCP"),
    (RTU + ROC + "unit = 3.0", "devices.roc1.unit: 3.0 is not a unit: 1 to 247 on serial lines, 0 to 255 on TCP"),
    (RTU + ROC + "unit = nan", "devices.roc1.unit: nan is not a unit: 1 to 247 on serial lines, 0 to 255 on TCP"),
    (RTU + ROC + "unit = [1]", "devices.roc1.unit: an array is not a unit: 1 to 247 on serial lines, 0 to 255 on TCP"),
    (RTU + ROC + "acknowledge = 1", "devices.roc1.acknowledge: 1 is not true or false, without quotes"),
    (RTU + ROC + 'acknowledge = "no"', 'devices.roc1.acknowledge: "no" is not true or false, without quotes'),
    (RTU + ROC + "word_order = 'abcd'", 'devices.roc1.word_order: "abcd" is not "ABCD" or "CDAB", did you mean "ABCD"?'),
    (RTU + ROC + "word_order = 'DCBA'", 'devices.roc1.word_order: "DCBA" is not "ABCD" or "CDAB"'),
    ("recording = 1979-05-27\n" + RTU + ROC, "recording: 1979-05-27 is not a table"),
    ("recording = { segment = '1h' }\n" + RTU + ROC, 'recording.segment: "1h" is not a table'),
    ("connections = 5\n" + ROC, "connections: 5 is not a table, write [connections.NAME]"),
    ("[[connections]]\n" + ROC, "connections: an array is not a table, write [connections.NAME]"),
    ("connections.bus = 5\n" + ROC, "connections.bus: 5 is not a table, write [connections.NAME]"),
    (RTU + "[[devices]]\nunit = 1", "devices: an array is not a table, write [devices.NAME]"),
    (RTU + "[devices]\nroc1 = 1", "devices.roc1: 1 is not a table"),
    # durations
    (RTU + ROC + "poll = '1 sec'", f"devices.roc1.poll: '1 sec' is not a duration: {DURATION}"),
    (RTU + ROC + "poll = '-1s'", f"devices.roc1.poll: '-1s' is not a duration: {DURATION}"),
    (RTU + ROC + "poll = '0s'", "devices.roc1.poll: '0s' is not more than 0 and at most 36500d"),
    (RTU + ROC + "poll = '99999d'", "devices.roc1.poll: '99999d' is not more than 0 and at most 36500d"),
    (RTU + ROC + "poll = '0.0001us'", "devices.roc1.poll: '0.0001us' is finer than a duration can be"),
    (RTU + "timeout = '0ms'\n" + ROC, "connections.bus.timeout: '0ms' is not more than 0 and at most 36500d"),
    (RTU + ROC + "cycle = 15", 'devices.roc1.cycle: 15 is not a duration in quotes, like "500ms" or "15s"'),
    # sizes and segments
    ("recording.segment.size = '64 MB'\n" + RTU + ROC, f"recording.segment.size: '64 MB' is not a size: {SIZE}"),
    ("recording.segment.size = '0 B'\n" + RTU + ROC, "recording.segment.size: '0 B' is not more than 0 and at most 8192 TiB"),
    ("recording.segment.size = '63 KiB'\n" + RTU + ROC, "recording.segment.size: 64512 octets is less than 64 KiB"),
    ("recording.segment.size = 64\n" + RTU + ROC, 'recording.segment.size: 64 is not a size in quotes, like "64 MiB"'),
    ("recording.segment.duration = '999ms'\n" + RTU + ROC, "recording.segment.duration: 999ms is less than 1s"),
    ("recording.keep.age = '59min'\n" + RTU + ROC, "recording.keep.age: is less than the duration of one segment"),
    ("recording.keep.size = '1 MiB'\n" + RTU + ROC, "recording.keep.size: is less than the size of one segment"),
    ("recording.keep.age = 'forever'\n" + RTU + ROC, f"recording.keep.age: 'forever' is not a duration: {DURATION}"),
    # paths
    ("recording.directory = ''\n" + RTU + ROC, 'recording.directory: "" is not a path: text without control characters'),
    ("recording.directory = 'a\\u0000b'\n".replace("'", '"') + RTU + ROC, 'recording.directory: "a\\u0000b" is not a path: text without control characters'),
    ("recording.directory = '~/x'\n" + RTU + ROC, 'recording.directory: "~/x": ~ is not expanded, write the whole path'),
    # connections
    (ROC, "connections: missing, needed is at least one table [connections.NAME]"),
    ("[connections]\n" + ROC, "connections: missing, needed is at least one table [connections.NAME]"),
    ("[connections.bus]\nport = '/dev/x'\n" + ROC, 'connections.bus.transport: missing, needed is "rtu" or "tcp"'),
    ("[connections.bus]\ntransprt = 'rtu'\n" + ROC, 'connections.bus.transprt: unknown key, did you mean "transport"?'),
    ("[connections.bus]\ntransport = 'rtus'\n" + ROC, 'connections.bus.transport: "rtus" is not "rtu" or "tcp", did you mean "rtu"?'),
    ("[connections.bus]\ntransport = 5\n" + ROC, 'connections.bus.transport: 5 is not "rtu" or "tcp"'),
    ("[connections.bus]\ntransport = 'udp'\n" + ROC, 'connections.bus.transport: "udp" is not in this version, only "rtu" and "tcp" are'),
    ("[connections.bus]\ntransport = 'rtu-over-tcp'\n" + ROC, 'connections.bus.transport: "rtu-over-tcp" is not in this version, only "rtu" and "tcp" are'),
    ("[connections.bus]\ntransport = 'rtu'\n" + ROC, "connections.bus.port: missing, needed is the path of a serial port"),
    ("[connections.net]\ntransport = 'tcp'\n" + NET_ROC, "connections.net.host: missing, needed is a host name or an IP address"),
    (TCP + "port = 0\n" + NET_ROC, "connections.net.port: 0 is not a port from 1 to 65535"),
    (TCP + "port = 65536\n" + NET_ROC, "connections.net.port: 65536 is not a port from 1 to 65535"),
    (TCP + "port = '502'\n" + NET_ROC, 'connections.net.port: "502" is not a port from 1 to 65535'),
    (TCP.replace("10.0.0.1", "10.0.0.1:502") + NET_ROC, 'connections.net.host: "10.0.0.1:502" is not a host name or an IP address; the port goes into "port"'),
    (TCP.replace("10.0.0.1", "a b") + NET_ROC, 'connections.net.host: "a b" is not a host name or an IP address'),
    (TCP.replace("10.0.0.1", "a..b") + NET_ROC, 'connections.net.host: "a..b" is not a host name or an IP address'),
    (TCP.replace("10.0.0.1", "fe80::zz") + NET_ROC, 'connections.net.host: "fe80::zz" is not a host name or an IP address'),
    (TCP.replace('"10.0.0.1"', "10") + NET_ROC, "connections.net.host: 10 is not a host name or an IP address"),
    (RTU + "baudrate = 0\n" + ROC, "connections.bus.baudrate: 0 is not a whole number from 1 to 4000000"),
    (RTU + "baudrate = -9600\n" + ROC, "connections.bus.baudrate: -9600 is not a whole number from 1 to 4000000"),
    (RTU + "bytesize = 7\n" + ROC, "connections.bus.bytesize: 7 is not 8"),
    (RTU + "parity = 'none'\n" + ROC, 'connections.bus.parity: "none" is not "N", "E" or "O"'),
    (RTU + "stopbits = 1.5\n" + ROC, "connections.bus.stopbits: 1.5 is not 1 or 2"),
    (RTU + "stopbits = true\n" + ROC, "connections.bus.stopbits: true is not 1 or 2"),
    (RTU + "timeout = '1s'\nlate_answer = '999ms'\n" + ROC, "connections.bus.late_answer: 999ms is less than the timeout, 1s"),
    (RTU + "silence = '3.4 chars'\n" + ROC, "connections.bus.silence: 3541.668us is less than 3.5 characters, 3645.835us at 9600 baud"),
    (RTU + "silence = '3ms'\n" + ROC, "connections.bus.silence: 3ms is less than 3.5 characters, 3645.835us at 9600 baud"),
    (RTU + "silence = '0 chars'\n" + ROC, "connections.bus.silence: '0 chars' is not more than 0 and at most 1000 chars"),
    (RTU + "silence = 5\n" + ROC, 'connections.bus.silence: 5 is not a duration or a number of characters, like "5 chars"'),
    (RTU + RTU.replace("bus", "other") + ROC, 'connections.other.port: /dev/ttyS9 is the place of connection "bus" already'),
    (TCP + TCP.replace("net", "other") + NET_ROC, 'connections.other.host: 10.0.0.1:502 is the place of connection "net" already'),
    # devices
    (RTU, "devices: missing, needed is at least one table [devices.NAME]"),
    (RTU + "[devices.roc1]\nconnection = 'bus'", "devices.roc1.profile: missing, needed is the name of a profile"),
    (RTU + "[devices.roc1]\nprofile = 'hiac-roc'", "devices.roc1.connection: missing, needed is the name of a connection"),
    (RTU + ROC.replace("hiac-roc", "hiac_roc"), 'devices.roc1.profile: no profile "hiac_roc", did you mean "hiac-roc"?'),
    (RTU + ROC.replace("hiac-roc", "weather"), 'devices.roc1.profile: no profile "weather", known: hiac-roc'),
    (RTU + ROC.replace('"bus"', '"bsu"'), 'devices.roc1.connection: no connection "bsu", did you mean "bus"?'),
    (RTU + ROC.replace('"bus"', '"zz"'), 'devices.roc1.connection: no connection "zz"'),
    (RTU + ROC + "unit = 0", "devices.roc1.unit: 0 is not a unit on a serial line, 1 to 247"),
    (RTU + ROC + "unit = 248", "devices.roc1.unit: 248 is not a unit on a serial line, 1 to 247"),
    (TCP + NET_ROC + "unit = 256", "devices.roc1.unit: 256 is not a unit: 1 to 247 on serial lines, 0 to 255 on TCP"),
    (TCP + NET_ROC + "unit = -1", "devices.roc1.unit: -1 is not a unit: 1 to 247 on serial lines, 0 to 255 on TCP"),
    (RTU + ROC.replace("roc1", "log"), "devices.log: a device cannot be called log, that is the topic of events"),
    (RTU + ROC.replace("roc1", "Roc"), f"devices.Roc: {NAMING}"),
    (RTU + ROC.replace("roc1", '"../x"'), f'devices."../x": {NAMING}'),
    (RTU + ROC.replace("roc1", "r" * 33), f"devices.{'r' * 33}: {NAMING}"),
    (RTU.replace(".bus", '."b us"') + ROC, f'connections."b us": {NAMING}'),
    (
        RTU + ROC + ROC.replace("roc1", "roc2"),
        'devices.roc2.unit: 138 is the unit of device "roc1" on the same connection, and both would '
        "clear its flag; acknowledge = false on one of them, or another unit",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line"), CASES, ids=[line[:60] for _, line in CASES])
def test_problem_is_told(text: str, line: str, refusal: Callable[[str], list[str]]) -> None:
    lines = refusal(text)
    assert line in lines
    assert all(each.isprintable() for each in lines)


@pytest.mark.parametrize("profile", ["mei-timestamped", "mpa-48", "msx-e3317", "registers"])
def test_later_profiles_are_told_apart_from_wrong_ones(
    profile: str, refusal: Callable[[str], list[str]]
) -> None:
    """Their own keys are not called unknown."""
    text = RTU + ROC.replace("hiac-roc", profile) + "points = []\nsensors = {}"
    only = f'devices.roc1.profile: "{profile}" is not in this version, only "hiac-roc" is'
    assert refusal(text) == [only]


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
        profile = "mpa-48"
    """)
    assert [line.partition(":")[0] for line in lines] == [
        "extra",
        "recording.segment.duration",
        "connections.bus.baudrate",
        "connections.net.host",
        "connections.net.port",
        "devices.roc1.unit",
        "devices.roc1.profile",
        "devices.roc2.profile",
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


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable_file(tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
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

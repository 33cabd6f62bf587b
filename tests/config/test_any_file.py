"""Whatever a file holds: settings that keep their promises, or ConfigError; nothing else."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roclog.config import bus_loads, load, warnings
from roclog.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

VALID = """\
[recording]
directory = "recordings"
segment = { duration = "1h", size = "64 MiB" }
keep = { age = "90d", size = "20 GiB" }
[connections.bus]
transport = "rtu"
port = "/dev/ttyS9"
baudrate = 9600
bytesize = 8
parity = "N"
stopbits = 1
timeout = "500ms"
late_answer = "1s"
silence = "5 chars"
low_latency = true
rs485 = { rts_on_send = true, rts_after_send = false, delay_before_send = "0ms" }
[connections.net]
transport = "tcp"
host = "10.0.0.1"
port = 502
timeout = "1s"
[connections.gateway]
transport = "rtu-over-tcp"
host = "10.0.0.2"
port = 4001
baudrate = 19200
timeout = "500ms"
late_answer = "1s"
silence = "5 chars"
[connections.datagrams]
transport = "udp"
host = "10.0.0.1"
port = 502
timeout = "1s"
[devices.roc1]
profile = "hiac-roc"
connection = "bus"
unit = 138
poll = "1s"
word_order = "ABCD"
acknowledge = true
cycle = "15s"
[devices.roc2]
profile = "hiac-roc"
connection = "net"
[devices.roc3]
profile = "hiac-roc"
connection = "gateway"
[devices.roc4]
profile = "hiac-roc"
connection = "datagrams"
""".splitlines()

_TRANSPORTS = ["rtu", "tcp", "udp", "rtu-over-tcp"]
_WORDS = ["bus", "net", *_TRANSPORTS, "hiac-roc", "mpa-48", "log", "5 chars", "CDAB", "0s"]
_DURATIONS = st.builds(
    lambda number, unit: f"{number}{unit}",
    st.integers(0, 10**6) | st.floats(0, 10**6, allow_nan=False),
    st.sampled_from(["us", "ms", " s", "min", "h", "d", " chars", " KiB", " GiB", ""]),
)
_TEXT = st.text(st.characters(codec="utf-8"), max_size=60)
_SCALARS = (
    (_TEXT | _DURATIONS | st.sampled_from(_WORDS)).map(json.dumps)
    | st.integers().map(str)
    | st.floats().map(str)
    | st.booleans().map(lambda value: str(value).lower())
    | st.datetimes().map(lambda moment: moment.isoformat())
)
_VALUES = (
    _SCALARS
    | st.lists(_SCALARS, max_size=3).map(lambda items: f"[{', '.join(items)}]")
    | st.just("{}")
    | st.just('{ a = { duration = "1h" }, duration = "2h" }')
)
_KEYS = st.sampled_from([line.split(" ")[0] for line in VALID]) | _TEXT.map(json.dumps)
_LINES = st.builds(lambda key, value: f"{key} = {value}", _KEYS, _VALUES) | _KEYS | _TEXT


FILES = settings(
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
"""The first example builds tables of characters, which takes a second."""


def judge(path: Path) -> bool:
    """Whether the file is accepted. Fails where roclog breaks a promise about any file."""
    try:
        found = load(path)
    except ConfigError as error:
        lines = [str(problem) for problem in error.problems]
        assert lines
        assert all(line.isprintable() for line in lines), lines
        assert len(set(lines)) == len(lines), lines
        return False
    assert found.devices
    for connection in found.connections.values():
        assert connection.timeout > 0
        assert connection.late_answer is None or connection.late_answer >= connection.timeout
        assert connection.silence >= 3.5 * connection.character
        assert (connection.character > 0) == connection.is_serial
        if connection.rs485 is not None:
            assert connection.transport == "rtu"
            assert connection.rs485.rts_on_send != connection.rs485.rts_after_send
    for device in found.devices.values():
        serial = found.connections[device.connection].is_serial
        assert device.poll > 0
        assert device.unit in (range(1, 248) if serial else range(256))
    assert all(str(warning).isprintable() for warning in warnings(found))
    assert all(0 < load.least < load.expected for load in bus_loads(found))
    return True


@settings(FILES, max_examples=400)
@given(st.dictionaries(st.integers(0, len(VALID) - 1), _LINES | st.none(), max_size=4))
def test_any_change_of_lines(tmp_path: Path, changes: dict[int, str | None]) -> None:
    lines = [changes.get(number, line) for number, line in enumerate(VALID)]
    path = tmp_path / "roclog.toml"
    path.write_text("\n".join(line for line in lines if line is not None), encoding="utf-8")
    accepted = judge(path)
    assert accepted or changes


@settings(FILES, max_examples=200)
@given(st.integers(0, len(VALID) - 1), _VALUES)
def test_any_value(tmp_path: Path, number: int, value: str) -> None:
    key = VALID[number].partition(" = ")[0]
    path = tmp_path / "roclog.toml"
    lines = [*VALID[:number], f"{key} = {value}", *VALID[number + 1 :]]
    path.write_text("\n".join(lines), encoding="utf-8")
    judge(path)


@settings(FILES, max_examples=200)
@given(st.binary(max_size=200))
def test_any_octets(tmp_path: Path, octets: bytes) -> None:
    path = tmp_path / "roclog.toml"
    path.write_bytes(octets)
    assert not judge(path)

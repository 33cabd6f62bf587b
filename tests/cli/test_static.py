"""The commands that need no recording, and what every command does with errors."""

from __future__ import annotations

import csv
import errno
import json
import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import time
from decimal import Decimal
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import pytest
from click.testing import CliRunner

from roclog.cli import COMMANDS, cli
from roclog.cli.check import look_at
from roclog.cli.init import configuration, serial_ports
from roclog.cli.profiles import _rows
from roclog.cli.read import _print_block
from roclog.config import bus_loads, load, warnings
from roclog.decode import decode
from roclog.devices import CONFIGURED, PROFILES
from roclog.errors import (
    ConfigError,
    DamagedFile,
    LinkDown,
    Problem,
    RegisterMapError,
    StorageError,
    WriteRefused,
)
from roclog.probe import BlockRead
from roclog.register_map import Block, Point, Table, UnixSeconds, WordOrder, WordType

if TYPE_CHECKING:
    from click.testing import Result

ROCLOG = [sys.executable, "-m", "roclog"]
RTU = '[connections.bus]\ntransport = "rtu"\nport = "/dev/ttyS9"\n'
ROC = '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "bus"\n'


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(each) for each in arguments], prog_name="roclog")


def run(*arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [*ROCLOG, *(str(each) for each in arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "roclog.toml"
    path.write_text(RTU + ROC)
    path.chmod(0o644)
    return path


# the group


@pytest.mark.parametrize("entry", COMMANDS, ids=lambda entry: entry.name)
def test_table_of_commands_is_true(entry: Any) -> None:
    command = getattr(import_module(f"roclog.cli.{entry.name}"), entry.name)
    assert isinstance(command, click.Command)
    assert command.name == entry.name
    help_text = " ".join((command.help or "").split("\b")[0].split())
    assert "Example:" in (command.help or "")
    assert help_text


@pytest.mark.parametrize("name", ["init", "check", "simulate", "profiles"])
def test_help_of_a_command(name: str) -> None:
    result = invoke(name, "--help")
    assert result.exit_code == 0
    assert f"roclog {name}" in result.stdout
    entry = next(entry for entry in COMMANDS if entry.name == name)
    assert entry.help in result.stdout


def test_help_imports_no_command() -> None:
    program = (
        "import sys; from roclog.cli import cli; cli(['--help'], standalone_mode=False);"
        "print([m for m in sys.modules if m.startswith('roclog.') or m in ('rich', 'msgspec')])"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert result.stdout.splitlines()[-1] == "['roclog.errors', 'roclog.cli']"


def test_version() -> None:
    assert re.fullmatch(r"roclog \d+\.\d+\.\d+\S*\n", run("--version").stdout)


@pytest.mark.parametrize("arguments", [["nonsense"], ["check"], ["check", "--nonsense"], []])
def test_wrong_usage(arguments: list[str]) -> None:
    result = run(*arguments)
    assert result.returncode == 2
    assert "Usage: " in result.stderr
    assert not result.stdout


ERRORS: list[tuple[Exception, int, str]] = [
    (
        ConfigError(Path("x.toml"), [Problem("a.b", "bad"), Problem("", "worse")]),
        3,
        "roclog: x.toml: a.b: bad\nroclog: x.toml: worse\n",
    ),
    (RegisterMapError("x", ["bad"]), 3, "roclog: register map x: bad\n"),
    (LinkDown("no line"), 4, "roclog: no line\n"),
    (DamagedFile(Path("x.mcap"), 7, "cut off"), 5, "roclog: x.mcap: cut off at offset 7\n"),
    (StorageError(Path("x"), "full"), 6, "roclog: x: full\n"),
    (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), 6, "roclog: No space left on device\n"),
    (FileNotFoundError(2, "No such file", "x"), 6, "roclog: x: No such file\n"),
    (WriteRefused("no"), 1, "roclog: no\n"),
    (ExceptionGroup("", [LinkDown("one"), LinkDown("two")]), 4, "roclog: one\nroclog: two\n"),
    (KeyboardInterrupt(), 130, ""),  # type: ignore[list-item]
    (
        ZeroDivisionError("oops"),
        1,
        (
            "roclog: unexpected error: ZeroDivisionError: oops\n"
            "roclog: please report this; --debug shows where\n"
        ),
    ),
]


@pytest.mark.parametrize(("error", "code", "lines"), ERRORS, ids=lambda value: type(value).__name__)
def test_errors_are_exit_codes_and_lines(
    error: Exception, code: int, lines: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("roclog.cli.profiles._print_table", fail)
    result = invoke("profiles")
    assert (result.exit_code, result.stderr) == (code, lines)


def test_debug_shows_where(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roclog.cli.profiles._print_table", lambda *_: 1 / 0)
    result = invoke("--debug", "profiles")
    assert result.exit_code == 1
    assert "Traceback" in result.stderr
    assert result.stderr.endswith("roclog: please report this, with the lines above\n")


def test_closed_pipe_is_quiet() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    process = subprocess.run(
        [*ROCLOG, "profiles", "hiac-roc"], stdout=write_end, stderr=subprocess.PIPE, check=False
    )
    os.close(write_end)
    assert (process.returncode, process.stderr) == (141, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_disk_behind_stdout() -> None:
    with Path("/dev/full").open("w") as full:
        process = subprocess.run(
            [*ROCLOG, "profiles"], stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert process.returncode == 6
    assert process.stderr.startswith(b"roclog: No space left on device\n")


# init


def test_init_writes_what_load_accepts(tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
    result = invoke("init", path)
    assert result.exit_code == 0
    assert not result.stdout
    path.chmod(0o644)
    settings = load(path)
    assert warnings(settings) == []
    assert path.read_text().startswith("#:schema ")
    assert settings.connections["simulator"].place == "127.0.0.1:5020"


def test_init_does_not_overwrite(tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
    path.write_text("precious")
    result = invoke("init", path)
    assert result.exit_code == 2
    assert f"{path} is there already; --force overwrites it" in " ".join(result.stderr.split())
    assert path.read_text() == "precious"
    assert invoke("init", path, "--force").exit_code == 0
    assert load(path)


def test_init_to_stdout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke("init", "-")
    assert result.stdout == configuration("roclog.toml", serial_ports())
    assert not list(tmp_path.iterdir())


def test_init_in_a_directory_that_is_missing(tmp_path: Path) -> None:
    result = invoke("init", tmp_path / "none" / "roclog.toml")
    assert result.exit_code == 6
    assert result.stderr.endswith("No such file or directory\n")


def test_init_lists_serial_ports(tmp_path: Path) -> None:
    (tmp_path / "usb-B").symlink_to("/dev/null")
    (tmp_path / "usb-A").symlink_to("/dev/null")
    ports = serial_ports(tmp_path)
    assert ports == [f"{tmp_path}/usb-A", f"{tmp_path}/usb-B"]
    text = configuration("roclog.toml", ports)
    assert f"# A serial line. Found at present:\n#   {ports[0]}\n#   {ports[1]}\n" in text
    assert f'# port = "{ports[0]}"' in text
    assert serial_ports(tmp_path / "none") == []


def test_commented_parts_of_init_are_valid(tmp_path: Path) -> None:
    """With every comment that looks like TOML made active."""
    lines = configuration("x", []).splitlines()
    active = [re.sub(r"^# (?=\[|\]|  \{|\w+ = )", "", line) for line in lines]
    path = tmp_path / "roclog.toml"
    path.write_text("\n".join(active))
    settings = load(path)
    assert list(settings.devices) == ["roc1", "roc2", "roc3", "meter"]
    assert settings.connections["gateway"].place == "192.168.1.40:4001"
    assert settings.recording.keep_size == 20 << 30
    assert settings.connections["hydraulics"].silence == 5_208_335
    assert settings.connections["hydraulics"].rs485 is not None


# check


def test_check_shows_what_will_be_recorded(config: Path) -> None:
    result = invoke("check", config)
    assert (result.exit_code, result.stderr) == (0, "")
    text = result.stdout
    assert f"file        {config}\n" in text
    assert f"directory   {config.parent}/recordings, will be created, " in text
    assert "segments    end at 1h or 64 MiB, kept: all\n" in text
    assert (
        "connection  bus: rtu /dev/ttyS9, 9600 Bd 8N1, timeout 500ms, late answer 1s, "
        "silence 5.21ms\n"
    ) in text
    assert (
        "device      roc1: hiac-roc, unit 138 on bus, poll 1s, cycle as the device says, ABCD, "
        "clears its flag\n"
    ) in text
    assert "bus load    bus: 8.5%\n" in text
    assert (
        "roc1: request 8.33ms + turnaround 10.00ms + answer 61.46ms + silence 5.21ms every 1s\n"
    ) in text


def test_check_shows_direction_control_and_the_doubtful_name_of_a_port(config: Path) -> None:
    text = config.read_text().replace("/dev/ttyS9", "/dev/ttyUSB250")
    config.write_text(text.replace("transport =", "rs485 = {}\ntransport =", 1))
    result = invoke("check", config)
    assert "rtu /dev/ttyUSB250, 9600 Bd 8N1, direction by RTS, timeout 500ms" in result.stdout
    assert "connections.bus.port: /dev/ttyUSB250 may be another adapter" in result.stderr


def test_check_shows_connections_over_a_network(config: Path) -> None:
    config.write_text(
        "[connections.bus]\ntransport = 'rtu-over-tcp'\nhost = 'moxa'\nport = 4001\n"
        "[connections.plant]\ntransport = 'udp'\nhost = '::1'\n"
        + ROC
        + ROC.replace("roc1", "roc2").replace("bus", "plant")
    )
    result = invoke("check", config)
    assert (result.exit_code, result.stderr) == (0, "")
    assert (
        "connection  bus: rtu-over-tcp moxa:4001, 9600 Bd, timeout 500ms, late answer 1s, "
        "silence 5.21ms\n"
    ) in result.stdout
    assert "connection  plant: udp [::1]:502, timeout 1s\n" in result.stdout
    assert "bus load    bus: 8.5%\n" in result.stdout
    told = json.loads(invoke("check", config, "--json").stdout)["connections"]
    assert [each["transport"] for each in told] == ["rtu-over-tcp", "udp"]
    assert [each["late_answer_ns"] for each in told] == [10**9, None]


def test_check_tells_all_problems(config: Path) -> None:
    config.write_text(RTU + "baudrate = 0\n" + ROC + "pol = '1s'")
    result = invoke("check", config)
    assert result.exit_code == 3
    assert not result.stdout
    assert result.stderr.splitlines() == [
        f"roclog: {config}: connections.bus.baudrate: 0 is not a whole number from 1 to 4000000",
        f'roclog: {config}: devices.roc1.pol: unknown key, did you mean "poll"?',
    ]


def test_check_problems_as_json(config: Path) -> None:
    config.write_text(RTU + ROC + "pol = '1s'")
    result = invoke("check", config, "--json")
    assert result.exit_code == 3
    text = 'unknown key, did you mean "poll"?'
    assert json.loads(result.stdout) == {
        "schema": "roclog.check/1",
        "problems": [{"key": "devices.roc1.pol", "text": text}],
    }


def test_check_as_json(config: Path) -> None:
    config.chmod(0o666)
    result = invoke("check", config, "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["problems"] == []
    assert found["recording"]["directory"] == f"{config.parent}/recordings"
    assert found["recording"]["free_bytes"] > 0
    assert found["devices"][0]["poll_ns"] == 10**9
    assert found["bus_loads"][0]["expected"] == bus_loads(load(config))[0].expected
    assert [w["text"] for w in found["warnings"]] == [
        "its group and others may write to this file: chmod go-w"
    ]
    assert found["probe"] is None


def test_check_warnings_go_to_stderr(config: Path) -> None:
    config.write_text(RTU + ROC + "poll = '20s'\ncycle = '10s'")
    result = invoke("check", config)
    assert result.exit_code == 0
    assert result.stderr == (
        "roclog: warning: roclog.toml: devices.roc1.poll: 20s is longer than the cycle of the "
        "device, 10s: about 50% of the samples will be lost\n"
    )


def test_check_refuses_an_impossible_bus(config: Path) -> None:
    config.write_text(RTU + ROC + "poll = '74ms'")
    result = invoke("check", config)
    assert result.exit_code == 3
    assert (
        "connections.bus: polls need 101% of the time for octets and silence alone: roc1: request"
    ) in result.stderr


def test_check_warns_of_a_busy_bus(config: Path) -> None:
    config.write_text(RTU + ROC + "poll = '100ms'")
    result = invoke("check", config)
    assert result.exit_code == 0
    assert "polls need 85% of the time, so they will wait for each other" in result.stderr


def test_check_of_a_place_that_is_no_directory(config: Path) -> None:
    (config.parent / "recordings").touch()
    result = invoke("check", config)
    assert result.exit_code == 6
    assert result.stderr.endswith("recordings is not a directory\n")


def test_places(tmp_path: Path) -> None:
    assert look_at(tmp_path).exists
    missing = look_at(tmp_path / "a" / "b")
    assert not missing.exists
    assert not missing.problem
    assert missing.free > 0


def test_place_without_permission(unprivileged_path: Path) -> None:
    unprivileged_path.chmod(0o555)
    assert look_at(unprivileged_path).problem == "cannot be written to"
    assert "is not writable" in look_at(unprivileged_path / "a").problem
    unprivileged_path.chmod(0o755)


def test_check_warns_of_little_space(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type("Usage", (), {"free": 1 << 20})
    monkeypatch.setattr("roclog.cli.check.shutil.disk_usage", lambda _: usage)
    expected = "recording.directory: 1 MiB are free, less than 128 MiB (two segments)"
    assert expected in invoke("check", config).stderr


def test_check_probe_where_nothing_answers(config: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, not listening: refuses
        port = taken.getsockname()[1]
        config.write_text(
            f"[connections.bus]\ntransport = 'tcp'\nhost = '127.0.0.1'\nport = {port}\n{ROC}"
        )
        result = invoke("check", config, "--probe")
    assert result.exit_code == 4
    assert result.stderr == "roclog: no device answered\n"
    assert re.search("^silent      roc1: ", result.stdout, re.MULTILINE)


# profiles


def test_profiles_lists_all() -> None:
    lines = invoke("profiles").stdout.splitlines()
    assert [line.split()[0] for line in lines[1:]] == [*PROFILES, *CONFIGURED]
    assert [line.split()[0] for line in lines if "(assumed)" in line] == list(CONFIGURED)


def test_profile_as_a_table() -> None:
    text = invoke("profiles", "hiac-roc").stdout
    assert "trigger     register 300 is 1 when there is a sample; 0 clears it\n" in text
    assert "payload     registers 305, 308-325: a change is another sample\n" in text
    assert "silence     5 characters before a request\n" in text
    assert "source      MODBUS Serial Communications Protocol, first draft, 2012-03-27\n" in text
    row = next(line for line in text.splitlines() if "temperature  " in line)
    assert row.split() == ["326", "1", "temperature", "int16", "0.1", "Cel", "-30", "to", "99.9",
                           "Temperature"]  # fmt: skip
    assert "SAE class channel 1: -2 = 000, -1 = 00, 13 = > 12\n" in text
    assert re.search(r"^ +channel_4_alarm +bit 11$", text, re.MULTILINE)


def test_profile_names_every_point_and_address() -> None:
    profile = PROFILES["hiac-roc"]
    found = json.loads(invoke("profiles", "hiac-roc", "--json").stdout)["profiles"][0]
    for block, told in zip(profile.blocks, found["blocks"], strict=True):
        assert [(p["name"], p["address"]) for p in told["points"]] == [
            (p.name, block.address + p.offset) for p in block.points
        ]
    assert found["blocks"][2]["trigger"] == {"address": 300, "new": 1, "clear": 0}


def test_profile_says_all_that_makes_a_value() -> None:
    text = invoke("profiles", "mpa-48").stdout
    assert re.search(r" orp +uint16 +1 - 2000 +mV .*; only where status is 0$", text, re.MULTILINE)
    point = Point(
        name="level",
        offset=3,
        type=WordType.U32,
        word_order=WordOrder.CDAB,
        parts=((4, 3, "mode"),),
        sentinels=((Decimal(-1), "no sensor"),),
    )
    block = Block(name="b", table=Table.INPUT_REGISTERS, address=100, count=9, points=(point,))
    assert list(_rows(block, point, is_function=False)) == [
        ("103", "2", "level", "uint32 CDAB", "", "", "", "no measurement: -1 = no sensor"),
        ("", "", "mode", "bits 4-6", "", "", "", ""),
    ]


def test_profile_that_is_not_there() -> None:
    result = invoke("profiles", "hiac_roc")
    assert result.exit_code == 2
    assert "no profile 'hiac_roc', did you mean 'hiac-roc'?" in result.stderr
    result = invoke("profiles", "registers")
    assert result.exit_code == 2
    assert "registers has no map to show: its map stands in a config" in result.stderr


def test_profile_on_a_terminal() -> None:
    """Rich output, wrapped to the width of the terminal, nothing lost."""
    controller, terminal = pty.openpty()
    environment = os.environ | {"COLUMNS": "100", "TERM": "xterm", "NO_COLOR": "1"}
    command = [*ROCLOG, "profiles", "hiac-roc"]
    with subprocess.Popen(command, stdout=terminal, env=environment) as process:
        os.close(terminal)
        octets = b""
        while chunk := _read_or_nothing(controller):
            octets += chunk
    os.close(controller)
    assert process.returncode == 0
    text = re.sub(r"\x1b\[[0-9;]*m", "", octets.decode())
    assert max(map(len, text.splitlines())) <= 100
    for block in PROFILES["hiac-roc"].blocks:
        for point in block.points:
            assert f" {point.name} " in text


def _read_or_nothing(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 65536)
    except OSError:  # the other end is closed
        return b""


# simulate


ONE_ENDPOINT = "one of --tcp, --udp, --rtu-over-tcp and --pty is needed"
WRONG_SIMULATIONS = [
    (["hiac-roc"], ONE_ENDPOINT),
    (["hiac-roc", "--tcp", "127.0.0.1:0", "--pty", "x"], ONE_ENDPOINT),
    (["hiac-roc", "--udp", "127.0.0.1:0", "--rtu-over-tcp", "127.0.0.1:0"], ONE_ENDPOINT),
    (["hiac-roc", "--udp", "5020"], "'5020' is not HOST:PORT"),
    (["hiac-roc", "--udp", "127.0.0.1:0", "--baud", "9600"], "are for --pty only"),
    (["weather", "--tcp", "127.0.0.1:0"], "'weather' is not one of hiac-roc"),
    (["hiac-roc:0", "--tcp", "127.0.0.1:0"], "0 is not a unit from 1 to 247"),
    (["hiac-roc:248", "--tcp", "127.0.0.1:0"], "248 is not a unit from 1 to 247"),
    (["hiac-roc:x", "--tcp", "127.0.0.1:0"], "'x' is not a unit from 1 to 247"),
    (["hiac-roc", "hiac-roc", "--tcp", "127.0.0.1:0"], "unit 138 twice"),
    (["hiac-roc", "--tcp", "5020"], "'5020' is not HOST:PORT"),
    (["hiac-roc", "--tcp", "127.0.0.1:65536"], "'127.0.0.1:65536' is not HOST:PORT"),
    (["hiac-roc", "--tcp", "127.0.0.1:0", "--speed", "0"], "0.0 is not a positive number"),
    (["hiac-roc", "--tcp", "127.0.0.1:0", "--speed", "inf"], "inf is not a positive number"),
    (["--tcp", "127.0.0.1:0"], "Missing argument"),
    (["msx-e3317", "--pty", "x"], "msx-e3317 is served with --tcp or --udp"),
    (["msx-e3317", "--rtu-over-tcp", "127.0.0.1:0"], "msx-e3317 is served with --tcp or --udp"),
    (["msx-e3317:2", "--tcp", "127.0.0.1:0"], "2 is not a unit of msx-e3317, 0 or 1"),
    (["hiac-roc", "--tcp", "127.0.0.1:0", "--byte-order", "big"], "is for msx-e3317 only"),
    (["hiac-roc", "--tcp", "127.0.0.1:0", "--sensor", "channel_1=model-10"], "for mpa-48 only"),
    (["mpa-48", "--tcp", "127.0.0.1:0", "--sensor", "model-10"], "is not CHANNEL=MODEL[@REGISTER]"),
    (
        ["mpa-48", "--tcp", "127.0.0.1:0", "--sensor", "channel_1=model-9"],
        "'model-9' is not one of",
    ),
    (["mpa-48", "--tcp", "127.0.0.1:0", "--sensor", "channel_3=model-10"], "address of channel_3"),
    (["mpa-48", "--tcp", "127.0.0.1:0", *2 * ["--sensor", "channel_1=model-10"]], "twice"),
    (["mpa-48:248", "--tcp", "127.0.0.1:0"], "248 is not a unit from 1 to 247"),
]


@pytest.mark.parametrize(("arguments", "text"), WRONG_SIMULATIONS)
def test_wrong_simulation(arguments: list[str], text: str) -> None:
    result = invoke("simulate", *arguments)
    assert result.exit_code == 2
    assert text in " ".join(result.stderr.split())


def test_simulate_where_the_port_is_taken() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        result = run("simulate", "hiac-roc", "--tcp", place)
    assert result.returncode == 2
    assert f"Invalid value for --tcp: {place}: cannot listen" in result.stderr


def test_simulate_where_the_link_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "line").touch()
    result = run("simulate", "hiac-roc", "--pty", tmp_path / "line")
    assert result.returncode == 2
    assert "Invalid value for --pty: " in result.stderr


class Simulation:
    """``roclog simulate`` in a process of its own, once it has said that it serves."""

    def __init__(self, *arguments: str | Path) -> None:
        command = [*ROCLOG, "simulate", *(str(each) for each in arguments)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        ready, _, _ = select.select([self.process.stderr], [], [], 20)
        assert ready, "says nothing"
        self.line = self.process.stderr.readline()

    def stop(self, number: int) -> tuple[int, str]:
        """Exit code and the rest of stderr."""
        self.process.send_signal(number)
        _, rest = self.process.communicate(timeout=20)
        return self.process.returncode, rest


def test_a_refusal_is_not_silence(config: Path) -> None:
    simulation = Simulation("hiac-roc", "--tcp", "127.0.0.1:0")
    port = simulation.line.partition("127.0.0.1:")[2].split()[0]
    config.write_text(
        f"[connections.bus]\ntransport = 'tcp'\nhost = '127.0.0.1'\nport = {port}\n"
        "[devices.meter]\nprofile = 'registers'\nconnection = 'bus'\nunit = 138\n"
        "[[devices.meter.blocks]]\nname = 'oil'\ntable = 'holding_registers'\naddress = 40317\n"
        "points = [{ name = 'iso', offset = 0, type = 'float32' }]\n"
    )
    result = invoke("check", config, "--probe")
    as_json = invoke("check", config, "--probe", "--json")
    assert simulation.stop(signal.SIGTERM) == (0, "")
    assert result.exit_code == 4
    assert result.stderr == (
        f"roclog: warning: {config.name}: devices.meter.blocks: oil: address 40317 is asked for as "
        "it is; a manual that counts holding registers from 40001 means address 316\n"
        "roclog: no device gave its data\n"
    )
    place = "holding registers 40317 to 40318 (oil)"
    problem = "exception 2 (illegal data address) to function 3"
    assert result.stdout.endswith(
        f"refuses     meter: 0 of 1 blocks read\n              refuses: {place}: {problem}\n"
    )
    assert json.loads(as_json.stdout)["probe"] == [
        {
            "device": "meter",
            "state": "refuses",
            "ok": False,
            "refused": True,
            "text": "0 of 1 blocks read",
            "blocks": [{"place": place, "state": "refuses", "problem": problem}],
            "not_asked": [],
        }
    ]


def test_a_float32_is_read_with_its_own_digits(capsys: pytest.CaptureFixture[str]) -> None:
    points = (
        Point(name="voltage", offset=0, type=WordType.F32, unit="V"),
        Point(name="scaled", offset=2, type=WordType.F32, scale=Decimal("0.1")),
        Point(name="none", offset=4, type=WordType.F32),
    )
    block = Block(name="b", table=Table.INPUT_REGISTERS, address=7, count=6, points=points)
    words = (0x4368, 0x9836, 0x4316, 0x0000, 0x7FC0, 0x0000)
    _print_block(BlockRead(block, words, decode(block, words)), WordOrder.ABCD, is_function=False)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["7", "4368", "9836", "voltage", "232.59457", "V"] in lines
    assert ["9", "4316", "0000", "scaled", "15.0"] in lines
    assert ["11", "7FC0", "0000", "none", "nan"] in lines


def test_what_is_read_is_judged_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    bits = {"bits": ((0, "running"),), "parts": ((8, 4, "mode"),)}
    ranged = {"low": Decimal(0), "high": Decimal(5), "unit": "bar"}
    points = (
        Point(name="state", offset=0, type=WordType.U16, **bits),  # type: ignore[arg-type]
        Point(name="flow", offset=1, type=WordType.F32),
        Point(name="pressure", offset=3, type=WordType.U16, **ranged),  # type: ignore[arg-type]
    )
    time = UnixSeconds(offset=4)
    block = Block(
        name="b", table=Table.INPUT_REGISTERS, address=7, count=6, points=points, time=time
    )
    words = (0x0301, 0x7F80, 0x0000, 6, 0, 0)
    _print_block(BlockRead(block, words, decode(block, words)), WordOrder.ABCD, is_function=False)
    text = " ".join(capsys.readouterr().out.split())  # however wide the terminal is
    assert "7 0301 state 769 running, mode 3" in text
    assert "8 7F80 0000 flow inf not plausible as float32." in text
    assert "10 0006 pressure 6 bar outside the documented range 0 to 5." in text
    assert text.endswith("device time unknown, no_time")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_simulate_tcp_and_probe_it(number: int, config: Path) -> None:
    simulation = Simulation("hiac-roc", "hiac-roc:139", "--tcp", "127.0.0.1:0", "--speed", "20")
    match = re.fullmatch(
        "serving hiac-roc unit 138, hiac-roc unit 139 on 127.0.0.1:([0-9]+) at speed 20, "
        "Ctrl-C ends\n",
        simulation.line,
    )
    assert match, simulation.line
    config.write_text(
        f"[connections.bus]\ntransport = 'tcp'\nhost = '127.0.0.1'\nport = {match[1]}\n{ROC}"
        + ROC.replace("roc1", "gone")
        + "unit = 7\n"
    )
    result = invoke("check", config, "--probe", "--json")
    assert simulation.stop(number) == (0, "")
    assert result.exit_code == 5
    assert result.stderr.endswith("roclog: no data of gone\n")
    probes = json.loads(result.stdout)["probe"]
    assert [(probe["device"], probe["ok"]) for probe in probes] == [("roc1", True), ("gone", False)]


@pytest.mark.parametrize("transport", ["udp", "rtu-over-tcp"])
def test_simulate_on_another_transport_and_probe_it(transport: str, config: Path) -> None:
    simulation = Simulation("hiac-roc", f"--{transport}", "127.0.0.1:0")
    match = re.search("unit 138 on 127.0.0.1:([0-9]+) at speed 1, Ctrl-C ends", simulation.line)
    assert match, simulation.line
    config.write_text(
        f"[connections.bus]\ntransport = '{transport}'\nhost = '127.0.0.1'\nport = {match[1]}\n"
        f"{ROC}"
    )
    result = invoke("check", config, "--probe")
    taken = run("simulate", "hiac-roc", f"--{transport}", f"127.0.0.1:{match[1]}")
    assert simulation.stop(signal.SIGTERM) == (0, "")
    assert (result.exit_code, taken.returncode) == (0, 2)
    assert re.search("^answers     roc1: ", result.stdout, re.MULTILINE)
    assert f"Invalid value for --{transport}: 127.0.0.1:{match[1]}: cannot" in taken.stderr


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_simulate_a_module_in_its_byte_order(transport: str, order: str, config: Path) -> None:
    simulation = Simulation("msx-e3317", f"--{transport}", "127.0.0.1:0", "--byte-order", order)
    match = re.search("unit 1 on 127.0.0.1:([0-9]+) at speed 1, Ctrl-C ends", simulation.line)
    assert match, simulation.line
    config.write_text(
        f"[connections.lab]\ntransport = '{transport}'\nhost = '127.0.0.1'\nport = {match[1]}\n"
        f"[devices.msx1]\nprofile = 'msx-e3317'\nconnection = 'lab'\nbyte_order = '{order}'\n"
    )
    result = invoke("read", config, "msx1", "--json")
    assert simulation.stop(signal.SIGTERM) == (0, "")
    assert result.exit_code == 0
    blocks = json.loads(result.stdout)["blocks"]
    assert blocks["module_type"]["values"] == {"module_type": "MSX-E3317"}
    assert blocks["pressure_channels"]["values"] == {"channels": 8}
    assert abs(blocks["clock"]["values"]["seconds"] - time.time()) < 10


def test_profile_of_a_module() -> None:
    text = invoke("profiles", "msx-e3317").stdout
    assert "delivered   unit 1, TCP and UDP only, port 512\n" in text
    assert "block       clock: function 10500, 8 octets, called at every poll\n" in text
    assert "time        SecondsMicroseconds in octets from 0, 4 on\n" in text
    assert not re.search("^ *10502 ", text, re.MULTILINE)  # would be another function
    assert re.search("^ +4 +2 +microseconds +uint32 ", text, re.MULTILINE)
    assert "channels_info: function 15050, 192 octets, called every 1min\n" in text
    assert "silence" not in text
    (found,) = json.loads(invoke("profiles", "msx-e3317", "--json").stdout)["profiles"]
    assert (found["port"], found["serial"]) == (512, None)


ANALYSER = """
[devices.basin]
profile = "mpa-48"
connection = "plant"
unit = 3
sensors = { channel_1 = "model-52", channel_2 = "model-10", channel_3 = "model-15" }
addresses = { channel_3 = 40 }
"""
SENSORS = ("channel_1=model-52", "channel_2=model-10", "channel_3=model-15@40")


@pytest.mark.parametrize("transport", ["tcp", "udp", "rtu-over-tcp", "pty"])
def test_simulate_an_analyser_and_read_it(transport: str, tmp_path: Path, config: Path) -> None:
    """The truth of the simulator, line by line, is what `read` says."""
    place, truth = "127.0.0.1:0", tmp_path / "truth.csv"
    if transport == "pty":
        place = str(tmp_path / "line")
    sensors = [word for sensor in SENSORS for word in ("--sensor", sensor)]
    simulation = Simulation("mpa-48:3", f"--{transport}", place, "--truth", truth, *sensors)
    match = re.search("serving mpa-48 unit 3 on (.+) at speed 1, Ctrl-C ends", simulation.line)
    assert match, simulation.line
    port = match[1].rpartition(":")[2]
    where = f'host = "127.0.0.1"\nport = {port}' if transport != "pty" else f'port = "{place}"'
    name = "rtu" if transport == "pty" else transport
    config.write_text(f'[connections.plant]\ntransport = "{name}"\n{where}\n{ANALYSER}')
    result = invoke("read", config, "basin", "--json")
    probed = invoke("check", config, "--probe")
    assert simulation.stop(signal.SIGTERM) == (0, "")
    assert result.exit_code == probed.exit_code == 0
    assert re.search("^answers     basin: 4 of 4 blocks read$", probed.stdout, re.MULTILINE)
    told: dict[str, dict[str, str]] = {}
    for row in csv.DictReader(truth.read_text().splitlines()):
        if int(row["answer"]) <= 4:
            told.setdefault(row["block"], {})[row["name"]] = row["value"]
    blocks = json.loads(result.stdout)["blocks"]
    assert list(blocks) == list(told) == ["relays", "channel_1", "channel_2", "channel_3"]
    for name, values in told.items():
        found = blocks[name]["values"]
        assert list(found) == list(values)
        for point, text in values.items():
            assert found[point] == (float(text) if text else None)


def test_a_part_is_not_everything(config: Path) -> None:
    """An analyser without the third channel: a script has to see it, and people what it is."""
    simulation = Simulation("mpa-48:3", "--tcp", "127.0.0.1:0")
    port = simulation.line.partition("127.0.0.1:")[2].split()[0]
    config.write_text(
        f"[connections.plant]\ntransport = 'tcp'\nhost = '127.0.0.1'\nport = {port}\n{ANALYSER}"
    )
    result = invoke("check", config, "--probe")
    found = json.loads(invoke("check", config, "--probe", "--json").stdout)
    assert simulation.stop(signal.SIGTERM) == (0, "")
    assert (result.exit_code, result.stderr) == (5, "roclog: basin: only a part could be read\n")
    problem = "exception 2 (illegal data address) to function 4"
    assert result.stdout.endswith(
        "partly      basin: 3 of 4 blocks read\n"
        f"              refuses: input registers 40 to 42 (channel_3): {problem}\n"
    )
    (probe,) = found["probe"]
    assert (probe["ok"], probe["state"]) == (False, "partly")
    states = ["answers", "answers", "answers", "refuses"]
    assert [block["state"] for block in probe["blocks"]] == states


def test_check_shows_what_is_read_where(config: Path) -> None:
    config.write_text(f"[connections.plant]\ntransport = 'tcp'\nhost = 'plant'\n{ANALYSER}")
    lines = [line.strip() for line in invoke("check", config).stdout.splitlines()]
    assert lines[5:9] == [
        "reads coils 0 to 7 (relays), every 1s: Relay states, coils 0-7",
        (
            "reads input registers 0 to 2 (channel_1), every 1s: Channel 1: model-52, "
            "oxidation-reduction potential"
        ),
        (
            "reads input registers 3 to 5 (channel_2), every 1s: Channel 2: model-10, "
            "optical dissolved oxygen"
        ),
        (
            "reads input registers 40 to 42 (channel_3), every 1s: Channel 3: model-15, "
            "suspended solids"
        ),
    ]
    (device,) = json.loads(invoke("check", config, "--json").stdout)["devices"]
    assert [block["address"] for block in device["blocks"]] == [0, 0, 3, 40]


def test_profile_of_an_analyser() -> None:
    """Nothing that no document says is shown as documented."""
    text = invoke("profiles", "mpa-48").stdout
    assert "assumed     unit 1, 9600 Bd 8N1, not documented\n" in text
    assert not re.search("^delivered", text, re.MULTILINE)
    assert "block       relays: 8 coils 0-7, read at every poll\n" in text
    assert text.count("block       channel_1: 3 input registers 0-2, read at every poll\n") == 4
    assert "note        on channel_2 each model is at registers 3-5\n" in text
    assert "note        where other channels are is not documented and must be given: " in text
    for model in ("model-10", "model-15", "model-51", "model-52"):
        assert f"\nChannel 1: {model}, " in text
    assert "3 = needs zero calibration\n" in text
    (found,) = json.loads(invoke("profiles", "mpa-48", "--json").stdout)["profiles"]
    assert found["documented"] is False
    assert [block["message"] for block in found["blocks"]] == [
        "relays",
        *(f"channel_model_{number}" for number in (10, 15, 51, 52)),
    ]
    (orp,) = (point for point in found["blocks"][4]["points"] if point["name"] == "orp")
    assert (orp["address"], orp["add"]) == (1, -2000)


def test_profile_of_inputs_that_the_configuration_lists() -> None:
    text = invoke("profiles", "mei-timestamped").stdout
    assert "assumed     unit 1, 9600 Bd 8N1, not documented\n" in text
    assert "block  " not in text
    assert "\nnote        the configuration says which inputs there are: points = " in text


def test_simulate_on_a_serial_line(tmp_path: Path, config: Path) -> None:
    simulation = Simulation("hiac-roc", "--pty", tmp_path / "line")
    config.write_text(RTU.replace("/dev/ttyS9", "line") + ROC)
    result = invoke("check", config, "--probe")
    assert simulation.line.endswith(f"on {tmp_path}/line at speed 1, Ctrl-C ends\n")
    assert simulation.stop(signal.SIGINT) == (0, "")
    assert result.exit_code == 0
    assert re.search("^answers     roc1: ", result.stdout, re.MULTILINE)
    assert not (tmp_path / "line").is_symlink()


def test_simulate_writes_the_truth(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    devices = ["hiac-roc:1", "hiac-roc:2"]
    simulation = Simulation(
        *devices, "--tcp", "127.0.0.1:0", "--speed", "100", "--seed", "5", "--truth", truth
    )
    files = [tmp_path / "truth-1.csv", tmp_path / "truth-2.csv"]
    limit = time.monotonic() + 20
    while not all(len(file.read_text().splitlines()) > 2 for file in files):
        assert time.monotonic() < limit
        time.sleep(0.05)
    assert simulation.stop(signal.SIGTERM) == (0, "")
    assert not truth.exists()


STAMPED = """
[devices.rtu7]
profile = "mei-timestamped"
connection = "bus"
points = [
  { kind = "discrete_inputs", stamp = 7, address = 196, count = 22 },
  { kind = "input_registers", stamp = 4, address = 8, count = 2 },
]
"""


def test_stamped_inputs_are_probed_and_read(tmp_path: Path, config: Path) -> None:
    simulation = Simulation("mei-timestamped", "--pty", tmp_path / "line")
    config.write_text(RTU.replace("/dev/ttyS9", "line") + STAMPED)
    probed = invoke("check", config, "--probe")
    shown = invoke("read", config, "rtu7")
    data = json.loads(invoke("read", config, "rtu7", "--json").stdout)
    assert simulation.stop(signal.SIGINT) == (0, "")
    assert probed.exit_code == 0
    # Two requests of 9 characters, answers of 3 + 5 + 3 + 22 * 7 and 3 + 3 + 2 * 6; 10 bits each.
    assert "request 18.75ms" in probed.stdout
    assert "answer 190.63ms" in probed.stdout
    assert shown.exit_code == 0
    assert "Discrete inputs 196 to 217" in shown.stdout
    assert [len(read["inputs"]) for read in data["stamped"]] == [22, 2]
    assert all(point["device_time"] for read in data["stamped"] for point in read["inputs"])

"""Warnings about valid configurations, and the load of serial lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from roclog.config import bus_loads, warnings

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from roclog.config import Settings

    Load = Callable[[str], Settings]

RTU = '[connections.bus]\ntransport = "rtu"\nport = "/dev/ttyS9"\n'
TCP = '[connections.bus]\ntransport = "tcp"\nhost = "10.0.0.1"\n'
GATEWAY = '[connections.bus]\ntransport = "rtu-over-tcp"\nhost = "10.0.0.2"\nport = 4001\n'
ROC = '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "bus"\n'

CASES = {
    "connections.spare: no device uses this connection": TCP.replace("bus", "spare") + RTU + ROC,
    "connections.bus.baudrate: 19200, but hiac-roc (roc1) has 9600": (
        f"{RTU}baudrate = 19200\n{ROC}"
    ),
    "connections.bus.baudrate: 4800, but hiac-roc (roc1) has 9600": (
        f"{GATEWAY}baudrate = 4800\n{ROC}"
    ),
    'connections.bus.parity: "E", but hiac-roc (roc1) has "N"': f"{RTU}parity = 'E'\n{ROC}",
    "connections.bus.stopbits: 2, but hiac-roc (roc1) has 1": f"{RTU}stopbits = 2\n{ROC}",
    "connections.bus.silence: 4ms, but hiac-roc (roc1) asks 5208.335us": (
        f"{RTU}silence = '4ms'\n{ROC}"
    ),
    "connections.bus.timeout: 60ms, but the longest answer and a typical turnaround take "
    "115208.367us at 9600 baud": f"{RTU}timeout = '60ms'\n{ROC}",
    "connections.bus.port: /dev/ttyUSB250 may be another adapter when it is plugged in again; "
    "use a link below /dev/serial/by-id": RTU.replace("/dev/ttyS9", "/dev/ttyUSB250") + ROC,
    "connections.bus.port: /dev/ttyACM250 may be another adapter when it is plugged in again; "
    "use a link below /dev/serial/by-id": RTU.replace("/dev/ttyS9", "/dev/ttyACM250") + ROC,
    "devices.roc1.poll: 30s is longer than the cycle of the device, 15s: "
    "about 50% of the samples will be lost": f"{RTU}{ROC}poll = '30s'\ncycle = '15s'",
    "devices.roc1.poll: 8s is longer than the shortest cycle that hiac-roc can have, 7s: "
    "where the device is set so, samples will be lost": f"{RTU}{ROC}poll = '8s'",
}


@pytest.mark.parametrize(("line", "text"), CASES.items(), ids=[line[:50] for line in CASES])
def test_warning(text: str, line: str, load_text: Load) -> None:
    assert [str(problem) for problem in warnings(load_text(text))] == [line]


@pytest.mark.parametrize(
    "text",
    [
        RTU + ROC,
        TCP + ROC,
        GATEWAY + ROC,
        RTU + ROC + "poll = '7s'",
        RTU + ROC + "poll='15s'\ncycle='15s'",
    ],
)
def test_nothing_to_warn_about(text: str, load_text: Load) -> None:
    assert warnings(load_text(text)) == []


def test_the_better_name_of_a_port_is_told(
    tmp_path: Path, load_text: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("roclog.config.advice._BY_ID", tmp_path)
    (tmp_path / "usb-A-if00-port0").symlink_to("/dev/ttyUSB251")
    (tmp_path / "usb-B-if00-port0").symlink_to("/dev/ttyUSB250")
    (problem,) = warnings(load_text(RTU.replace("/dev/ttyS9", "/dev/ttyUSB250") + ROC))
    assert str(problem).endswith(f"; use {tmp_path}/usb-B-if00-port0")
    better = str(tmp_path / "usb-B-if00-port0")
    assert warnings(load_text(RTU.replace("/dev/ttyS9", better) + ROC)) == []


@pytest.mark.parametrize(
    ("mode", "who"),
    [(0o664, "its group"), (0o646, "others"), (0o666, "its group and others")],
)
def test_file_that_others_may_write(mode: int, who: str, load_text: Load) -> None:
    settings = load_text(RTU + ROC)
    settings.path.chmod(mode)
    (problem,) = warnings(settings)
    assert str(problem) == f"{who} may write to this file: chmod go-w"


def test_file_that_is_gone(load_text: Load) -> None:
    settings = load_text(RTU + ROC)
    settings.path.unlink()
    assert warnings(settings) == []


def test_bus_load(load_text: Load) -> None:
    """27 registers at 9600 Bd: 8 + 59 characters, 10 ms, and here 3.5 characters: 83.44 ms."""
    (load,) = bus_loads(load_text(RTU + "silence = '3.5 chars'\n" + ROC))
    assert load.connection == "bus"
    assert load.expected == pytest.approx(0.08344, abs=1e-5)
    assert load.least == pytest.approx(0.07344, abs=1e-5)


def test_bus_load_behind_a_gateway(load_text: Load) -> None:
    """As on the line itself, from the baud rate that the configuration tells."""
    (serial,) = bus_loads(load_text(RTU + ROC))
    (load,) = bus_loads(load_text(GATEWAY + ROC))
    assert load == serial
    (faster,) = bus_loads(load_text(GATEWAY + "baudrate = 19200\n" + ROC))
    assert faster.least < load.least


def test_bus_load_adds_up(load_text: Load) -> None:
    text = RTU + "silence = '3.5 chars'\n"
    for unit in range(1, 4):
        text += ROC.replace("roc1", f"roc{unit}") + f"unit = {unit}\npoll = '500ms'\n"
    (load,) = bus_loads(load_text(text))
    assert load.expected == pytest.approx(6 * 0.08344, abs=1e-4)


def test_what_needs_several_requests_and_flags_in_coils_are_counted(load_text: Load) -> None:
    """Facts of 200 registers, 4000 coils, and a coil that says that there is something to read."""
    large = "count = 200\natomic = false\npoints = [{ name = 'a', offset = 0, type = 'uint16' }]\n"
    device = "[devices.tank]\nprofile = 'registers'\nconnection = 'bus'\nunit = 9\n"
    block = "[[devices.tank.blocks]]\ntable = '{}'\naddress = 0\nname = '{}'\n"
    facts = block.format("holding_registers", "facts") + "read = 'once'\n" + large
    coils = block.format("coils", "coils") + large.replace("200", "4000").replace("uint16", "bit")
    gated = block.format("input_registers", "gated") + (
        "trigger = { clear_on_read = { table = 'coils', address = 5000 } }\n"
        "points = [{ name = 'a', offset = 0, type = 'uint16' }]\n"
    )
    slow = f"{RTU}timeout = '60ms'\n{device}{coils}{facts}{gated}"
    settings = load_text(slow)
    (load,) = bus_loads(settings)
    assert load.shares[0].turnaround == 40_000_000  # two for the coils, the flag, its block
    longest = next(str(problem) for problem in warnings(settings) if "longest" in str(problem))
    assert "275625.085us" in longest  # 255 characters and 10 ms, of 125 registers


def test_no_bus_load_on_a_network(load_text: Load) -> None:
    assert bus_loads(load_text(TCP + ROC)) == []
    assert bus_loads(load_text(TCP.replace("tcp", "udp") + ROC)) == []


@pytest.mark.parametrize(
    ("table", "address", "index"),
    [
        ("holding_registers", 40317, 316),
        ("input_registers", 30001, 0),
        ("discrete_inputs", 10197, 196),
    ],
)
def test_an_address_that_looks_like_a_label(
    load_text: Callable[[str], Settings], table: str, address: int, index: int
) -> None:
    kind = "bit" if table == "discrete_inputs" else "uint16"

    def told(where: str, at: int, type_: str) -> list[str]:
        text = (
            "[connections.net]\ntransport = 'tcp'\nhost = '10.0.0.1'\n[devices.tank]\n"
            "profile = 'registers'\nconnection = 'net'\nunit = 9\n[[devices.tank.blocks]]\n"
            f"name = 'level'\ntable = '{where}'\naddress = {at}\n"
            f"points = [{{ name = 'p', offset = 0, type = '{type_}' }}]\n"
        )
        return [str(problem) for problem in warnings(load_text(text))]

    assert told(table, address, kind) == [
        (
            f"devices.tank.blocks: level: address {address} is asked for as it is; "
            f"a manual that counts {table.replace('_', ' ')} from {address - index} "
            f"means address {index}"
        )
    ]
    assert told(table, index, kind) == []
    assert told("coils", address, "bit") == []

"""What a valid configuration becomes, with its defaults."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roclog.config import Connection, RecordingSettings, load
from roclog.config.settings import DirectionControl
from roclog.devices import PROFILES
from roclog.errors import ConfigError, RegisterMapError
from roclog.map_check import check_register_map
from roclog.register_map import SerialDefaults, WordOrder

if TYPE_CHECKING:
    from collections.abc import Callable

    from roclog.config import Settings

    Load = Callable[[str], Settings]

HOUR, DAY = 3600 * 10**9, 86_400 * 10**9
ROC = PROFILES["hiac-roc"]

RTU = '[connections.bus]\ntransport = "rtu"\nport = "/dev/ttyS9"\n'
GATEWAY = '[connections.bus]\ntransport = "rtu-over-tcp"\nhost = "10.0.0.2"\nport = 4001\n'
DEVICE = '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "bus"\n'


def test_defaults_of_a_serial_line(load_text: Load) -> None:
    settings = load_text(RTU + DEVICE)
    assert settings.connections["bus"] == Connection(
        name="bus",
        transport="rtu",
        port="/dev/ttyS9",
        host="",
        baudrate=9600,
        bytesize=8,
        parity="N",
        stopbits=1,
        timeout=500_000_000,
        late_answer=1_000_000_000,
        silence=5_208_335,  # 5 characters, as the ROC asks
        character=1_041_667,
        low_latency=True,
        rs485=None,
    )
    device = settings.devices["roc1"]
    assert (device.name, device.profile, device.connection) == ("roc1", ROC, "bus")
    assert (device.unit, device.poll, device.cycle) == (138, 10**9, None)
    assert device.word_order is WordOrder.ABCD
    assert device.acknowledge
    assert device.clears


def test_defaults_of_a_tcp_server(load_text: Load) -> None:
    settings = load_text('[connections.bus]\ntransport = "tcp"\nhost = "plc"\n' + DEVICE)
    assert settings.connections["bus"] == Connection(
        name="bus",
        transport="tcp",
        port=502,
        host="plc",
        baudrate=0,
        bytesize=0,
        parity="",
        stopbits=0,
        timeout=10**9,
        late_answer=None,
        silence=0,
        character=0,
    )


def test_defaults_of_a_udp_server(load_text: Load) -> None:
    tables = [
        load_text(f'[connections.bus]\ntransport = "{word}"\nhost = "plc"\n{DEVICE}').connections
        for word in ("tcp", "udp")
    ]
    tcp, udp = (connections["bus"] for connections in tables)
    assert udp == replace(tcp, transport="udp")
    assert not udp.is_serial


def test_defaults_of_a_gateway(load_text: Load) -> None:
    """Times as on the serial line itself, for the format that the devices have."""
    serial = load_text(RTU + DEVICE).connections["bus"]
    gateway = load_text(GATEWAY + DEVICE).connections["bus"]
    place = {"transport": "rtu-over-tcp", "host": "10.0.0.2", "port": 4001}
    unknown = {"bytesize": 0, "parity": "", "stopbits": 0, "low_latency": False}
    assert gateway == replace(serial, **place, **unknown)  # type: ignore[arg-type]
    assert (gateway.place, gateway.is_serial) == ("10.0.0.2:4001", True)


def test_everything_given_for_a_gateway(load_text: Load) -> None:
    text = "baudrate = 19200\ntimeout = '200ms'\nlate_answer = '300ms'\nsilence = '4 chars'\n"
    bus = load_text(GATEWAY + text + DEVICE + "unit = 247").connections["bus"]
    assert (bus.baudrate, bus.character, bus.silence) == (19200, 520_834, 2_083_336)
    assert (bus.timeout, bus.late_answer) == (200_000_000, 300_000_000)
    spare = GATEWAY.replace("bus", "spare").replace("4001", "4002")
    assert load_text(GATEWAY + spare + DEVICE).connections["spare"].baudrate == 9600


def test_a_tcp_and_a_udp_server_at_one_place(load_text: Load) -> None:
    text = "".join(
        f"[connections.{word}]\ntransport = '{word}'\nhost = 'a'\n" for word in ("tcp", "udp")
    )
    assert len(load_text(text + DEVICE.replace("bus", "udp")).connections) == 2


def test_defaults_of_the_recording(load_text: Load, tmp_path: Path) -> None:
    assert load_text(RTU + DEVICE).recording == RecordingSettings(
        directory=tmp_path / "recordings",
        segment_duration=HOUR,
        segment_size=64 << 20,
        keep_age=None,
        keep_size=None,
    )


def test_everything_given(load_text: Load, tmp_path: Path) -> None:
    settings = load_text("""
        [recording]
        directory = "a/b"
        segment = { duration = "10min", size = "1 MiB" }
        keep = { age = "90d", size = "20 GiB" }
        [connections.bus]
        transport = "rtu"
        port = "bus"
        baudrate = 19200
        bytesize = 8
        parity = "E"
        stopbits = 2
        timeout = "200ms"
        late_answer = "200ms"
        silence = "10ms"
        low_latency = false
        rs485.rts_on_send = false
        rs485.rts_after_send = true
        rs485.delay_before_send = "1ms"
        rs485.delay_after_send = "0.1s"
        [devices.roc1]
        profile = "hiac-roc"
        connection = "bus"
        unit = 1
        poll = "1.5s"
        word_order = "CDAB"
        acknowledge = false
        cycle = "15s"
    """)
    assert settings.path == tmp_path / "roclog.toml"
    assert settings.recording == RecordingSettings(
        directory=tmp_path / "a/b",
        segment_duration=600 * 10**9,
        segment_size=1 << 20,
        keep_age=90 * DAY,
        keep_size=20 << 30,
    )
    bus = settings.connections["bus"]
    assert bus.port == str(tmp_path / "bus")
    assert (bus.baudrate, bus.bytesize, bus.parity, bus.stopbits) == (19200, 8, "E", 2)
    assert bus.character == 625_000  # 12 bits
    assert (bus.timeout, bus.late_answer, bus.silence) == (200_000_000, 200_000_000, 10_000_000)
    assert not bus.low_latency
    assert bus.rs485 == DirectionControl(
        rts_on_send=False,
        rts_after_send=True,
        delay_before_send=1_000_000,
        delay_after_send=100_000_000,
    )
    device = settings.devices["roc1"]
    assert (device.unit, device.poll, device.cycle) == (1, 1_500_000_000, 15 * 10**9)
    assert device.word_order is WordOrder.CDAB
    assert not device.clears


@pytest.mark.parametrize("line", ["rs485 = {}", "rs485 = { delay_before_send = '0ms' }"])
def test_defaults_of_direction_control(line: str, load_text: Load) -> None:
    assert load_text(f"{RTU}{line}\n{DEVICE}").connections["bus"].rs485 == DirectionControl(
        rts_on_send=True, rts_after_send=False, delay_before_send=0, delay_after_send=0
    )


@pytest.mark.parametrize(
    ("line", "silence"),
    [
        ("baudrate = 9600\nsilence = '3.5 chars'", 3_645_835),
        ("baudrate = 9600\nsilence = '1 char'\nparity = 'N'", None),
        ("baudrate = 38400", 1_750_000),  # above 19200 a fixed time, here longer than 5 characters
        ("baudrate = 115200", 1_750_000),
        ("baudrate = 19200", 2_604_170),
        ("baudrate = 115200\nsilence = '4 chars'", 347_224),
    ],
)
def test_silence(line: str, silence: int | None, load_text: Load) -> None:
    text = RTU + line + "\n" + DEVICE
    if silence is None:
        with pytest.raises(ConfigError, match=r"less than 3\.5 characters"):
            load_text(text)
    else:
        assert load_text(text).connections["bus"].silence == silence


def test_a_connection_without_devices_has_defaults(load_text: Load) -> None:
    other = RTU.replace("bus", "spare").replace("S9", "S8")
    spare = load_text(RTU + other + DEVICE).connections["spare"]
    assert (spare.baudrate, spare.timeout, spare.silence) == (9600, 500_000_000, 3_645_835)


def test_order_of_the_file_is_kept(load_text: Load) -> None:
    devices = [DEVICE.replace("roc1", name) + f"unit = {n}\n" for n, name in enumerate("zab", 1)]
    assert list(load_text(RTU + "".join(devices)).devices) == ["z", "a", "b"]


@pytest.mark.parametrize("port", ["/dev/ttyS9", "/dev/serial/by-id/usb-FTDI:1-if00-port0"])
def test_absolute_ports_stay(port: str, load_text: Load) -> None:
    text = RTU.replace("/dev/ttyS9", port) + DEVICE
    assert load_text(text).connections["bus"].port == port


@pytest.mark.parametrize("host", ["localhost", "plc-1.plant.example", "192.168.1.40", "::1"])
def test_hosts(host: str, load_text: Load) -> None:
    settings = load_text(f"[connections.bus]\ntransport = 'tcp'\nhost = '{host}'\n" + DEVICE)
    place = settings.connections["bus"].place
    assert place == (f"[{host}]:502" if host == "::1" else f"{host}:502")


def test_one_server_with_two_ports(load_text: Load) -> None:
    text = "".join(
        f"[connections.c{port}]\ntransport = 'tcp'\nhost = 'a'\nport = {port}\n" for port in (1, 2)
    )
    assert len(load_text(text + DEVICE.replace("bus", "c1")).connections) == 2


@pytest.mark.parametrize("unit", [0, 248, 255])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_units_on_a_network(unit: int, transport: str, load_text: Load) -> None:
    server = f'[connections.bus]\ntransport = "{transport}"\nhost = "plc"\n'
    assert load_text(f"{server}{DEVICE}unit = {unit}").devices["roc1"].unit == unit


def test_same_unit_twice_where_only_one_acknowledges(load_text: Load) -> None:
    other = DEVICE.replace("roc1", "roc2") + "acknowledge = false\n"
    assert len(load_text(RTU + DEVICE + other).devices) == 2


def test_same_unit_on_two_connections(load_text: Load) -> None:
    other = RTU.replace("bus", "two").replace("S9", "S8")
    text = RTU + other + DEVICE + DEVICE.replace("roc1", "roc2").replace("bus", "two")
    assert len(load_text(text).devices) == 2


def test_devices_that_want_different_lines(
    load_text: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast = replace(
        ROC, name="fast", serial=SerialDefaults(baudrate=19200), answer_limit=800_000_000
    )
    maps = {"devices.roc1": ROC, "devices.roc2": fast}
    monkeypatch.setattr(
        "roclog.config.devices.register_map", lambda table, key, problems: maps[key]
    )
    other = DEVICE.replace("roc1", "roc2") + "unit = 2\n"
    missing = r"connections\.bus\.baudrate: missing, its devices are delivered with 9600 and 19200"
    with pytest.raises(ConfigError, match=missing):
        load_text(RTU + DEVICE + other)
    bus = load_text(RTU + "baudrate = 9600\n" + DEVICE + other).connections["bus"]
    assert (bus.timeout, bus.silence) == (800_000_000, 5_208_335)


def test_settings_cannot_be_changed(load_text: Load) -> None:
    settings = load_text(RTU + DEVICE)
    with pytest.raises(FrozenInstanceError):
        settings.devices["roc1"].unit = 5  # type: ignore[misc]
    with pytest.raises(TypeError):
        settings.devices["roc2"] = settings.devices["roc1"]  # type: ignore[index]


def test_relative_path_of_the_file(
    load_text: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_text(RTU + DEVICE)
    monkeypatch.chdir(tmp_path)
    settings = load(Path("roclog.toml"))
    assert settings.path == tmp_path / "roclog.toml"
    assert settings.recording.directory == tmp_path / "recordings"


def test_register_maps_beyond_the_last_register_are_refused() -> None:
    block = replace(ROC.samples[0], address=65_510)
    with pytest.raises(RegisterMapError, match="registers 65510 to 65536 do not exist"):
        check_register_map(replace(ROC, samples=(block,)))


def test_a_module_whose_frames_are_its_own(load_text: Load) -> None:
    table = '[connections.lab]\ntransport = "udp"\nhost = "plc"\n'
    table += '[devices.msx1]\nprofile = "msx-e3317"\nconnection = "lab"\n'
    for line, order, words in (
        ("", "big", WordOrder.ABCD),
        ('byte_order = "big"\n', "big", WordOrder.ABCD),
        ('byte_order = "little"\n', "little", WordOrder.DCBA),
    ):
        settings = load_text(table + line)
        lab, device = settings.connections["lab"], settings.devices["msx1"]
        assert (lab.port, lab.timeout, lab.dialect.order) == (512, 5 * 10**9, order)
        assert lab.dialect == device.profile.dialect
        assert (device.unit, device.word_order) == (1, words)
        assert not device.clears

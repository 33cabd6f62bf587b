"""Reads a configuration and judges its keys together."""

from __future__ import annotations

import os
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from msgspec import UNSET, UnsetType

from roclog.config import defaults
from roclog.config.devices import read_devices
from roclog.config.leaves import shown
from roclog.config.reading import (
    Problems,
    alternatives,
    joined,
    named_tables,
    read_table,
    read_toml,
    suggestion,
)
from roclog.config.settings import Connection, Settings
from roclog.config.tables import (
    Configuration,
    Line,
    Recording,
    Rtu,
    RtuOverTcp,
    Tcp,
    Udp,
)
from roclog.errors import ConfigError
from roclog.quantities import format_duration

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from roclog.config.settings import Device, RecordingSettings
    from roclog.register_map import RegisterMap

_TRANSPORTS: Final[dict[str, type[Line]]] = {
    "rtu": Rtu,
    "tcp": Tcp,
    "udp": Udp,
    "rtu-over-tcp": RtuOverTcp,
}
_SHORTEST_SEGMENT: Final = 10**9
_SMALLEST_SEGMENT: Final = 64 << 10


def load(path: Path) -> Settings:
    """Read and check a configuration.

    Raises:
        ConfigError: with every problem in the file, or the one that kept it from being read.
    """
    path = Path(path)
    file = read_toml(path)
    base = path.absolute().parent
    problems = Problems()
    problems.unknown_keys("", file, Configuration.__struct_fields__)
    table = read_table(Recording, file.get("recording", {}), "recording", problems)
    recording = defaults.recording_settings(table, base)
    _check_recording(recording, problems)
    lines = dict(_read_connections(file, problems))
    devices = read_devices(file, lines, problems)
    connections = _connections(lines, devices.values(), base, problems)
    if problems.found:
        raise ConfigError(path, problems.found)
    return Settings(
        path=base / path.name,
        recording=recording,
        connections=MappingProxyType(connections),
        devices=MappingProxyType(devices),
    )


def _check_recording(recording: RecordingSettings, problems: Problems) -> None:
    duration, size = recording.segment_duration, recording.segment_size
    if duration < _SHORTEST_SEGMENT:
        problems.add("recording.segment.duration", f"{format_duration(duration)} is less than 1s")
    if size < _SMALLEST_SEGMENT:
        problems.add("recording.segment.size", f"{size} octets is less than 64 KiB")
    if recording.keep_age is not None and recording.keep_age < duration:
        problems.add("recording.keep.age", "is less than the duration of one segment")
    if recording.keep_size is not None and recording.keep_size < size:
        problems.add("recording.keep.size", "is less than the size of one segment")


def _read_connections(file: dict[str, Any], problems: Problems) -> Iterator[tuple[str, Line]]:
    for name, table in named_tables(file, "connections", problems):
        key = joined("connections", name)
        if not isinstance(table, dict):
            problems.add(key, f"{shown(table)} is not a table, write [connections.NAME]")
            continue
        transport = table.get("transport")
        if isinstance(transport, str) and transport in _TRANSPORTS:
            own = _without_foreign_keys(transport, table, key, problems)
            yield name, read_table(_TRANSPORTS[transport], own, key, problems)
        elif "transport" not in table:
            problems.add(f"{key}.transport", f"missing, needed is {alternatives(_TRANSPORTS)}")
            known = {name for kind in _TRANSPORTS.values() for name in kind.__struct_fields__}
            problems.unknown_keys(key, table, {"transport", *known})
        else:
            hint = suggestion(transport, _TRANSPORTS) if isinstance(transport, str) else ""
            text = f"{shown(transport)} is not {alternatives(_TRANSPORTS)}{hint}"
            problems.add(f"{key}.transport", text)


def _without_foreign_keys(
    transport: str, table: dict[str, Any], key: str, problems: Problems
) -> dict[str, Any]:
    own = {}
    for name, value in table.items():
        having = [word for word, kind in _TRANSPORTS.items() if name in kind.__struct_fields__]
        if having and transport not in having:
            problems.add(joined(key, name), f"only with transport = {alternatives(having)}")
        else:
            own[name] = value
    return own


def _connections(
    lines: Mapping[str, Line],
    devices: Collection[Device],
    base: Path,
    problems: Problems,
) -> dict[str, Connection]:
    connections: dict[str, Connection] = {}
    for name, line in lines.items():
        profiles = [device.profile for device in devices if device.connection == name]
        if isinstance(line, Rtu):
            connection = defaults.serial_line(name, line, profiles, base)
            _check_direction(joined("connections", name), line, problems)
            _check_format(joined("connections", name), line, profiles, problems)
        elif isinstance(line, RtuOverTcp):
            connection = defaults.gateway(name, line, profiles)
            _check_format(joined("connections", name), line, profiles, problems)
        else:
            connection = defaults.server(name, line, profiles)
        if connection is not None:
            _check_times(joined("connections", name), connection, problems)
            connections[name] = connection
    for one, other in combinations(connections.values(), 2):
        if _place(one) == _place(other):
            key = joined("connections", other.name)
            which = "port" if other.transport == "rtu" else "host"
            text = f"{other.place} is the place of connection {shown(one.name)} already"
            problems.add(f"{key}.{which}", text)
    return connections


def _place(connection: Connection) -> tuple[str, str, str | int]:
    """What two names of the same line or server have in common; links are followed."""
    if connection.transport == "rtu":
        return "serial", "", os.path.realpath(str(connection.port))
    protocol = "udp" if connection.transport == "udp" else "tcp"
    return protocol, connection.host.lower(), connection.port


def _check_format(
    key: str, line: Rtu | RtuOverTcp, profiles: list[RegisterMap], problems: Problems
) -> None:
    names = ("baudrate", "bytesize", "parity", "stopbits")
    for name in (name for name in names if name in line.__struct_fields__):
        serials = [profile.serial for profile in profiles if profile.serial.is_documented]
        wanted = sorted({getattr(serial, name) for serial in serials})
        if len(wanted) > 1 and getattr(line, name) is UNSET and not problems.at(f"{key}.{name}"):
            choice = " and ".join(shown(value) for value in wanted)
            problems.add(f"{key}.{name}", f"missing, its devices are delivered with {choice}")


def _check_direction(key: str, line: Rtu, problems: Problems) -> None:
    if isinstance(line.rs485, UnsetType):
        return
    names = ("rts_on_send", "rts_after_send")
    wanted = defaults.direction_control(line.rs485)
    same = wanted.rts_on_send == wanted.rts_after_send
    if same and not any(problems.at(f"{key}.rs485.{name}") for name in names):
        text = f"{shown(wanted.rts_after_send)} like rts_on_send, so RTS would switch nothing"
        problems.add(f"{key}.rs485.rts_after_send", text)


def _check_times(key: str, connection: Connection, problems: Problems) -> None:
    timeout, late = connection.timeout, connection.late_answer
    if late is not None and late < timeout and not problems.at(f"{key}.timeout"):
        text = f"{format_duration(late)} is less than the timeout, {format_duration(timeout)}"
        problems.add(f"{key}.late_answer", text)
    least = defaults.LEAST_SILENCE.nanoseconds(connection.character)
    if connection.silence < least and not problems.at(f"{key}.baudrate"):
        text = (
            f"{format_duration(connection.silence)} is less than 3.5 characters, "
            f"{format_duration(least)} at {connection.baudrate} baud"
        )
        problems.add(f"{key}.silence", text)

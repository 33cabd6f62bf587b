"""Reads a configuration and judges its keys together."""

from __future__ import annotations

import os
import re
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from msgspec import UNSET

from roclog.config import defaults
from roclog.config.leaves import NAME, shown
from roclog.config.reading import Problems, joined, read_table, read_toml, suggestion
from roclog.config.settings import Connection, Settings
from roclog.config.tables import (
    LATER_PROFILES,
    Configuration,
    DeviceTable,
    Line,
    Recording,
    Rtu,
    RtuOverTcp,
    Tcp,
    Udp,
)
from roclog.devices import PROFILES
from roclog.errors import ConfigError
from roclog.quantities import format_duration

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

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
_SERIAL_UNITS: Final = range(1, 248)
"""Modbus over Serial Line V1.02, section 2.2; 0 is the broadcast."""


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
    tables = dict(_read_devices(file, problems))
    _check_references(tables, file.get("connections"), problems)
    connections = _connections(lines, tables, base, problems)
    devices = _devices(tables, lines, problems)
    _check_acknowledging(devices.values(), problems)

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


def _named_tables(file: dict[str, Any], key: str, problems: Problems) -> Iterator[tuple[str, Any]]:
    """The tables below connections or devices whose names can be used, with their names."""
    value = file.get(key)
    if value is None or value == {}:
        problems.add(key, f"missing, needed is at least one table [{key}.NAME]")
    elif not isinstance(value, dict):
        problems.add(key, f"{shown(value)} is not a table, write [{key}.NAME]")
    else:
        for name, table in value.items():
            if re.fullmatch(NAME, name) is None:
                text = "name is not 1 to 32 of a-z, 0-9, - and _, with a letter or digit first"
                problems.add(joined(key, name), text)
            yield name, table


def _read_connections(file: dict[str, Any], problems: Problems) -> Iterator[tuple[str, Line]]:
    for name, table in _named_tables(file, "connections", problems):
        key = joined("connections", name)
        if not isinstance(table, dict):
            problems.add(key, f"{shown(table)} is not a table, write [connections.NAME]")
            continue
        transport = table.get("transport")
        if isinstance(transport, str) and transport in _TRANSPORTS:
            own = _without_foreign_keys(transport, table, key, problems)
            yield name, read_table(_TRANSPORTS[transport], own, key, problems)
        elif "transport" not in table:
            problems.add(f"{key}.transport", f"missing, needed is {_alternatives(_TRANSPORTS)}")
            known = {name for kind in _TRANSPORTS.values() for name in kind.__struct_fields__}
            problems.unknown_keys(key, table, {"transport", *known})
        else:
            hint = suggestion(transport, _TRANSPORTS) if isinstance(transport, str) else ""
            text = f"{shown(transport)} is not {_alternatives(_TRANSPORTS)}{hint}"
            problems.add(f"{key}.transport", text)


def _without_foreign_keys(
    transport: str, table: dict[str, Any], key: str, problems: Problems
) -> dict[str, Any]:
    own = {}
    for name, value in table.items():
        having = [word for word, kind in _TRANSPORTS.items() if name in kind.__struct_fields__]
        if having and transport not in having:
            problems.add(joined(key, name), f"only with transport = {_alternatives(having)}")
        else:
            own[name] = value
    return own


def _alternatives(words: Iterable[str]) -> str:
    *others, last = (shown(word) for word in words)
    return " or ".join(filter(None, (", ".join(others), last)))


def _read_devices(file: dict[str, Any], problems: Problems) -> Iterator[tuple[str, DeviceTable]]:
    for name, table in _named_tables(file, "devices", problems):
        key = joined("devices", name)
        if name == "log":
            problems.add(key, "a device cannot be called log, that is the topic of events")
        profile = table.get("profile") if isinstance(table, dict) else None
        if isinstance(profile, str) and profile in LATER_PROFILES:
            names = ", ".join(f'"{name}"' for name in PROFILES)
            problems.add(
                f"{key}.profile", f"{shown(profile)} is not in this version, only {names} is"
            )
            continue
        device = read_table(DeviceTable, table, key, problems)
        if isinstance(device.profile, str) and device.profile not in PROFILES:
            hint = suggestion(device.profile, PROFILES) or f", known: {', '.join(PROFILES)}"
            problems.add(f"{key}.profile", f"no profile {shown(device.profile)}{hint}")
        yield name, device


def _check_references(
    devices: Mapping[str, DeviceTable], connections: object, problems: Problems
) -> None:
    names = list(connections) if isinstance(connections, dict) else []
    for name, device in devices.items():
        wanted = device.connection
        if isinstance(wanted, str) and wanted not in names:
            key = joined("devices", name)
            hint = suggestion(wanted, names)
            problems.add(f"{key}.connection", f"no connection {shown(wanted)}{hint}")


def _profiles_on(connection: str, devices: Mapping[str, DeviceTable]) -> list[RegisterMap]:
    return [
        PROFILES[device.profile]
        for device in devices.values()
        if device.connection == connection
        and isinstance(device.profile, str)
        and device.profile in PROFILES
    ]


def _connections(
    lines: Mapping[str, Line],
    devices: Mapping[str, DeviceTable],
    base: Path,
    problems: Problems,
) -> dict[str, Connection]:
    connections: dict[str, Connection] = {}
    for name, line in lines.items():
        profiles = _profiles_on(name, devices)
        if isinstance(line, Rtu):
            connection = defaults.serial_line(name, line, profiles, base)
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
        wanted = sorted({getattr(profile.serial, name) for profile in profiles})
        if len(wanted) > 1 and getattr(line, name) is UNSET and not problems.at(f"{key}.{name}"):
            choice = " and ".join(shown(value) for value in wanted)
            problems.add(f"{key}.{name}", f"missing, its devices are delivered with {choice}")


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


def _devices(
    tables: Mapping[str, DeviceTable], lines: Mapping[str, Line], problems: Problems
) -> dict[str, Device]:
    devices: dict[str, Device] = {}
    for name, table in tables.items():
        if not isinstance(table.profile, str) or table.profile not in PROFILES:
            continue
        device = defaults.device(name, table, PROFILES[table.profile])
        if device is None:
            continue
        devices[name] = device
        line = lines.get(device.connection)
        if isinstance(line, Rtu | RtuOverTcp) and device.unit not in _SERIAL_UNITS:
            key = joined("devices", name)
            text = f"{device.unit} is not a unit on a serial line, 1 to 247"
            problems.add(f"{key}.unit", text)
    return devices


def _check_acknowledging(devices: Iterable[Device], problems: Problems) -> None:
    clearing = [device for device in devices if device.clears]
    for one, other in combinations(clearing, 2):
        keys = [f"{joined('devices', device.name)}.unit" for device in (one, other)]
        same = (one.connection, one.unit) == (other.connection, other.unit)
        if same and not any(problems.at(key) for key in keys):
            text = (
                f"{other.unit} is the unit of device {shown(one.name)} on the same connection, and "
                "both would clear its flag; acknowledge = false on one of them, or another unit"
            )
            problems.add(keys[1], text)

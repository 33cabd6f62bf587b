"""The device tables of a configuration: each judged by itself, then together."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any, Final

from roclog.config import defaults
from roclog.config.leaves import shown
from roclog.config.profiles import TABLES, profile_names, register_map, table_of
from roclog.config.profiles.device_table import DeviceTable
from roclog.config.reading import joined, named_tables, read_table, suggestion
from roclog.config.tables import Line, Rtu, RtuOverTcp

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from roclog.config.reading import Problems
    from roclog.config.settings import Device

_SERIAL_UNITS: Final = range(1, 248)
"""Modbus over Serial Line V1.02, section 2.2; 0 is the broadcast."""


def read_devices(
    file: dict[str, Any], lines: Mapping[str, Line], problems: Problems
) -> dict[str, Device]:
    """Every device whose connection and register map are known, by name."""
    tables = dict(_read_tables(file, problems))
    _check_references(tables, file.get("connections"), problems)
    devices = _devices(tables, lines, problems)
    _check_acknowledging(devices.values(), problems)
    _check_dialects(devices.values(), problems)
    return devices


def _read_tables(file: dict[str, Any], problems: Problems) -> Iterator[tuple[str, DeviceTable]]:
    for name, table in named_tables(file, "devices", problems):
        key = joined("devices", name)
        if name == "log":
            problems.add(key, "a device cannot be called log, that is the topic of events")
        profile = table.get("profile") if isinstance(table, dict) else None
        kind = table_of(profile) if isinstance(profile, str) else None
        if kind is not None:
            yield name, read_table(kind, table, key, problems)
            continue
        if isinstance(profile, str):
            known = profile_names()
            hint = suggestion(profile, known) or f", known: {', '.join(known)}"
            problems.add(f"{key}.profile", f"no profile {shown(profile)}{hint}")
        elif profile is not None:
            problems.add(f"{key}.profile", f"{shown(profile)} is not the name of a profile")
        elif isinstance(table, dict):
            problems.add(f"{key}.profile", "missing, needed is the name of a profile")
        yield name, _read_plain(table, key, problems)


def _read_plain(table: object, key: str, problems: Problems) -> DeviceTable:
    """Of a device without a usable profile, what all devices have."""
    if isinstance(table, dict):
        known = {name for kind in TABLES.values() for name in kind.__struct_fields__}
        problems.unknown_keys(key, table, {"profile", *known})
        table = {k: v for k, v in table.items() if k in DeviceTable.__struct_fields__}
    return read_table(DeviceTable, table, key, problems)


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


def _devices(
    tables: Mapping[str, DeviceTable], lines: Mapping[str, Line], problems: Problems
) -> dict[str, Device]:
    devices: dict[str, Device] = {}
    for name, table in tables.items():
        if type(table) is DeviceTable:
            continue
        profile = register_map(table, joined("devices", name), problems)
        device = None if profile is None else defaults.device(name, table, profile)
        if device is None:
            continue
        devices[name] = device
        line = lines.get(device.connection)
        if isinstance(line, Rtu | RtuOverTcp) and not device.profile.has_serial_port:
            who = device.profile.name
            text = f"{shown(device.connection)} carries RTU, {who} has TCP and UDP only"
            problems.add(f"{joined('devices', name)}.connection", text)
        elif isinstance(line, Rtu | RtuOverTcp) and device.unit not in _SERIAL_UNITS:
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


def _check_dialects(devices: Iterable[Device], problems: Problems) -> None:
    """A connection has one way of framing, and so one dialect."""
    first: dict[str, Device] = {}
    for device in devices:
        other = first.setdefault(device.connection, device)
        key = f"{joined('devices', device.name)}.connection"
        if device.profile.dialect != other.profile.dialect and not problems.at(key):
            text = (
                f"{shown(device.connection)} has device {shown(other.name)} ({_frames(other)}); "
                f"frames of this one ({_frames(device)}) differ, it needs its own connection"
            )
            problems.add(key, text)


def _frames(device: Device) -> str:
    return f"{device.profile.name}, {device.profile.dialect.order} endian"

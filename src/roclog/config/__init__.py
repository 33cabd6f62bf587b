"""The configuration: a TOML file, checked as a whole, with every default filled in."""

from __future__ import annotations

from roclog.config.advice import BusLoad, bus_loads, warnings
from roclog.config.loading import load
from roclog.config.settings import Connection, Device, RecordingSettings, Settings, Transport
from roclog.config.tables import json_schema

__all__ = [
    "BusLoad",
    "Connection",
    "Device",
    "RecordingSettings",
    "Settings",
    "Transport",
    "bus_loads",
    "json_schema",
    "load",
    "warnings",
]

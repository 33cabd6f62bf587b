"""A field data logger for Modbus devices; from Python, the recordings read back.

import roclog

with roclog.open("recordings") as recording:
    for sample in recording.samples("/roc1/sample", start="2026-11-23T06:00:00Z"):
        print(sample.log_time, sample.values["iso_code_1"])
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roclog.errors import (
        ConfigError,
        DamagedFile,
        DeviceError,
        RegisterMapError,
        RoclogError,
        StorageError,
    )
    from roclog.recording.reader import Recording
    from roclog.recording.reader import open_recording as open  # noqa: A004
    from roclog.recording.records import Clear, Event, Gap, Link, Offset, Sample

__all__ = [
    "Clear",
    "ConfigError",
    "DamagedFile",
    "DeviceError",
    "Event",
    "Gap",
    "Link",
    "Offset",
    "Recording",
    "RegisterMapError",
    "RoclogError",
    "Sample",
    "StorageError",
    "open",
]

_RECORDS = ("Clear", "Event", "Gap", "Link", "Offset", "Sample")


def __getattr__(name: str) -> object:
    """Import on first use, so that the command line starts fast."""
    from importlib import import_module  # noqa: PLC0415

    if name not in __all__:
        raise AttributeError(f"module 'roclog' has no attribute {name!r}")
    if name in ("open", "Recording"):
        module = import_module("roclog.recording.reader")
        return getattr(module, "open_recording" if name == "open" else name)
    return getattr(
        import_module("roclog.recording.records" if name in _RECORDS else "roclog.errors"), name
    )

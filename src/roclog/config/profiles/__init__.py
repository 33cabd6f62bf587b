"""What a device table of each profile says, and the register map that follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from roclog.config.profiles import (
    hiac_roc,
    mei_timestamped,
    mpa_48,
    msx_e3317,
    plugin,
    registers,
)
from roclog.config.profiles.register_tables import Registers
from roclog.plugins import find_plugins

if TYPE_CHECKING:
    from collections.abc import Callable

    from roclog.config.profiles.device_table import DeviceTable
    from roclog.config.reading import Problems
    from roclog.register_map import RegisterMap

AnyDevice = (
    hiac_roc.HiacRoc
    | mei_timestamped.MeiTimestamped
    | mpa_48.Mpa48
    | msx_e3317.MsxE3317
    | plugin.PluginDevice
    | Registers
)
TABLES: Final[dict[str, type[DeviceTable]]] = {
    "hiac-roc": hiac_roc.HiacRoc,
    "mei-timestamped": mei_timestamped.MeiTimestamped,
    "mpa-48": mpa_48.Mpa48,
    "msx-e3317": msx_e3317.MsxE3317,
    "registers": Registers,
}
"""The keys of a device by its profile, of those that are built in."""
_BUILDERS: Final[dict[str, Callable[[Any, str, Problems], RegisterMap | None]]] = {
    "hiac-roc": hiac_roc.register_map,
    "mei-timestamped": mei_timestamped.register_map,
    "mpa-48": mpa_48.register_map,
    "msx-e3317": msx_e3317.register_map,
    "registers": registers.register_map,
}


def table_of(profile: str) -> type[DeviceTable] | None:
    """The keys of a device with this profile, built in or of a plug-in; None = there is none."""
    return TABLES.get(profile) or plugin.table_of(profile)


def profile_names() -> list[str]:
    """The built-in ones first."""
    return list(dict.fromkeys([*TABLES, *(found.name for found in find_plugins())]))


def register_map(table: DeviceTable, key: str, problems: Problems) -> RegisterMap | None:
    """The map of the device at this key path; None where its problems leave none."""
    build = _BUILDERS.get(str(table.__struct_config__.tag), plugin.register_map)
    return build(table, key, problems)

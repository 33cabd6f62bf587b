"""``profile = "..."`` of a device that another package brings."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from msgspec import UNSET, UnsetType, defstruct

from roclog.config.profiles.device_table import Acknowledge, Cycle, DeviceTable, WordOrderKey
from roclog.errors import RegisterMapError
from roclog.plugins import load_plugin, plugins_named

if TYPE_CHECKING:
    from roclog.config.reading import Problems
    from roclog.register_map import RegisterMap


class PluginDevice(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="plug-in"):
    """A device of a plug-in that is installed beside roclog."""

    word_order: WordOrderKey | UnsetType = UNSET
    acknowledge: Acknowledge | UnsetType = UNSET
    cycle: Cycle | UnsetType = UNSET


def table_of(profile: str) -> type[PluginDevice] | None:
    """Its keys; None where no package has this profile. The package is not imported yet."""
    return _tagged(profile) if plugins_named(profile) else None


@cache
def _tagged(profile: str) -> type[PluginDevice]:
    """The keys, with the name that they were asked for by."""
    table = defstruct("PluginDevice", [], bases=(PluginDevice,), module=__name__, tag=profile)
    assert issubclass(table, PluginDevice)
    return table


def register_map(table: PluginDevice, key: str, problems: Problems) -> RegisterMap | None:
    """The map that the package has; None with what is wrong with it."""
    try:
        found = load_plugin(str(table.__struct_config__.tag))
    except RegisterMapError as error:
        for text in error.problems:
            problems.add(f"{key}.profile", text)
        return None
    units = found.dialect.units
    if not isinstance(table.unit, UnsetType) and table.unit not in units:
        text = f"{table.unit} is not a unit of {found.name}, {units[0]} to {units[-1]}"
        problems.add(f"{key}.unit", text)
    if found.flagged is None:
        for name in ("acknowledge", "cycle"):
            if getattr(table, name) is not UNSET:
                problems.add(f"{key}.{name}", f"{found.name} has no flag that is cleared")
    return found

"""What a device table of each profile says, and the register map that follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from roclog.config.profiles import hiac_roc, mei_timestamped, mpa_48, msx_e3317, registers
from roclog.config.profiles.register_tables import Registers

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
    | Registers
)
TABLES: Final[dict[str, type[DeviceTable]]] = {
    "hiac-roc": hiac_roc.HiacRoc,
    "mei-timestamped": mei_timestamped.MeiTimestamped,
    "mpa-48": mpa_48.Mpa48,
    "msx-e3317": msx_e3317.MsxE3317,
    "registers": Registers,
}
"""The keys of a device by its profile."""
_BUILDERS: Final[dict[str, Callable[[Any, str, Problems], RegisterMap | None]]] = {
    "hiac-roc": hiac_roc.register_map,
    "mei-timestamped": mei_timestamped.register_map,
    "mpa-48": mpa_48.register_map,
    "msx-e3317": msx_e3317.register_map,
    "registers": registers.register_map,
}


def register_map(table: DeviceTable, key: str, problems: Problems) -> RegisterMap | None:
    """The map of the device at this key path; None where its problems leave none."""
    return _BUILDERS[str(table.__struct_config__.tag)](table, key, problems)

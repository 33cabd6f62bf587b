"""``profile = "msx-e3317"``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from roclog.config.profiles.device_table import DeviceTable
from roclog.devices.msx_e3317 import REGISTER_MAP

if TYPE_CHECKING:
    from roclog.config.reading import Problems
    from roclog.register_map import RegisterMap


class MsxE3317(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="msx-e3317"):
    """An ADDI-DATA MSX-E3317 pressure measurement module."""

    byte_order: (
        Annotated[
            Literal["big", "little"],
            Meta(description="As the module's web page says, header included; default big"),
        ]
        | UnsetType
    ) = UNSET


def register_map(table: MsxE3317, key: str, problems: Problems) -> RegisterMap:
    """The module's functions in its byte order."""
    units = REGISTER_MAP.dialect.units
    if not isinstance(table.unit, UnsetType) and table.unit not in units:
        text = f"{table.unit} is not a unit of this module, which answers to 0 and 1"
        problems.add(f"{key}.unit", text)
    order = "big" if isinstance(table.byte_order, UnsetType) else table.byte_order
    return replace(REGISTER_MAP, dialect=replace(REGISTER_MAP.dialect, order=order))

"""``profile = "msx-e3317"``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Final, Literal, get_args

from msgspec import UNSET, Meta, UnsetType

from roclog.config.profiles.device_table import DeviceTable
from roclog.config.profiles.functions import FunctionTable, with_functions
from roclog.devices.msx_e3317 import REGISTER_MAP

if TYPE_CHECKING:
    from roclog.config.reading import Problems
    from roclog.register_map import RegisterMap

_CallName = Literal[
    "clock",
    "calibration_status",
    "pressure_channels",
    "acquisition_channels",
    "channels_info",
]
_CALLS: Final = ", ".join(get_args(_CallName))
_Call = Annotated[_CallName, Meta(title=f"a name of {_CALLS}")]


class MsxE3317(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="msx-e3317"):
    """An ADDI-DATA MSX-E3317 pressure measurement module."""

    byte_order: (
        Annotated[
            Literal["big", "little"],
            Meta(description="As the module's web page says, header included; default big"),
        ]
        | UnsetType
    ) = UNSET
    calls: (
        Annotated[
            list[_Call],
            Meta(
                title=f"names, of {_CALLS}",
                description="Documented functions that are called on schedule; default all",
            ),
        ]
        | UnsetType
    ) = UNSET
    functions: (
        Annotated[
            list[FunctionTable],
            Meta(title="functions, written as [[devices.NAME.functions]]"),
        ]
        | UnsetType
    ) = UNSET


def register_map(table: MsxE3317, key: str, problems: Problems) -> RegisterMap:
    """The module's functions in its byte order, and those that the file declares."""
    units = REGISTER_MAP.dialect.units
    if not isinstance(table.unit, UnsetType) and table.unit not in units:
        text = f"{table.unit} is not a unit of this module, which answers to 0 and 1"
        problems.add(f"{key}.unit", text)
    order = "big" if isinstance(table.byte_order, UnsetType) else table.byte_order
    made = replace(REGISTER_MAP, dialect=replace(REGISTER_MAP.dialect, order=order))
    if not isinstance(table.calls, UnsetType):
        called = tuple(block for block in made.samples if block.name in table.calls)
        made = replace(made, samples=called)
    declared = [] if isinstance(table.functions, UnsetType) else table.functions
    if not made.samples and not declared:
        if not problems.at(f"{key}.functions"):
            problems.add(f"{key}.calls", "none, and no functions: nothing would be called")
        return made
    device = key.rpartition(".")[2]
    return with_functions(made, declared, device, f"{key}.functions", problems)

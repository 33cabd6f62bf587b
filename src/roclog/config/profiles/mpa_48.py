"""``profile = "mpa-48"``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from roclog.config.profiles.device_table import DeviceTable
from roclog.config.reading import joined
from roclog.devices import mpa_48

if TYPE_CHECKING:
    from roclog.config.reading import Problems
    from roclog.register_map import RegisterMap

Model = Annotated[
    Literal["model-10", "model-15", "model-15L", "model-51", "model-52"],
    Meta(title="a model: model-10, model-15, model-15L, model-51 or model-52"),
]
_Register = Annotated[int, Meta(title="a register: a number from 0 to 65533, without quotes")]
_Sensors = Annotated[
    dict[str, Model],
    Meta(
        title="a table of channel and model, like "
        '{ channel_1 = "model-15", channel_2 = "model-10" } (model-10, -15, -15L, -51, -52)',
        description="The analyser does not tell which sensors it has",
    ),
]
_Addresses = Annotated[
    dict[str, _Register],
    Meta(
        title="a table of channel and register, like { channel_3 = 40 }",
        description="Input register of the status; needed for channels other than 1 and 2",
    ),
]


class Mpa48(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="mpa-48"):
    """An Insite IG MPA-48 analyser."""

    sensors: _Sensors | UnsetType
    addresses: _Addresses | UnsetType = UNSET


def register_map(table: Mpa48, key: str, problems: Problems) -> RegisterMap | None:
    """The map of an analyser with these sensors."""
    if isinstance(table.sensors, UnsetType) or problems.below(f"{key}.addresses"):
        return None
    addresses = {} if isinstance(table.addresses, UnsetType) else table.addresses
    found = list(mpa_48.find_problems(table.sensors, addresses))
    for place, channel, text in found:
        path = joined(f"{key}.{place}", channel) if channel else f"{key}.{place}"
        problems.add(path, text)
    return None if found else mpa_48.mpa_48(table.sensors, addresses)

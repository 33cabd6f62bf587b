"""The keys that every device has."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from roclog.config.leaves import Duration
from roclog.register_map import WordOrder

_ConnectionName = Annotated[
    str,
    Meta(
        title="the name of a connection",
        description="Name of one of the tables under connections",
    ),
]
_Unit = Annotated[
    int,
    Meta(
        ge=0,
        le=255,
        title="a unit: 1 to 247 on serial lines, 0 to 255 on TCP and UDP",
        description="Default: as the device is delivered",
    ),
]
_Poll = Annotated[Duration, Meta(description="From read to read; default 1s")]
WordOrderKey = Annotated[WordOrder, Meta(description="Of values of 32 bits and more; default ABCD")]
Acknowledge = Annotated[
    bool,
    Meta(
        title="true or false, without quotes",
        description="false: never write, tell samples apart by change; default true",
    ),
]
Cycle = Annotated[Duration, Meta(description="Time between samples; default: what the device says")]


class DeviceTable(Struct, kw_only=True, forbid_unknown_fields=True, tag_field="profile"):
    """A device on a connection."""

    connection: _ConnectionName | UnsetType
    unit: _Unit | UnsetType = UNSET
    poll: _Poll | UnsetType = UNSET

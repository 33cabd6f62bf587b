"""The tables and keys of a configuration file.

The check of single values, the did-you-mean of a key and the JSON Schema for editors all come from
these Structs. UNSET: the file does not say, or what it says is already reported.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType, json

from roclog.config.leaves import (
    NAME,
    Duration,
    Host,
    PathText,
    RtsDelay,
    Silence,
    Size,
    leaf_schema,
)
from roclog.config.profiles import TABLES, AnyDevice

_Directory = Annotated[
    PathText, Meta(description="Relative to the configuration; default recordings")
]
_SegmentDuration = Annotated[Duration, Meta(description="Default 1h, at least 1s")]
_SegmentSize = Annotated[Size, Meta(description="Default 64 MiB, at least 64 KiB")]
_KeepAge = Annotated[Duration, Meta(description="For example 90d")]
_KeepSize = Annotated[Size, Meta(description="For example 20 GiB")]


class Segment(Struct, kw_only=True, forbid_unknown_fields=True):
    """A segment ends at the first limit it reaches."""

    duration: _SegmentDuration | UnsetType = UNSET
    size: _SegmentSize | UnsetType = UNSET


class Keep(Struct, kw_only=True, forbid_unknown_fields=True):
    """Sealed segments beyond these limits are deleted, oldest first; default: none is."""

    age: _KeepAge | UnsetType = UNSET
    size: _KeepSize | UnsetType = UNSET


class Recording(Struct, kw_only=True, forbid_unknown_fields=True):
    """Where segments go and when one ends."""

    directory: _Directory | UnsetType = UNSET
    segment: Segment | UnsetType = UNSET
    keep: Keep | UnsetType = UNSET


_SerialPort = Annotated[
    PathText,
    Meta(title="the path of a serial port", description="Best a link below /dev/serial/by-id"),
]
_Baudrate = Annotated[
    int,
    Meta(
        ge=1,
        le=4_000_000,
        title="a whole number from 1 to 4000000",
        description="Default: as the devices are delivered",
    ),
]
_Bytesize = Annotated[Literal[8], Meta(description="RTU needs all 8 data bits")]
_Parity = Annotated[Literal["N", "E", "O"], Meta(description="None, even, odd")]
_Stopbits = Annotated[Literal[1, 2], Meta(description="Default: as the devices are delivered")]
_Timeout = Annotated[
    Duration,
    Meta(
        description="For an answer to begin and end, from the end of the request; default: the "
        "longest time that the devices may take, with tcp and udp at least 1s"
    ),
]
_LateAnswer = Annotated[
    Duration,
    Meta(
        description="After a time-out nothing is sent until the late answer came or this has "
        "passed since the request; default 2 x timeout"
    ),
]
_Silence = Annotated[
    Silence,
    Meta(
        description="Before every request, like 5 chars or 10ms; default: what the devices ask, "
        "at least 3.5 characters"
    ),
]


_LowLatency = Annotated[
    bool,
    Meta(
        title="true or false, without quotes",
        description="Ask the driver to hand octets over as they come; default true",
    ),
]
_RtsOnSend = Annotated[
    bool,
    Meta(title="true or false, without quotes", description="RTS during a frame; default true"),
]
_RtsAfterSend = Annotated[
    bool,
    Meta(title="true or false, without quotes", description="RTS between frames; default false"),
]
_RtsDelayBefore = Annotated[
    RtsDelay, Meta(description="From RTS to the frame, whole milliseconds; default 0ms")
]
_RtsDelayAfter = Annotated[
    RtsDelay, Meta(description="From the frame to RTS, whole milliseconds; default 0ms")
]


class Rs485(Struct, kw_only=True, forbid_unknown_fields=True):
    """Direction control of an RS-485 port by its driver; without this table it is not touched."""

    rts_on_send: _RtsOnSend | UnsetType = UNSET
    rts_after_send: _RtsAfterSend | UnsetType = UNSET
    delay_before_send: _RtsDelayBefore | UnsetType = UNSET
    delay_after_send: _RtsDelayAfter | UnsetType = UNSET


class Rtu(Struct, kw_only=True, forbid_unknown_fields=True, tag_field="transport", tag="rtu"):
    """A serial line with Modbus RTU."""

    port: _SerialPort | UnsetType
    baudrate: _Baudrate | UnsetType = UNSET
    bytesize: _Bytesize | UnsetType = UNSET
    parity: _Parity | UnsetType = UNSET
    stopbits: _Stopbits | UnsetType = UNSET
    timeout: _Timeout | UnsetType = UNSET
    late_answer: _LateAnswer | UnsetType = UNSET
    silence: _Silence | UnsetType = UNSET
    low_latency: _LowLatency | UnsetType = UNSET
    rs485: Rs485 | UnsetType = UNSET


_Host = Annotated[Host, Meta(title="a host name or an IP address")]
_TcpPort = Annotated[
    int, Meta(ge=1, le=65535, title="a port from 1 to 65535", description="Default 502")
]


class Tcp(Struct, kw_only=True, forbid_unknown_fields=True, tag_field="transport", tag="tcp"):
    """A Modbus TCP server."""

    host: _Host | UnsetType
    port: _TcpPort | UnsetType = UNSET
    timeout: _Timeout | UnsetType = UNSET


class Udp(Struct, kw_only=True, forbid_unknown_fields=True, tag_field="transport", tag="udp"):
    """A Modbus UDP server: one frame in each datagram."""

    host: _Host | UnsetType
    port: _TcpPort | UnsetType = UNSET
    timeout: _Timeout | UnsetType = UNSET


_GatewayPort = Annotated[
    int,
    Meta(
        ge=1,
        le=65535,
        title="a port from 1 to 65535",
        description="Where the gateway passes octets through, like 4001",
    ),
]
_GatewayBaudrate = Annotated[
    int,
    Meta(
        ge=1,
        le=4_000_000,
        title="a whole number from 1 to 4000000",
        description="Of the line behind the gateway, which has its own setting; here it tells how "
        "long characters are. Default: as the devices are delivered",
    ),
]


class RtuOverTcp(
    Struct,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="transport",
    tag="rtu-over-tcp",
):
    """A serial line with Modbus RTU behind a gateway that passes octets through."""

    host: _Host | UnsetType
    port: _GatewayPort | UnsetType
    baudrate: _GatewayBaudrate | UnsetType = UNSET
    timeout: _Timeout | UnsetType = UNSET
    late_answer: _LateAnswer | UnsetType = UNSET
    silence: _Silence | UnsetType = UNSET


Line = Rtu | Tcp | Udp | RtuOverTcp

_ByName = Meta(extra_json_schema={"propertyNames": {"pattern": f"^{NAME}$"}, "minProperties": 1})


class Configuration(Struct, kw_only=True, forbid_unknown_fields=True):
    """A roclog configuration."""

    recording: Recording | UnsetType = UNSET
    connections: Annotated[dict[str, Line], _ByName]
    devices: Annotated[dict[str, AnyDevice], _ByName]


def json_schema() -> dict[str, Any]:
    """JSON Schema of the configuration, draft 7, for editors.

    Which plug-ins are installed is not its matter: any other name may be a profile of one.
    """
    _, tables = json.schema_components(
        [Configuration], schema_hook=leaf_schema, ref_template="#/definitions/{name}"
    )
    root = tables.pop("Configuration")
    del root["properties"]["devices"]["additionalProperties"]["discriminator"]
    tables["PluginDevice"]["properties"]["profile"] = {
        "type": "string",
        "pattern": "^[a-z][a-z0-9-]*$",
        "not": {"enum": list(TABLES)},
        "description": "The name of a profile that a plug-in has",
    }
    return {"$schema": "http://json-schema.org/draft-07/schema#", **root, "definitions": tables}

"""The tables that describe a device's registers in a configuration."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from roclog.config.leaves import Duration
from roclog.config.profiles.device_table import Acknowledge, Cycle, DeviceTable, WordOrderKey
from roclog.register_map import Table, WordType

_Table = Annotated[Table, Meta(description="Of Modbus")]
_FlagTable = Annotated[Table, Meta(description="Default: the block's")]
_Type = Annotated[WordType, Meta(title="a type", description="How words become a value")]
_Period = Annotated[Duration, Meta(description="From read to read; default: the device's poll")]
_AnswerLimit = Annotated[Duration, Meta(description="Longest time to an answer; default 1s")]
NAME: Final = "^[a-z][a-z0-9_]{0,47}$"
Name = Annotated[
    str,
    Meta(
        pattern=NAME,
        title="a name of 1 to 48 a-z, 0-9 and _, with a letter first",
        description="Becomes a topic or the name of a field",
    ),
]
Title = Annotated[str, Meta(max_length=200, title="a text", description="For people")]
_Address = Annotated[
    int,
    Meta(
        ge=0,
        le=65535,
        title="a PDU address: a number from 0 to 65535, counted from 0; the register that "
        "manuals call 40001 or 400001 is 0 in holding_registers",
    ),
]
_Offset = Annotated[
    int,
    Meta(
        ge=0,
        le=65535,
        title="an offset: registers (or bits) from the address of the block, 0 to 65535",
    ),
]
_Word = Annotated[int, Meta(ge=0, le=65535, title="a word from 0 to 65535")]
_Number = Annotated[int | float, Meta(title="a number")]
_Payload = Annotated[
    list[str],
    Meta(
        title='names of points, like ["rate", "total"]',
        description="Points that change with a new sample only: another payload is a sample, also "
        "while the flag is down. Default: all points",
    ),
]
_Texts = Annotated[
    dict[str, str], Meta(title='a table of number and text, like { 0 = "closed", 1 = "open" }')
]
Order = Literal["ABCD", "CDAB", "BADC", "DCBA", "AB", "BA"]
_Order = Annotated[
    Order,
    Meta(
        description="Where the octets of 0x41424344 (ABCD) are found; AB or BA in one register and "
        "in text. Default: the device's"
    ),
]


class ValidWhenTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """A measurement counts only while another field of its block has one of these values."""

    EXAMPLE: ClassVar[str] = '{ point = "status", values = [0] }'

    point: Annotated[str, Meta(title="the name of a point or of one of its bits")] | UnsetType
    values: Annotated[list[int], Meta(title="whole numbers, like [0]")] | UnsetType


class ValueTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """What a value is called, and what its number means."""

    name: Name | UnsetType
    scale: _Number | UnsetType = UNSET
    add: (
        Annotated[int | float, Meta(title="a number", description="Added after the scale")]
        | UnsetType
    ) = UNSET
    unit: Annotated[str, Meta(title="a unit of UCUM, like Cel, bar or L/min")] | UnsetType = UNSET
    range: (
        Annotated[
            list[int | float],
            Meta(
                min_length=2,
                max_length=2,
                title="two numbers, the lowest and the highest",
                description="What lies outside is kept and named as doubtful",
            ),
        ]
        | UnsetType
    ) = UNSET
    sentinels: (
        Annotated[
            dict[str, str],
            Meta(
                title='a table of number and text, like { -32768 = "no sensor" }',
                description="Numbers in the device, before scale and add, that are no measurement; "
                "hexadecimal ones are the words",
            ),
        ]
        | UnsetType
    ) = UNSET
    valid_when: ValidWhenTable | UnsetType = UNSET
    meanings: _Texts | UnsetType = UNSET
    bits: (
        Annotated[
            dict[str, str],
            Meta(
                title='a table of bit and name, like { 0 = "running", 8-11 = "mode" }',
                description="0 is the lowest; several bits are a number",
            ),
        ]
        | UnsetType
    ) = UNSET
    title: Title | UnsetType = UNSET


class PointTable(ValueTable, kw_only=True, forbid_unknown_fields=True):
    """One value of a block."""

    offset: _Offset | UnsetType
    type: _Type | UnsetType
    words: (
        Annotated[int, Meta(ge=1, le=125, title="registers of a text or bytes, from 1 to 125")]
        | UnsetType
    ) = UNSET
    word_order: _Order | UnsetType = UNSET


class ClearOnReadTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """The word with the flag that reading the block lowers."""

    EXAMPLE: ClassVar[str] = "{ address = 2, mask = 4 }"

    address: _Address | UnsetType
    table: _FlagTable | UnsetType = UNSET
    mask: _Word | UnsetType = UNSET
    new: _Word | UnsetType = UNSET


class CounterOrChangeTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """When an answer is a sample: counter or change; default: every answer."""

    EXAMPLE: ClassVar[str] = (
        '{ change = ["state"] } or { counter = "number" }; cyclic is the default, without a trigger'
    )

    counter: Annotated[str, Meta(title="the name of a point that counts")] | UnsetType = UNSET
    first: (
        Annotated[
            int,
            Meta(
                ge=0,
                title="a whole number, 0 or more",
                description="Of the counter, what follows last; default 0",
            ),
        ]
        | UnsetType
    ) = UNSET
    last: (
        Annotated[
            int,
            Meta(
                ge=1,
                title="a whole number, 1 or more",
                description="Of the counter, the largest; default: all bits of the point set",
            ),
        ]
        | UnsetType
    ) = UNSET
    change: (
        Annotated[
            list[str],
            Meta(title='names of points, like ["state"]; [] is the whole block'),
        ]
        | UnsetType
    ) = UNSET


class TriggerTable(CounterOrChangeTable, kw_only=True, forbid_unknown_fields=True):
    """When a read is a sample: flag, clear_on_read, counter or change; default: every read."""

    flag: _Offset | UnsetType = UNSET
    new: _Word | UnsetType = UNSET
    clear: _Word | UnsetType = UNSET
    payload: _Payload | UnsetType = UNSET
    clear_on_read: ClearOnReadTable | UnsetType = UNSET


class TimeTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """Where the device's own time of a sample lies; all numbers but the last two are offsets."""

    EXAMPLE: ClassVar[str] = '{ source = "unix", offset = 10 }'

    source: (
        Annotated[
            Literal["calendar", "unix", "unix_us", "cp56", "cp32"],
            Meta(title="a time source: calendar, unix, unix_us, cp56 or cp32"),
        ]
        | UnsetType
    )
    offset: _Offset | UnsetType = UNSET
    seconds: _Offset | UnsetType = UNSET
    microseconds: _Offset | UnsetType = UNSET
    year: _Offset | UnsetType = UNSET
    year_month: _Offset | UnsetType = UNSET
    month: _Offset | UnsetType = UNSET
    month_day: _Offset | UnsetType = UNSET
    day: _Offset | UnsetType = UNSET
    day_hour: _Offset | UnsetType = UNSET
    hour: _Offset | UnsetType = UNSET
    hour_minute: _Offset | UnsetType = UNSET
    minute: _Offset | UnsetType = UNSET
    minute_second: _Offset | UnsetType = UNSET
    second: _Offset | UnsetType = UNSET
    millisecond: _Offset | UnsetType = UNSET
    millisecond_of_minute: _Offset | UnsetType = UNSET
    word_order: _Order | UnsetType = UNSET
    year_base: (
        Annotated[int, Meta(ge=0, le=9999, title="a year", description="Added to the year")]
        | UnsetType
    ) = UNSET
    epoch: (
        Annotated[
            int,
            Meta(
                ge=-86400,
                title="seconds from 1970",
                description="At which the device counts 0, like 946684800 for the year 2000, or "
                "-3600 where it counts those of a clock at +01:00",
            ),
        ]
        | UnsetType
    ) = UNSET


class BlockTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """Registers or bits that belong together."""

    name: Name | UnsetType
    table: _Table | UnsetType
    address: _Address | UnsetType
    points: (
        Annotated[
            list[PointTable],
            Meta(title='points like { name = "rate", offset = 0, type = "float32" }'),
        ]
        | UnsetType
    )
    count: (
        Annotated[
            int,
            Meta(
                ge=1,
                le=65536,
                title="a number of registers or bits",
                description="Default: up to the last point",
            ),
        ]
        | UnsetType
    ) = UNSET
    title: Title | UnsetType = UNSET
    read: (
        Annotated[
            Literal["cyclic", "once"],
            Meta(description="once: when recording starts, kept as facts; default cyclic"),
        ]
        | UnsetType
    ) = UNSET
    period: _Period | UnsetType = UNSET
    atomic: (
        Annotated[
            bool,
            Meta(
                title="true or false, without quotes",
                description="true: read in one request of its own; default true",
            ),
        ]
        | UnsetType
    ) = UNSET
    trigger: TriggerTable | UnsetType = UNSET
    time: TimeTable | UnsetType = UNSET


class Registers(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="registers"):
    """A device whose registers are described here."""

    blocks: (
        Annotated[list[BlockTable], Meta(title="blocks, written as [[devices.NAME.blocks]]")]
        | UnsetType
    )
    word_order: WordOrderKey | UnsetType = UNSET
    acknowledge: Acknowledge | UnsetType = UNSET
    cycle: Cycle | UnsetType = UNSET
    timezone: (
        Annotated[
            str,
            Meta(
                title="a time zone in quotes",
                description="In which the clock of calendar, cp56 and cp32 runs: UTC, an offset "
                'like "+01:00", or a name like "Europe/Berlin"; default UTC',
            ),
        ]
        | UnsetType
    ) = UNSET
    answer_limit: _AnswerLimit | UnsetType = UNSET
    source: (
        Annotated[str, Meta(max_length=200, title="a text", description="The document of the map")]
        | UnsetType
    ) = UNSET
    identity: (
        Annotated[
            list[str],
            Meta(
                title='points of blocks that are read once, like ["who.serial_number"]',
                description="Where one of them changes, another device stands there, and a new "
                "epoch begins",
            ),
        ]
        | UnsetType
    ) = UNSET


def given(table: Struct, *names: str) -> dict[str, Any]:
    """The keys among these that the file gives."""
    found = ((name, getattr(table, name)) for name in names)
    return {name: value for name, value in found if not isinstance(value, UnsetType)}

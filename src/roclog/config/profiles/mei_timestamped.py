"""``profile = "mei-timestamped"``."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from roclog.config.leaves import shown
from roclog.config.profiles.device_table import DeviceTable
from roclog.devices import mei_timestamped
from roclog.modbus.stamped import Layout
from roclog.register_map import RegisterMap, StampedInputs, StampRules, Table
from roclog.stamps import parse_zone

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.config.reading import Problems

_ADDRESSES = 0x10000


class PointList(Struct, kw_only=True, forbid_unknown_fields=True):
    """Inputs that follow each other."""

    kind: (
        Annotated[
            Literal["discrete_inputs", "input_registers"],
            Meta(title="the kind of inputs: discrete_inputs or input_registers"),
        ]
        | UnsetType
    )
    stamp: (
        Annotated[
            Literal[7, 4],
            Meta(title="the octets of a stamp, 7 or 4", description="4: without a date"),
        ]
        | UnsetType
    )
    address: (
        Annotated[
            int,
            Meta(ge=0, lt=_ADDRESSES, title="a PDU address, from 0 to 65535"),
        ]
        | UnsetType
    )
    count: (
        Annotated[
            int,
            Meta(ge=1, le=_ADDRESSES, title="a number of inputs, from 1 to 65536"),
        ]
        | UnsetType
    )
    layout: (
        Annotated[
            Literal["interleaved", "grouped", "auto"],
            Meta(
                description="Of registers: each value before its stamp, or all values before all "
                "stamps; auto: the device is asked. Default interleaved"
            ),
        ]
        | UnsetType
    ) = UNSET


class MeiTimestamped(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="mei-timestamped"):
    """A device whose inputs carry the time of their last change."""

    points: (
        Annotated[
            list[PointList],
            Meta(
                title='lists like { kind = "discrete_inputs", stamp = 7, address = 0, count = 8 }'
            ),
        ]
        | UnsetType
    )
    timezone: (
        Annotated[
            str,
            Meta(
                title="a time zone in quotes",
                description='Of the device: UTC, an offset like "+01:00", or a name like '
                '"Europe/Berlin"; default UTC',
            ),
        ]
        | UnsetType
    ) = UNSET
    year_pivot: (
        Annotated[
            int,
            Meta(
                ge=70,
                le=100,
                title="a two-digit year from 70 to 100",
                description="Years from here on belong to the 1900s; default 70",
            ),
        ]
        | UnsetType
    ) = UNSET
    stamps: (
        Annotated[
            Literal["strict", "lenient"],
            Meta(
                description="lenient: give a time, and say so, where milliseconds are out of range "
                "or the summer time bit contradicts the zone; default strict"
            ),
        ]
        | UnsetType
    ) = UNSET


def register_map(table: MeiTimestamped, key: str, problems: Problems) -> RegisterMap | None:
    """The lists and how stamps are read."""
    zone = _zone(table, key, problems)
    if isinstance(table.points, UnsetType):
        return None
    if not table.points:
        problems.add(f"{key}.points", "no list of inputs, so there is nothing to read")
    lists = [found for _, found in _lists(table.points, f"{key}.points", problems)]
    _check_overlaps(dict(_lists(table.points, f"{key}.points", None)), problems)
    pivot = table.year_pivot
    rules = StampRules(
        zone=zone,
        year_pivot=70 if isinstance(pivot, UnsetType) else pivot,
        lenient=table.stamps == "lenient",
    )
    return mei_timestamped.register_map(lists, rules)


def _zone(table: MeiTimestamped, key: str, problems: Problems) -> str:
    if isinstance(table.timezone, UnsetType):
        return "UTC"
    try:
        parse_zone(table.timezone)
    except ValueError as error:
        problems.add(f"{key}.timezone", str(error))
        return "UTC"
    return table.timezone


def _lists(
    points: list[PointList], key: str, problems: Problems | None
) -> Iterator[tuple[str, StampedInputs]]:
    """Key path and list of everything that is whole; the rest is reported already, or here."""
    for index, one in enumerate(points):
        if isinstance(one.kind, UnsetType) or isinstance(one.stamp, UnsetType):
            continue
        if isinstance(one.address, UnsetType) or isinstance(one.count, UnsetType):
            continue
        path = f"{key}[{index}]"
        if one.address + one.count > _ADDRESSES:
            if problems is not None:
                text = f"{one.count} inputs from {one.address} on end beyond address 65535"
                problems.add(f"{path}.count", text)
            continue
        layout = "interleaved" if isinstance(one.layout, UnsetType) else one.layout
        if problems is not None and one.kind == "discrete_inputs" and one.layout is not UNSET:
            problems.add(f"{path}.layout", "only of registers; discrete inputs have one layout")
        yield (
            path,
            StampedInputs(
                table=Table(one.kind),
                stamp=one.stamp,
                address=one.address,
                count=one.count,
                layout=None if layout == "auto" else Layout(layout),
            ),
        )


def _check_overlaps(lists: dict[str, StampedInputs], problems: Problems) -> None:
    """An input in two lists would be two histories under one address."""
    for (first, one), (second, other) in combinations(lists.items(), 2):
        low = max(one.address, other.address)
        high = min(one.address + one.count, other.address + other.count)
        if one.table is other.table and low < high:
            what = one.table.replace("_", " ")
            span = shown(low) if high - low == 1 else f"{low} to {high - 1}"
            text = f"{what} {span} are in {first} already; use another device for the same unit"
            problems.add(f"{second}.address", text)

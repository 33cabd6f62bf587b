"""Functions of a module that no document describes, as a configuration declares them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from roclog.config.leaves import Duration, shown
from roclog.config.profiles.register_tables import (
    CounterOrChangeTable,
    Name,
    Title,
    ValueTable,
    given,
)
from roclog.config.profiles.register_triggers import counter_or_change
from roclog.config.profiles.registers import meaning
from roclog.map_check import find_flaws
from roclog.register_map import (
    PACKED_OCTETS,
    Block,
    Point,
    RegisterMap,
    SecondsMicroseconds,
    Table,
    WordType,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.config.reading import Problems

_STAMP: Final = "time_stamp"
_STAMP_OCTETS: Final = 8
_Length = Annotated[
    int, Meta(ge=1, le=PACKED_OCTETS[-1], title=f"a number from 1 to {PACKED_OCTETS[-1]}")
]
_Type = Annotated[
    Literal[
        "uint16",
        "int16",
        "uint32",
        "int32",
        "uint64",
        "int64",
        "float32",
        "float64",
        "bytes",
        "text",
        "time_stamp",
    ],
    Meta(
        title="a type",
        description="time_stamp: two unsigned numbers of 32 bits, the microseconds, then the "
        "seconds since 1970; it becomes the device time of the sample",
    ),
]
_KEYS: Final = {"address": "register", "name": "name", "trigger": "trigger", "period": "period"}
"""What the map calls a key of a function, and what the file does; all others are the layout's."""
_FIELD_KEYS: Final = {"words": "size", "offset": "type"}
_DEPENDENT: Final = frozenset({"count", "trigger", "valid_when"})
"""Keys of the map that cannot be judged where a field was left out."""


class FieldTable(ValueTable, kw_only=True, forbid_unknown_fields=True):
    """One field of the answer; it begins where the one before it ends."""

    type: _Type | UnsetType
    count: Annotated[_Length, Meta(description="An array: NAME_1 to NAME_count")] | UnsetType = (
        UNSET
    )
    size: Annotated[_Length, Meta(description="Octets of bytes or of a text")] | UnsetType = UNSET


class FunctionTable(Struct, kw_only=True, forbid_unknown_fields=True):
    """A function without parameters (Modbus function 3), and what it answers.

    A call may act, although it looks like a read. Declare only what may be called again and again.
    """

    name: Name | UnsetType
    register: (
        Annotated[int, Meta(ge=0, le=65535, title="the register of a function, from 0 to 65535")]
        | UnsetType
    )
    period: (
        Annotated[
            Duration,
            Meta(
                title='a duration like "1s"; the function is called again whenever it is over',
                description="From call to call. A call may act: the function is called again "
                "whenever this is over, and because an answer was lost only where it is repeatable",
            ),
        ]
        | UnsetType
    )
    layout: (
        Annotated[
            list[FieldTable],
            Meta(title='the fields of the answer, like [{ name = "value", type = "float32" }]'),
        ]
        | UnsetType
    )
    title: Title | UnsetType = UNSET
    trigger: CounterOrChangeTable | UnsetType = UNSET
    repeatable: (
        Annotated[
            bool,
            Meta(
                title="true or false, without quotes",
                description="true: where its answer is lost, the function is called once more at "
                "once, if two timeouts fit its period; default false",
            ),
        ]
        | UnsetType
    ) = UNSET


@dataclass(slots=True)
class _Layout:
    """A layout as far as it was read.

    paths: key path of the field of each point. spans: by field and by element of an array.
    """

    points: list[Point]
    paths: list[str]
    spans: dict[str, tuple[int, int]]
    time: SecondsMicroseconds | None = None
    octets: int = 0
    is_whole: bool = True


def with_functions(
    made: RegisterMap, tables: Sequence[FunctionTable], device: str, key: str, problems: Problems
) -> RegisterMap:
    """The map with what the user declares; key: that of the functions."""
    blocks: list[Block] = []
    places: list[tuple[str, _Layout]] = []
    for index, table in enumerate(tables):
        path = f"{key}[{index}]"
        _tell_twin(table, (*made.blocks, *blocks), path, problems)
        layout = _layout(table, f"{path}.layout", problems)
        block = _block(table, layout, f"device_{device.replace('-', '_')}", path, problems)
        if block is not None:
            blocks.append(block)
            places.append((path, layout))
    whole = replace(made, samples=(*made.samples, *blocks))
    _tell_flaws(whole, len(made.blocks), key, places, problems)
    return whole


def _tell_twin(
    table: FunctionTable, others: Sequence[Block], path: str, problems: Problems
) -> None:
    for block in others:
        who = f"{block.name} ({block.title})" if block.title else block.name
        if block.address == table.register:
            problems.add(f"{path}.register", f"{block.address} is called already, as {who}")
        if block.name == table.name:
            text = f"{shown(block.name)} is the name of another function, register {block.address}"
            problems.add(f"{path}.name", text)


def _block(
    table: FunctionTable, layout: _Layout, prefix: str, path: str, problems: Problems
) -> Block | None:
    """None without fields; what else is missing is reported, and the fields can be judged."""
    trigger = counter_or_change(table.trigger, layout.spans, f"{path}.trigger", problems)
    if layout.octets not in PACKED_OCTETS and layout.is_whole:
        least, most = PACKED_OCTETS[0], PACKED_OCTETS[-1]
        text = f"{layout.octets} octets, but an answer has {least} to {most}"
        problems.add(f"{path}.layout", text if layout.octets else "no fields")
    if not layout.points:
        return None
    name = f"unnamed_{layout.octets}" if isinstance(table.name, UnsetType) else table.name
    return Block(
        name=name,
        message=f"{prefix}_{name}",
        table=Table.HOLDING_REGISTERS,
        address=-1 if isinstance(table.register, UnsetType) else table.register,
        count=layout.octets,
        points=tuple(layout.points),
        time=layout.time,
        trigger=trigger,
        packed=True,
        **given(table, "title", "period", "repeatable"),
    )


def _layout(table: FunctionTable, path: str, problems: Problems) -> _Layout:
    layout = _Layout([], [], {})
    if isinstance(table.layout, UnsetType):
        layout.is_whole = False
        return layout
    for index, described in enumerate(table.layout):
        place = f"{path}[{index}]"
        if isinstance(described.name, UnsetType) or isinstance(described.type, UnsetType):
            _leave_out(layout, described)
        elif described.type == _STAMP:
            _add_stamp(layout, described.name, described, place, problems)
        else:
            _add_values(layout, described.name, described, place, problems)
    return layout


def _leave_out(layout: _Layout, table: FieldTable) -> None:
    """A trigger may name it all the same."""
    layout.is_whole = False
    if not isinstance(table.name, UnsetType):
        layout.spans[table.name] = 0, 1


def _add_stamp(
    layout: _Layout, name: str, table: FieldTable, path: str, problems: Problems
) -> None:
    for key in given(table, *(set(table.__struct_fields__) - {"name", "type", "title"})):
        problems.add(f"{path}.{key}", "not with a time stamp")
    if layout.time is not None:
        text = "a second one, but a sample has one device time: this is uint32 with count = 2"
        problems.add(f"{path}.type", text)
        return
    layout.time = SecondsMicroseconds(microseconds=layout.octets, seconds=layout.octets + 4)
    layout.spans[name] = layout.octets, _STAMP_OCTETS
    for part, unit in (("microseconds", "us"), ("seconds", "s")):
        more = given(table, "title")
        _add(layout, f"{name}_{part}", WordType.U32, path, {"unit": unit, **more})


def _add_values(
    layout: _Layout, name: str, table: FieldTable, path: str, problems: Problems
) -> None:
    type_ = WordType(str(table.type))
    more = meaning(table, type_, path, problems)
    if not isinstance(table.size, UnsetType) and not type_.has_length:
        problems.add(f"{path}.size", f"only with bytes and text, not with {type_}")
    elif not isinstance(table.size, UnsetType):
        more["words"] = table.size
    elif type_.has_length:
        if not problems.at(f"{path}.size"):
            problems.add(f"{path}.size", f"missing, needed is the number of octets of {type_}")
        _leave_out(layout, table)
        return
    first = layout.octets
    if isinstance(table.count, UnsetType):
        _add(layout, name, type_, path, more)
    else:
        for number in range(1, table.count + 1):
            _add(layout, f"{name}_{number}", type_, path, _numbered(more, number))
    layout.spans[name] = first, layout.octets - first


def _add(layout: _Layout, name: str, type_: WordType, path: str, more: dict[str, Any]) -> None:
    octets = more.get("words", 2 * type_.words)
    layout.points.append(Point(name=name, offset=layout.octets, type=type_, **more))
    layout.paths.append(path)
    layout.spans[name] = layout.octets, octets
    layout.octets += octets


def _numbered(more: dict[str, Any], number: int) -> dict[str, Any]:
    """Names of bits differ from element to element."""
    bits = tuple((bit, f"{name}_{number}") for bit, name in more.get("bits", ()))
    parts = tuple((*place, f"{name}_{number}") for *place, name in more.get("parts", ()))
    return {**more, **({"bits": bits, "parts": parts} if bits or parts else {})}


def _tell_flaws(
    made: RegisterMap,
    documented: int,
    key: str,
    places: Sequence[tuple[str, _Layout]],
    problems: Problems,
) -> None:
    """documented: how many blocks the map has without the declared ones."""
    for flaw in find_flaws(made):
        path = key
        if flaw.key == "message":  # the device's name, which has been told
            continue
        if flaw.block is not None:
            function, layout = places[flaw.block - documented]
            if flaw.key in _DEPENDENT and not layout.is_whole:
                continue
            path = f"{function}.{_KEYS.get(flaw.key, 'layout')}"
            if flaw.point is not None:
                path = f"{layout.paths[flaw.point]}.{_FIELD_KEYS.get(flaw.key, flaw.key)}"
        if not any(_is_told(problem.key, path, key) for problem in problems.found):
            problems.add(path, flaw.text.removeprefix(f"{flaw.key}: "))


def _is_told(told: str, path: str, key: str) -> bool:
    """Whether something at this key, or below it, has been told; twins are told by themselves."""
    return f"{told}.".startswith(f"{path}.") or (path == key and told.endswith("].name"))

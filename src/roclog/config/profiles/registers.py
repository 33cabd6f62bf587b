"""``profile = "registers"``: a register map written by the user."""

from __future__ import annotations

import math
import re
import struct
from decimal import Decimal
from typing import TYPE_CHECKING, Any, Final

from msgspec import UnsetType

from roclog.config.leaves import shown
from roclog.config.profiles.register_tables import PointTable, given
from roclog.config.profiles.register_triggers import time_source, trigger
from roclog.config.reading import joined
from roclog.map_check import find_flaws
from roclog.register_map import (
    MAX_BLOCK,
    MAX_READ_BITS,
    MAX_READ_REGISTERS,
    Block,
    Cp32,
    Cp56,
    Point,
    RegisterMap,
    SerialDefaults,
    SplitCalendar,
    ValidWhen,
    WordOrder,
    WordType,
)
from roclog.stamps import parse_zone
from roclog.word_types import CODES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.config.profiles.register_tables import (
        BlockTable,
        Registers,
        ValidWhenTable,
        ValueTable,
    )
    from roclog.config.reading import Problems

_ANSWER_LIMIT: Final = 10**9
_ORDERS: Final = {"AB": WordOrder.ABCD, "BA": WordOrder.BADC}
_BITS: Final = re.compile(r"(\d{1,2})(?:-(\d{1,2}))?", re.ASCII)
_INTEGER: Final = re.compile(r"-?\d{1,20}|0x[0-9a-fA-F]{1,16}", re.ASCII)
_NUMBER: Final = re.compile(r"-?\d{1,40}(\.\d{1,40})?([eE][+-]?\d{1,3})?", re.ASCII)
_NAN: Final = "not needed, NaN is no number and is recorded as that"
_DEPENDENT: Final = frozenset(
    {"count", "cycle", "identity", "points", "trigger", "valid_when", "blocks"}
)
"""Keys that cannot be judged where a point or a block was left out."""


def register_map(table: Registers, key: str, problems: Problems) -> RegisterMap | None:
    """The map, or None with every problem of it, by key path."""
    if isinstance(table.unit, UnsetType) and not problems.at(f"{key}.unit"):
        problems.add(f"{key}.unit", "missing, needed is the unit of the device")
    zone = _zone(table, key, problems)
    if isinstance(table.blocks, UnsetType):
        return None
    device = key.rpartition(".")[2]
    before = len(problems.found)
    facts: list[Block] = []
    samples: list[Block] = []
    paths: dict[int, tuple[str, list[str]]] = {}
    uncounted: set[str] = set()
    whole = True
    for index, described in enumerate(table.blocks):
        path = f"{key}.blocks[{index}]"
        built = _block(described, path, device, zone, problems)
        if built is None:
            whole = False
            continue
        block, points, complete = built
        whole = whole and complete
        (facts if described.read == "once" else samples).append(block)
        paths[id(block)] = (path, points)
        if isinstance(described.count, UnsetType):
            uncounted.add(path)
    if not table.blocks and not problems.at(f"{key}.blocks"):
        problems.add(
            f"{key}.blocks", "is empty, needed are blocks, written as [[devices.NAME.blocks]]"
        )
    places = [paths[id(block)] for block in (*facts, *samples)]
    if facts and not samples and whole:
        problems.add(f"{key}.blocks", 'all have read = "once", so that nothing would be recorded')
    made = RegisterMap(
        name="registers",
        title="Described in the configuration",
        source="" if isinstance(table.source, UnsetType) else table.source,
        unit=1 if isinstance(table.unit, UnsetType) else table.unit,
        serial=SerialDefaults(baudrate=9600, is_documented=False),
        answer_limit=_ANSWER_LIMIT
        if isinstance(table.answer_limit, UnsetType)
        else table.answer_limit,
        samples=tuple(samples),
        facts=tuple(facts),
        identity=tuple(_identity(table, key, problems)),
    )
    _tell_flaws(made, key, places, uncounted, problems, whole=whole)
    if whole and not problems.below(f"{key}.blocks"):
        _tell_idle(table, made, key, problems)
    return None if len(problems.found) > before else made


def _tell_flaws(
    made: RegisterMap,
    key: str,
    places: list[tuple[str, list[str]]],
    uncounted: set[str],
    problems: Problems,
    *,
    whole: bool,
) -> None:
    """uncounted: blocks whose count follows from their points."""
    for flaw in find_flaws(made):
        path = f"{key}.{'identity' if flaw.key == 'identity' else 'blocks'}"
        text = flaw.text.removeprefix(f"{flaw.key}: ")
        if flaw.block is not None:
            block, points = places[flaw.block]
            path = f"{block if flaw.point is None else points[flaw.point]}.{flaw.key}"
            far = _farthest(made.blocks[flaw.block])
            if flaw.key == "count" and block in uncounted and far is not None:
                path, text = f"{points[far[0]]}.offset", far[1]
        told = any(f"{problem.key}.".startswith(f"{path}.") for problem in problems.found)
        if flaw.key == "message":  # the device's name, which has been told
            continue
        if not told and (whole or flaw.key not in _DEPENDENT):
            problems.add(path, text)


def _farthest(block: Block) -> tuple[int, str] | None:
    """Index of the point that makes a block too large, and what is wrong with it."""
    index = max(range(len(block.points)), key=lambda n: block.points[n].offset, default=0)
    what, most = (
        ("bit", MAX_READ_BITS) if block.table.has_bits else ("register", MAX_READ_REGISTERS)
    )
    most = most if block.atomic else MAX_BLOCK
    if not block.points or block.points[index].offset < most:
        return None
    offset = block.points[index].offset
    more = f", or {MAX_BLOCK} with atomic = false" if block.atomic else ""
    return index, (
        f"{offset} is {what} {block.address + offset}, since offsets count from the address of the "
        f"block, {block.address}; a block has {most} {what}s{more}"
    )


def _identity(table: Registers, key: str, problems: Problems) -> Iterator[tuple[str, str]]:
    for index, text in enumerate(given(table, "identity").get("identity", ())):
        block, dot, point = text.partition(".")
        if not dot:
            problems.add(f"{key}.identity[{index}]", f"{shown(text)} is not a block.point")
        else:
            yield block, point


def _tell_idle(table: Registers, made: RegisterMap, key: str, problems: Problems) -> None:
    """Keys without an effect: whoever wrote them expects one."""
    times = [block.time for block in made.blocks if block.time is not None]
    has_zone = any(isinstance(time, SplitCalendar | Cp56 | Cp32) for time in times)
    if not isinstance(table.timezone, UnsetType) and not problems.at(f"{key}.timezone"):
        if not times:
            problems.add(f"{key}.timezone", "has no effect, since no block has a time")
        elif not has_zone and table.timezone != "UTC":
            text = "has no effect, since unix and unix_us count seconds of UTC; "
            hint = "where unix counts those of a clock at +01:00, write epoch = -3600 there"
            problems.add(f"{key}.timezone", text + hint)
    if not isinstance(table.acknowledge, UnsetType) and made.flagged is None:
        text = (
            "has no effect, since no block has trigger = { flag = ... }, the only one that writes"
        )
        problems.add(f"{key}.acknowledge", text)
    if not isinstance(table.cycle, UnsetType) and not any(b.trigger for b in made.samples):
        text = "has no effect, since no block has a trigger and every read is a sample"
        problems.add(f"{key}.cycle", text)


def _zone(table: Registers, key: str, problems: Problems) -> str:
    if isinstance(table.timezone, UnsetType):
        return "UTC"
    try:
        parse_zone(table.timezone)
    except ValueError as error:
        problems.add(f"{key}.timezone", str(error))
        return "UTC"
    return table.timezone


def _block(
    table: BlockTable, key: str, device: str, zone: str, problems: Problems
) -> tuple[Block, list[str], bool] | None:
    """The block, the key path of each of its points, and whether none was left out."""
    name, where, address = table.name, table.table, table.address
    points: dict[str, Point] = {}
    if not isinstance(table.points, UnsetType):
        for index, described in enumerate(table.points):
            path = f"{key}.points[{index}]"
            point = _point(described, path, problems)
            if point is not None:
                points[path] = point
    if isinstance(name, UnsetType) or isinstance(where, UnsetType):
        return None
    if isinstance(address, UnsetType) or isinstance(table.points, UnsetType):
        return None
    if table.read == "once" and not isinstance(table.period, UnsetType):
        problems.add(f"{key}.period", 'has no effect with read = "once"')
    made = tuple(points.values())
    timed = time_source(table.time, f"{key}.time", zone, problems)
    spans = {point.name: (point.offset, _size(point)) for point in made}
    block = Block(
        name=name,
        message=f"device_{device.replace('-', '_')}_{name}",
        table=where,
        address=address,
        count=_count(table, made),
        points=made,
        time=timed,
        trigger=trigger(table.trigger, where, spans, f"{key}.trigger", problems),
        **given(table, "title", "period", "atomic"),
    )
    return block, list(points), len(points) == len(table.points)


def _size(point: Point) -> int:
    return point.words if point.type.has_length else point.type.words


def _count(table: BlockTable, points: tuple[Point, ...]) -> int:
    """As given, else up to the last register that anything names."""
    if not isinstance(table.count, UnsetType):
        return table.count
    ends = [point.offset + _size(point) for point in points]
    if not isinstance(table.trigger, UnsetType) and isinstance(table.trigger.flag, int):
        ends.append(table.trigger.flag + 1)
    time = table.time
    if not isinstance(time, UnsetType):
        wide = {"cp56": 4, "unix": 2, "cp32": 2, "unix_us": 2}.get(str(time.source), 1)
        names = set(time.__struct_fields__) - {"source", "word_order", "year_base", "epoch"}
        ends += [offset + wide for offset in given(time, *names).values()]
    return max(ends, default=1)


def _point(table: PointTable, key: str, problems: Problems) -> Point | None:
    name, offset, type_ = table.name, table.offset, table.type
    if isinstance(name, UnsetType) or isinstance(offset, UnsetType) or isinstance(type_, UnsetType):
        return None
    more = given(table, "words") | meaning(table, type_, key, problems)
    if type_.has_length and "words" not in more:
        if not problems.at(f"{key}.words"):
            problems.add(f"{key}.words", f"missing, needed is the number of registers of {type_}")
        return None
    if not isinstance(table.word_order, UnsetType):
        more["word_order"] = order(table.word_order)
        if table.word_order in _ORDERS and type_.words > 1:
            text = f"{table.word_order} is an order of one register, {type_} has {type_.words}"
            problems.add(f"{key}.word_order", f"{text}: ABCD, CDAB, BADC or DCBA")
    return Point(name=name, offset=offset, type=type_, **more)


def meaning(table: ValueTable, type_: WordType, key: str, problems: Problems) -> dict[str, Any]:
    """What the number of a point means, by the names that Point has for it."""
    more = given(table, "unit", "title")
    for number in ("scale", "add"):
        value = getattr(table, number)
        if not isinstance(value, UnsetType):
            more[number] = _exact(value)
    if not isinstance(table.range, UnsetType):
        more["low"], more["high"] = map(_exact, table.range)
    if not isinstance(table.bits, UnsetType):
        more["bits"], more["parts"] = _bits(table.bits, f"{key}.bits", problems)
    if not isinstance(table.meanings, UnsetType):
        more["meanings"] = tuple(_meanings(table.meanings, f"{key}.meanings", problems))
    if not isinstance(table.sentinels, UnsetType):
        found = _sentinels(table.sentinels, type_, f"{key}.sentinels", problems)
        more["sentinels"] = tuple(found)
    if not isinstance(table.valid_when, UnsetType):
        more["valid_when"] = _valid_when(table.valid_when)
    return more


def order(text: str) -> WordOrder:
    """Of the word in the file; AB and BA are written for one register."""
    return _ORDERS.get(text) or WordOrder(text)


def _exact(number: float) -> Decimal:
    """The decimal that the file says."""
    return Decimal(repr(number))


def _valid_when(table: ValidWhenTable) -> ValidWhen | None:
    if isinstance(table.point, UnsetType) or isinstance(table.values, UnsetType):
        return None
    return ValidWhen(point=table.point, values=tuple(table.values))


def _bits(
    table: dict[str, str], key: str, problems: Problems
) -> tuple[tuple[tuple[int, str], ...], tuple[tuple[int, int, str], ...]]:
    bits: list[tuple[int, str]] = []
    parts: list[tuple[int, int, str]] = []
    for text, name in table.items():
        match = _BITS.fullmatch(text)
        if match is None or (match[2] is not None and int(match[2]) <= int(match[1])):
            problems.add(joined(key, text), "is not a bit like 0, or bits like 8-11, lowest first")
        elif match[2] is None:
            bits.append((int(match[1]), name))
        else:
            parts.append((int(match[1]), int(match[2]) - int(match[1]) + 1, name))
    return tuple(bits), tuple(parts)


def _meanings(table: dict[str, str], key: str, problems: Problems) -> Iterator[tuple[int, str]]:
    for text, meaning in table.items():
        if _INTEGER.fullmatch(text) is None:
            problems.add(joined(key, text), f"{shown(text)} is not a whole number")
        else:
            yield int(text, 0 if text.startswith("0x") else 10), meaning


def _sentinels(
    table: dict[str, str], type_: WordType, key: str, problems: Problems
) -> Iterator[tuple[Decimal, str]]:
    for text, meaning in table.items():
        if text.startswith("0x") and _INTEGER.fullmatch(text):
            number = _of_words(int(text, 16), type_)
            if number is None:
                unneeded = _unneeded(int(text, 16), type_)
                told = unneeded or f"these words are no number of {type_}"
                problems.add(joined(key, text), told)
            else:
                yield number, meaning
        elif _NUMBER.fullmatch(text):
            yield Decimal(text), meaning
        elif text.lower() in ("nan", "+nan", "-nan") and type_.is_float:
            problems.add(joined(key, text), _NAN)
        else:
            problems.add(joined(key, text), f"{shown(text)} is not a number")


def _unneeded(pattern: int, type_: WordType) -> str:
    """Why words that are no number need no sentinel; empty where they are not such."""
    if pattern >> 16 * type_.words or not (type_.is_float or type_.is_bcd):
        return ""
    if type_.is_bcd:
        return "not needed, words that are no decimal digits are no measurement anyway"
    is_infinite = math.isinf(
        struct.unpack(f">{CODES[type_]}", pattern.to_bytes(2 * type_.words))[0]
    )
    return "" if is_infinite else _NAN


def _of_words(pattern: int, type_: WordType) -> Decimal | None:
    """The number of a type that has these words, most significant first."""
    size = 2 * type_.words
    if pattern >> 8 * size or type_ not in CODES:
        return None
    if type_.is_bcd:
        return Decimal(f"{pattern:x}") if f"{pattern:x}".isdecimal() else None
    number = Decimal(struct.unpack(f">{CODES[type_]}", pattern.to_bytes(size))[0])
    return number if number.is_finite() else None

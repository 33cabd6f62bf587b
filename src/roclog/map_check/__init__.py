"""What every register map must satisfy, built in or not."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.errors import RegisterMapError
from roclog.map_check.points import NAME, named_keys, point_flaws
from roclog.map_check.triggers import time_flaws, trigger_flaws
from roclog.map_check.writable import writable_flaws
from roclog.register_map import (
    MAX_BLOCK,
    MAX_READ_BITS,
    MAX_READ_REGISTERS,
    PACKED_OCTETS,
    Block,
    ClearOnRead,
    FlagAndClear,
    RegisterMap,
    SerialDefaults,
    Table,
    WordType,
    camel_case,
)
from roclog.schema import sample_type

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.register_map import Point
    from roclog.schema import Field

_MESSAGE: Final = re.compile(r"[a-z][a-z0-9_]{0,95}")
RESERVED_BLOCKS: Final = frozenset({"gap", "link", "clear", "clock_offset"})
"""Channels that a device has beside its blocks."""
_FLAG: Final = "the flag"
_FLAG_HINT: Final = "leave this point out, the flag needs none, or name another flag"
_MAX_FIELDS: Final = 18_000
"""Protobuf keeps the numbers from 19000 on for itself."""


class Flaw(NamedTuple):
    """One thing wrong in a map.

    block, point: index into ``RegisterMap.blocks`` and ``Block.points``; None = of the whole.
    key: the attribute that is wrong, or the nearest one. place: the block and point, for people.
    """

    block: int | None
    point: int | None
    key: str
    place: str
    text: str

    def __str__(self) -> str:
        return f"{self.place}{self.text}"


def check_register_map(register_map: RegisterMap) -> None:
    """Raises:
    RegisterMapError: with all problems, not the first.
    """
    flaws = find_flaws(register_map)
    if flaws:
        raise RegisterMapError(register_map.name, [str(flaw) for flaw in flaws])


def find_flaws(register_map: RegisterMap) -> list[Flaw]:
    """Everything that is wrong, in the order of the map."""
    whole = (
        *_map_flaws(register_map),
        *_cycle_flaws(register_map),
        *_identity_flaws(register_map),
        *(("writable", f"writable: {text}") for text in writable_flaws(register_map)),
    )
    found = [Flaw(None, None, key, "", text) for key, text in whole]
    for number, block in enumerate(register_map.blocks):
        place = f"block {block.name}: "
        is_fact = number < len(register_map.facts)
        flaws = _block_flaws(block, is_fact=is_fact)
        found += [Flaw(number, None, key, place, text) for key, text in flaws]
        for index, point in enumerate(block.points):
            where = f"{place}point {point.name}: "
            flaws = point_flaws(point, block, index)
            found += [Flaw(number, index, key, where, text) for key, text in flaws]
        for index, key, text in (*_twin_fields(block), *_sharing_flaws(block)):
            where = f"{place}point {block.points[index].name}: "
            found.append(Flaw(number, index, key, where, text))
    return found


def _map_flaws(register_map: RegisterMap) -> Iterator[tuple[str, str]]:
    if not re.fullmatch(r"[a-z][a-z0-9-]*", register_map.name):
        yield "name", "name: must be lower case letters, digits and -"
    if not 0 <= register_map.unit <= 255:
        yield "unit", f"unit: {register_map.unit} is not 0 to 255"
    if register_map.answer_limit <= 0:
        yield "answer_limit", "answer_limit: must be longer than nothing"
    if not register_map.samples and not register_map.stamped:
        yield "blocks", "samples: no block, so that nothing would be recorded"
    yield from _serial_flaws(register_map.serial)
    flagged = [block.name for block in register_map.blocks if block.handshake is not None]
    if len(flagged) > 1:
        yield "blocks", f"blocks {' and '.join(flagged)}: only one can have a flag to clear"
    yield from _twins("blocks", "block", [block.name for block in register_map.blocks])
    yield from _message_flaws(register_map)


def _message_flaws(register_map: RegisterMap) -> Iterator[tuple[str, str]]:
    types: dict[str, tuple[str, tuple[Field, ...]]] = {}
    for block in register_map.samples:
        kind = sample_type(register_map.name, block)
        other, fields = types.setdefault(kind.name, (block.name, kind.fields))
        if block.message and fields != kind.fields:
            text = f"the message {block.message} of {other} has other fields"
            yield "blocks", f"block {block.name}: {text}"


def _serial_flaws(line: SerialDefaults) -> Iterator[tuple[str, str]]:
    if line.baudrate <= 0 or line.bytesize != 8 or line.stopbits not in (1, 2):
        yield "serial", "serial: must have a baudrate, 8 data bits, and 1 or 2 stop bits"
    if line.parity not in ("N", "E", "O"):
        yield "serial", f"serial: parity {line.parity!r} is not N, E or O"
    if not 3.5 <= line.silence_characters < math.inf:
        text = f"a silence of {line.silence_characters} is not at least 3.5 characters"
        yield "serial", f"serial: {text}"


def _cycle_flaws(register_map: RegisterMap) -> Iterator[tuple[str, str]]:
    if register_map.cycle is None:
        return
    facts, names = register_map.cycle
    points = {p.name: p for b in register_map.facts if b.name == facts for p in b.points}
    if not names:
        yield "cycle", "cycle: no points"
    for name in names:
        if name not in points:
            yield "cycle", f"cycle: no point {facts}.{name}"
        elif points[name].unit != "s" or points[name].type is WordType.TEXT:
            yield "cycle", f"cycle: {facts}.{name} is not in seconds"
        elif points[name].can_be_missing:
            yield "cycle", f"cycle: {facts}.{name} can be missing"


def _identity_flaws(register_map: RegisterMap) -> Iterator[tuple[str, str]]:
    known = {(block.name, point.name) for block in register_map.facts for point in block.points}
    for block, point in register_map.identity:
        if (block, point) not in known:
            text = f"no point {block}.{point} in a block that is read once"
            yield "identity", f"identity: {text}"


def _block_flaws(block: Block, *, is_fact: bool) -> Iterator[tuple[str, str]]:
    if not NAME.fullmatch(block.name) or block.name in RESERVED_BLOCKS:
        yield (
            "name",
            (
                "name must be lower case letters, digits and _, and not one of "
                + ", ".join(sorted(RESERVED_BLOCKS))
            ),
        )
    if block.message and not _MESSAGE.fullmatch(block.message):
        yield "message", f"message {block.message!r} must be lower case letters, digits and _"
    yield from _extent_flaws(block)
    if block.period is not None and block.period <= 0:
        yield "period", f"period: {block.period} ns is not more than nothing"
    if not block.points:
        yield "points", "no points"
    names = [name for point in block.points for name in point.field_names]
    if len(names) > _MAX_FIELDS:
        yield "points", f"{len(names)} fields are more than {_MAX_FIELDS}"
    numbers = {point.name for point in block.points if _is_wide_number(point)}
    for name in block.must_not_increase:
        if name not in numbers:
            yield "must_not_increase", f"must_not_increase: {name} is not a 32-bit point"
    yield from time_flaws(block)
    if block.trigger is not None and is_fact:
        yield "trigger", "facts are read once, they cannot have a flag or another trigger"
    yield from trigger_flaws(block)


def _is_wide_number(point: Point) -> bool:
    return point.type.words > 1 and not point.can_be_missing


def _extent_flaws(block: Block) -> Iterator[tuple[str, str]]:
    if block.packed:
        yield from _function_flaws(block)
        return
    what = "bits" if block.table.has_bits else "registers"
    answer = MAX_READ_BITS if block.table.has_bits else MAX_READ_REGISTERS
    most = answer if block.atomic else MAX_BLOCK
    if not 1 <= block.count <= most:
        more = f", or {MAX_BLOCK} with atomic = false" if block.atomic else ""
        yield "count", f"count {block.count} is not 1 to {most} {what}{more}"
    if not 0 <= block.address <= 65536 - block.count:
        last = block.address + block.count - 1
        yield "address", f"{what} {block.address} to {last} do not exist"
    if not block.atomic and isinstance(block.trigger, FlagAndClear | ClearOnRead):
        yield "atomic", "atomic: a block with a flag must be read in one request"


def _function_flaws(block: Block) -> Iterator[tuple[str, str]]:
    least, most = PACKED_OCTETS[0], PACKED_OCTETS[-1]
    if block.count not in PACKED_OCTETS:
        yield "count", f"count {block.count} is not {least} to {most} octets"
    if not 0 <= block.address <= 0xFFFF:
        yield "address", f"register {block.address} does not exist"
    if block.table is not Table.HOLDING_REGISTERS:
        yield "table", "table: a function is a holding register"
    if isinstance(block.trigger, FlagAndClear | ClearOnRead):
        yield "trigger", "trigger: a function has no flag"


def _twin_fields(block: Block) -> Iterator[tuple[int, str, str]]:
    """(index of the point, attribute, what is wrong with it), of the second of two."""
    first: dict[str, str] = {}
    for index, point in enumerate(block.points):
        for key, name in named_keys(point):
            other = first.get(camel_case(name))
            first.setdefault(camel_case(name), name)
            if other is not None:
                text = "named twice" if other == name else f"differs from {other} only in _"
                yield index, key, f"field {name}: {text}"


def _sharing_flaws(block: Block) -> Iterator[tuple[int, str, str]]:
    taken: dict[int, str] = {}
    if block.handshake is not None:
        taken[block.handshake.flag] = _FLAG
    what = "bit" if block.table.has_bits else "octet" if block.packed else "register"
    for index, point in enumerate(block.points):
        for word in range(point.offset, point.offset + min(block.size_of(point), MAX_BLOCK)):
            if word in taken:
                hint = f"; {_FLAG_HINT}" if taken[word] == _FLAG else ""
                yield index, "offset", f"shares {what} {word} with {taken[word]}{hint}"
            taken[word] = point.name


def _twins(key: str, what: str, names: list[str]) -> Iterator[tuple[str, str]]:
    """Names that are the same, or become the same in JSON or as a message type."""
    for name in sorted({n for n in names if names.count(n) > 1}):
        yield key, f"{what} {name}: named twice"
    first: dict[str, str] = {}
    for name in dict.fromkeys(names):
        other = first.setdefault(camel_case(name), name)
        if other != name:
            yield key, f"{what} {name}: differs from {other} only in _"

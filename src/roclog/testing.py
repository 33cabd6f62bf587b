"""For the tests of a device: is its map without flaws, and does it read what its document prints?

    from roclog.testing import Vector, check_register_map, decode_block, request_pdu

Nothing here needs a test runner. Truth comes from the document: octets that it prints, and what it
says that they mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.decode import Value, decode, field_names, named_values
from roclog.plugins import map_flaws
from roclog.quantities import format_instant
from roclog.register_map import WordOrder, WordType
from roclog.register_map.times import places
from roclog.request_plan import read_request
from roclog.word_types import block_words

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from roclog.register_map import Block, Point, RegisterMap

__all__ = ["Values", "Vector", "check_register_map", "decode_block", "request_pdu"]

Values = dict[str, Value | None]
"""By field name; None where there is no measurement. device_time: ISO 8601 UTC, None = unknown."""

_EXTREMES: Final = (0x0000, 0xFFFF, 0x8000, 0x7FFF)
_ROUNDED: Final = 1e-6
"""Documents print binary32 numbers with six or seven digits."""


class Vector(NamedTuple):
    """What a document prints.

    source: the document and the place in it. block: name of the block.
    words: as of decode_block. values: what they mean, of some fields or all.
    word_order: None = the one that a configuration has which does not name one.
    """

    source: str
    block: str
    words: str | Mapping[int, str]
    values: Mapping[str, Value | None]
    word_order: WordOrder | None = None


def check_register_map(register_map: RegisterMap, vectors: Iterable[Vector] = ()) -> None:
    """Hold a map against all that roclog asks of one, and against its document.

    Whatever words a device sends, its blocks must decode; every point must say what it is by a
    title, a unit or named bits; every vector must hold.

    Raises:
        AssertionError: with everything that is wrong, a line for each.
        ValueError: something among the vectors is no Vector, or its word order no WordOrder.
    """
    told = [_usable(vector, index) for index, vector in enumerate(vectors)]
    flaws = map_flaws(register_map)
    if not flaws:
        flaws += _silent_points(register_map)
        flaws += [text for block in register_map.blocks for text in _extreme_flaws(block)]
        flaws += [text for vector in told for text in _vector_flaws(register_map, vector)]
    if flaws:
        name = getattr(register_map, "name", "")
        raise AssertionError("\n".join(f"register map {name}: {flaw}" for flaw in flaws))


def decode_block(
    register_map: RegisterMap,
    block: str,
    words: str | Mapping[int, str],
    *,
    word_order: WordOrder | None = None,
) -> Values:
    """What the octets of a block mean.

    Args:
        register_map: the device.
        block: name of one of its blocks.
        words: in hexadecimal, blanks at will, like ``"033E 00FA"``: all octets of the block as
            they stand in an answer (bits: the lowest of the first octet comes first). Or some of
            its registers, by the address of the first, as a document prints them, like
            ``{25: "3838 3031 0000"}``: then what they tell without the others is returned.
        word_order: None = the one that a configuration has which does not name one.

    Raises:
        KeyError: the map has no such block.
        ValueError: not hexadecimal, not as many octets as the block has, registers outside it or
            given twice; the word order is not a WordOrder.
    """
    found = register_map.block(block)
    order = _usual_order(register_map) if word_order is None else _known_order(word_order)
    if isinstance(words, Mapping):
        given = _given(found, words)
        registers = [given.get(index, 0) for index in range(found.count)]
    else:
        registers = list(block_words(found, bytes.fromhex(words)))
        given = dict(enumerate(registers))
    decoded = decode(found, registers, order)
    values = named_values(found, decoded)
    known = {p.name: p for p in found.points if _is_known(found, p, given)}
    kept = {name for point in known.values() for name in _certain(point, known)}
    told = {name: value for name, value in values.items() if name in kept}
    needed = () if found.time is None else places(found.time, packed=found.packed)
    if found.time is not None and all(offset in given for offset in needed):
        time = decoded.device_time
        told["device_time"] = format_instant(time) if time else None
    return told


def request_pdu(register_map: RegisterMap, block: str) -> bytes:
    """The request for a block as roclog sends it, without unit and checksum.

    Raises:
        KeyError: the map has no such block.
        ValueError: it needs more than one request.
    """
    return read_request(register_map.block(block), register_map.dialect).pdu


def _usable(vector: object, index: int) -> Vector:
    if not isinstance(vector, Vector):
        raise ValueError(f"vectors[{index}] is {vector!r}, not a Vector")  # noqa: TRY004
    if vector.word_order is not None:
        _known_order(vector.word_order)
    return vector


def _known_order(order: object) -> WordOrder:
    if not isinstance(order, WordOrder):
        known = ", ".join(f"WordOrder.{name.value}" for name in WordOrder)
        raise ValueError(f"word order {order!r} is not one of {known}")  # noqa: TRY004
    return order


def _usual_order(register_map: RegisterMap) -> WordOrder:
    return WordOrder.ABCD if register_map.dialect.order == "big" else WordOrder.DCBA


def _given(block: Block, words: Mapping[int, str]) -> dict[int, int]:
    """Registers by offset."""
    if block.table.has_bits or block.packed:
        raise ValueError(f"block {block.name} has no registers, all its octets are needed")
    given: dict[int, int] = {}
    for address, text in words.items():
        octets = bytes.fromhex(text)
        first, count = address - block.address, len(octets) // 2
        if len(octets) % 2:
            raise ValueError(f"{text!r} is not a number of whole registers")
        if first < 0 or first + count > block.count:
            last = block.address + block.count - 1
            raise ValueError(
                f"registers {address} to {address + count - 1} are not all in block {block.name}, "
                f"{block.address} to {last}"
            )
        for index in range(count):
            if first + index in given:
                raise ValueError(f"register {address + index} is given twice")
            given[first + index] = int.from_bytes(octets[2 * index : 2 * index + 2])
    return given


def _is_known(block: Block, point: Point, given: Mapping[int, int]) -> bool:
    """Whether its words are given; those of a text up to its end."""
    for offset in range(point.offset, point.offset + block.size_of(point)):
        if offset not in given:
            return False
        if point.type is WordType.TEXT and 0 in given[offset].to_bytes(2):
            return True
    return True


def _certain(point: Point, known: Mapping[str, Point]) -> Iterator[str]:
    """Its fields, unless what it is valid with is not known."""
    gate = point.valid_when
    names = {name for other in known.values() for name in other.field_names}
    if gate is None or gate.point in names:
        yield from point.field_names


def _silent_points(register_map: RegisterMap) -> list[str]:
    return [
        f"block {block.name}: point {point.name}: has neither title nor unit nor named bits"
        for block in register_map.blocks
        for point in block.points
        if not (point.title or point.unit or point.bits or point.parts)
    ]


def _extreme_flaws(block: Block) -> Iterator[str]:
    """Words that a device can send must not raise, nor become a number that is none."""
    floats = {point.name for point in block.points if point.type.is_float}  # words may be NaN
    for word in _EXTREMES:
        fill = word & 1 if block.table.has_bits else word & 0xFF if block.packed else word
        where = f"block {block.name}: of words {word:#06x} only: "
        try:
            decoded = decode(block, [fill] * block.count)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            yield f"{where}{type(error).__name__}: {error}"
            continue
        if len(decoded.values) != len(field_names(block)):
            yield f"{where}{len(decoded.values)} values of {len(field_names(block))} fields"
        for name, value in named_values(block, decoded).items():
            if name not in floats and isinstance(value, float) and not math.isfinite(value):
                yield f"{where}{name} is {value}"


def _vector_flaws(register_map: RegisterMap, vector: Vector) -> Iterator[str]:
    where = f"{vector.source}: block {vector.block}: "
    try:
        found = decode_block(register_map, vector.block, vector.words, word_order=vector.word_order)
    except KeyError:
        yield f"{where}the map has no such block"
        return
    except ValueError as error:
        yield f"{where}{error}"
        return
    rounded = {p.name for p in register_map.block(vector.block).points if p.type is WordType.F32}
    if not vector.values:
        yield f"{where}no values, so that nothing is tested"
    for name, expected in vector.values.items():
        if name not in found:
            yield f"{where}{name}: there is no such field, or the words do not tell it"
        elif not _is_same(found[name], expected, is_rounded=name in rounded):
            yield f"{where}{name}: {found[name]!r}, not {expected!r}"


def _is_same(found: Value | None, expected: Value | None, *, is_rounded: bool) -> bool:
    if isinstance(found, float) and isinstance(expected, int | float):
        if math.isnan(found) or math.isnan(expected):
            return math.isnan(found) and math.isnan(expected)
        return math.isclose(found, expected, rel_tol=_ROUNDED if is_rounded else 0.0)
    return found == expected

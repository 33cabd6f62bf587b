"""Registers to numbers: types of one to four words, and the orders their octets are found in.

A packed block is a sequence of octets in place of words, and may hold a number at an odd one.
"""

from __future__ import annotations

import math
import struct
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final

from roclog.modbus.bits import pack_bits, unpack_bits
from roclog.register_map import WordOrder, WordType

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from roclog.register_map import Block, Point

CODES: Final = {
    WordType.U16: "H",
    WordType.S16: "h",
    WordType.U32: "I",
    WordType.S32: "i",
    WordType.U64: "Q",
    WordType.S64: "q",
    WordType.F32: "f",
    WordType.F64: "d",
    WordType.BCD16: "H",
    WordType.BCD32: "I",
    WordType.BCD64: "Q",
    WordType.MINUTES_SECONDS: "H",
    WordType.MONTH_DAY: "H",
    WordType.BIT: "H",
}
"""struct codes, big endian."""

_ROUNDS_TO_INFINITY: Final = 2.0**128 - 2.0**103
"""The smallest number that struct does not take for a binary32."""

Raw = int | float | bytes
"""What a point has in its words: a number, or the octets of a text."""


def effective_order(point: Point, device: WordOrder) -> WordOrder:
    """The point's own order; else the device's, which holds for numbers of several registers."""
    if point.word_order is not None:
        return point.word_order
    return device if point.type.words > 1 else WordOrder.ABCD


def block_reader(block: Block, order: WordOrder) -> Callable[[Sequence[int]], tuple[Any, ...]]:
    """A function from the words of a block to one Raw for each point."""
    return (_octet_reader if block.packed else _word_reader)(block, order)


def _word_reader(block: Block, order: WordOrder) -> Callable[[Sequence[int]], tuple[Any, ...]]:
    """As ``block_reader``, of registers or bits.

    All points are packed and unpacked at once: the words of each, most significant first, are
    picked from the block and from a copy of it with the octets of every word swapped.
    """
    picked: list[int] = []
    code, count = ">", block.count
    for point in block.points:
        own, size = effective_order(point, order), block.size_of(point)
        places = range(point.offset, point.offset + size)
        if own.words_reversed and not point.type.has_length:
            places = places[::-1]
        picked += [place + count * own.octets_swapped for place in places]
        code += f"{2 * size}s" if point.type.has_length else CODES[point.type]
    if not picked:
        return lambda words: ()  # noqa: ARG005 - a block of flags and stamps only
    plain, swapped = struct.Struct(f">{count}H"), struct.Struct(f"<{count}H")
    pack, unpack = struct.Struct(f">{len(picked)}H").pack, struct.Struct(code).unpack
    if picked == list(range(count)):
        return lambda words: unpack(pack(*words))
    if len(picked) == 1:
        picked *= 2  # itemgetter gives a tuple for two and more
        pack, unpack = struct.Struct(">2H").pack, struct.Struct(f"{code}2x").unpack
    pick: Callable[[Sequence[int]], tuple[int, ...]] = itemgetter(*picked)
    if max(picked, default=0) < count:
        return lambda words: unpack(pack(*pick(words)))
    return lambda words: unpack(pack(*pick((*words, *swapped.unpack(plain.pack(*words))))))


def _octet_reader(block: Block, order: WordOrder) -> Callable[[Sequence[int]], tuple[Any, ...]]:
    """As ``block_reader``, of octets: those of each number, most significant first, are picked."""
    picked: list[int] = []
    code = ">"
    for point in block.points:
        places = list(range(point.offset, point.offset + block.size_of(point)))
        if point.type.has_length:
            code += f"{len(places)}s"
        else:
            places = _in_order(places, point.word_order or order)
            code += CODES[point.type]
        picked += places
    unpack = struct.Struct(code).unpack
    return lambda octets: unpack(bytes([octets[place] for place in picked]))


def _in_order(places: list[int], order: WordOrder) -> list[int]:
    """Places of the octets of a number, the most significant first."""
    if order.words_reversed:
        places.reverse()
    if order.words_reversed != order.octets_swapped:
        places = [places[index ^ 1] for index in range(len(places))]
    return places


def number_reader(
    type_: WordType, offset: int, order: WordOrder, *, packed: bool = False
) -> Callable[[Sequence[int]], int | float]:
    """One number of a block, for a trigger or a time source. packed: as of the block."""
    if packed:
        octets = _in_order(list(range(offset, offset + 2 * type_.words)), order)
        unpack_from = struct.Struct(f">{CODES[type_]}").unpack

        def read_octets(words: Sequence[int]) -> int | float:
            number: int | float = unpack_from(bytes([words[place] for place in octets]))[0]
            return number

        return read_octets
    places = list(range(offset, offset + type_.words))
    if order.words_reversed:
        places.reverse()
    packing = struct.Struct(f"{'<' if order.octets_swapped else '>'}{len(places)}H")
    unpack = struct.Struct(f">{CODES[type_]}").unpack

    def read(words: Sequence[int]) -> int | float:
        number: int | float = unpack(packing.pack(*(words[place] for place in places)))[0]
        return number

    return read


def block_words(block: Block, octets: bytes) -> tuple[int, ...]:
    """The words of a block from the octets of answers.

    Of a block of bits each bit as 0 or 1, of a packed block the octets.

    Raises:
        ValueError: another number of octets than the block has.
    """
    if len(octets) != block.octets:
        raise ValueError(f"block {block.name} has {block.octets} octets, not {len(octets)}")
    if block.packed:
        return tuple(octets)
    if block.table.has_bits:
        return unpack_bits(octets, block.count)
    return struct.unpack(f">{block.count}H", octets)


def block_octets(block: Block, words: Sequence[int]) -> bytes:
    """What ``block_words`` has undone: the octets as on the wire."""
    if block.packed:
        return bytes(words)
    return pack_bits(words) if block.table.has_bits else struct.pack(f">{len(words)}H", *words)


def shortest_float32(number: float) -> float:
    """The number with the fewest digits among those that are this binary32: 0.1, not 0.100000001.

    NaN and infinities stay what they are.
    """
    octets = struct.pack(">f", number)
    for digits in range(1, 9):
        candidate = float(f"{number:.{digits}g}")
        if abs(candidate) < _ROUNDS_TO_INFINITY and struct.pack(">f", candidate) == octets:
            return candidate
    return float(f"{number:.9g}") if math.isfinite(number) else number

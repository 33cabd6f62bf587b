"""Registers to numbers: types of one to four words, and the orders their octets are found in."""

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


def word_reader(
    points: Sequence[Point], count: int, order: WordOrder
) -> Callable[[Sequence[int]], tuple[Any, ...]]:
    """A function from the ``count`` words of a block to one Raw for each point.

    All points are packed and unpacked at once: the words of each, most significant first, are
    picked from the block and from a copy of it with the octets of every word swapped.
    """
    picked: list[int] = []
    code = ">"
    for point in points:
        own = effective_order(point, order)
        places = range(point.offset, point.offset + point.size)
        if own.words_reversed and point.type is not WordType.TEXT:
            places = places[::-1]
        picked += [place + count * own.octets_swapped for place in places]
        code += f"{2 * point.size}s" if point.type is WordType.TEXT else CODES[point.type]
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


def number_reader(
    type_: WordType, offset: int, order: WordOrder
) -> Callable[[Sequence[int]], int | float]:
    """One number of a block, for a trigger or a time source."""
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
    """The words of a block from the octets of answers; of a block of bits, each bit as 0 or 1.

    Raises:
        ValueError: another number of octets than the block has.
    """
    if len(octets) != block.octets:
        raise ValueError(f"block {block.name} has {block.octets} octets, not {len(octets)}")
    if block.table.has_bits:
        return unpack_bits(octets, block.count)
    return struct.unpack(f">{block.count}H", octets)


def block_octets(block: Block, words: Sequence[int]) -> bytes:
    """What ``block_words`` has undone: the octets as on the wire."""
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

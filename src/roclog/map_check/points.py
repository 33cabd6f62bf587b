"""What every point of a register map must satisfy."""

from __future__ import annotations

import math
import re
import struct
from decimal import Decimal
from typing import TYPE_CHECKING, Final

from roclog.register_map import MAX_RANGED_POINTS, MAX_READ_REGISTERS, WordOrder, WordType

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.register_map import Block, Point

NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,47}")
"""Of points, bits and blocks."""
_NAME_RULE: Final = "1 to 48 of a-z, 0-9 and _, with a letter first"
RESERVED_NAMES: Final = frozenset(
    (
        "seq",
        "epoch",
        "origin",
        "redelivered",
        "asked_at",
        "read_at",
        "read_at_monotonic",
        "previous_read_at",
        "device_time",
        "time_flags",
        "doubtful",
        "raw",
        "missing",
        "answer_began_at",
        "log_time",
        "publish_time",
    )
)
"""Fields that every sample has; a point cannot be called so."""
_UNIT: Final = re.compile(r"[!-~]{0,32}")
_JUDGED: Final = frozenset({WordType.MINUTES_SECONDS, WordType.MONTH_DAY, WordType.TEXT})
"""Types of which some words are illegal, besides the decimal digits, which can be missing."""
_NO_NUMBERS: Final = frozenset({WordType.TEXT, WordType.OCTETS})
_MIN_SCALE: Final = Decimal("1e-30")
_MAX_SCALE: Final = Decimal("1e30")
_DIGITS: Final = {WordType.BCD16: 4, WordType.BCD32: 8, WordType.BCD64: 16}


def limits(type_: WordType) -> tuple[int, int]:
    """Smallest and largest number of an integer type, or of decimal digits."""
    if type_ is WordType.BIT:
        return 0, 1
    if type_.is_bcd:
        return 0, 10 ** _DIGITS[type_] - 1
    bits = 16 * type_.words
    if type_.value.startswith("int"):
        return -(1 << bits - 1), (1 << bits - 1) - 1
    return 0, (1 << bits) - 1


def named_keys(point: Point) -> Iterator[tuple[str, str]]:
    """(attribute, name) of every field of a point; of a bit with its number."""
    yield "name", point.name
    yield from ((f"bits.{bit}", name) for bit, name in point.bits)
    yield from ((f"bits.{first}-{first + size - 1}", name) for first, size, name in point.parts)


def point_flaws(point: Point, block: Block, index: int) -> Iterator[tuple[str, str]]:
    """(attribute, what is wrong with it), for the point at ``index`` of its block."""
    for key, name in named_keys(point):
        if not NAME.fullmatch(name) or name in RESERVED_NAMES:
            taken = name in RESERVED_NAMES
            why = ", every sample has a field of that name" if taken else f": {_NAME_RULE}"
            yield key, f"{name!r} cannot be a name{why}"
    size = block.size_of(point)
    if point.offset < 0 or size < 1 or point.offset + size > block.count:
        what = "bits" if block.table.has_bits else "octets" if block.packed else "words"
        text = f"offset {point.offset} with {size} {what} is outside the block, which has"
        yield "offset", f"{text} {block.count}"
    if size > MAX_READ_REGISTERS and not (block.table.has_bits or block.packed):
        text = f"{size} registers are longer than an answer, {MAX_READ_REGISTERS} registers"
        yield "words", f"{text}, so that its parts would be of different moments"
    if point.words and not point.type.has_length:
        yield "words", "only text and bytes have a number of words"
    if (point.type is WordType.BIT) != block.table.has_bits:
        bits = point.type is WordType.BIT
        hint = "; name the bits of a register with bits" if bits else ", those are bits"
        yield "type", f"{point.type} is not a type of {block.table.replace('_', ' ')}{hint}"
    if not _UNIT.fullmatch(point.unit):
        yield (
            "unit",
            f"unit {point.unit!r} is not UCUM: no blanks, degrees Celsius are Cel, micro is u",
        )
    judged = point.low is not None or point.type in _JUDGED
    if (judged or point.can_be_missing) and index >= MAX_RANGED_POINTS:
        text = (
            f"only the first {MAX_RANGED_POINTS} points of a block can have a range or be missing"
        )
        yield "offset", text
    yield from _order_flaws(point)
    yield from _scale_flaws(point)
    yield from _range_flaws(point)
    yield from _bit_flaws(point)
    yield from _meaning_flaws(point)
    yield from _sentinel_flaws(point)
    yield from _gate_flaws(point, block)


def _order_flaws(point: Point) -> Iterator[tuple[str, str]]:
    order = point.word_order
    if order is None:
        return
    if point.type is WordType.BIT:
        yield "word_order", "a bit has no order"
    elif point.type.words == 1 and order not in (WordOrder.ABCD, WordOrder.BADC):
        yield "word_order", f"{order} is not an order of one register or of text: ABCD or BADC"


def _scale_flaws(point: Point) -> Iterator[tuple[str, str]]:
    is_number = point.type.is_integer or point.type.is_float or point.type.is_bcd
    if point.scale is not None:
        if not (point.scale.is_finite() and _MIN_SCALE <= abs(point.scale) <= _MAX_SCALE):
            text = f"scale {point.scale} is not a number from {_MIN_SCALE} to {_MAX_SCALE}"
            yield "scale", f"{text}, with or without a minus"
        if not is_number:
            yield "scale", f"{point.type} cannot have a scale"
    if point.add is not None:
        if not (point.add.is_finite() and abs(point.add) <= _MAX_SCALE):
            yield "add", f"add {point.add} is not a number up to {_MAX_SCALE}"
        if not is_number:
            yield "add", f"nothing can be added to {point.type}"


def _bit_flaws(point: Point) -> Iterator[tuple[str, str]]:
    bits = [bit for bit, _ in point.bits]
    width = 16 * point.type.words
    outside = [bit for bit in bits if not 0 <= bit < width]
    yield from (("bits", f"bit {bit} is outside {width} bits") for bit in outside)
    for first, size, name in point.parts:
        if first < 0 or not 1 <= size <= 32 or first + size > width:
            yield "bits", f"{name}: bits {first} to {first + size - 1} are not 1 to 32 of {width}"
        else:
            bits += range(first, first + size)
    twice = sorted({bit for bit in bits if bits.count(bit) > 1})
    yield from (("bits", f"bit {bit}: named twice") for bit in twice)
    is_unsigned = point.type in (WordType.U16, WordType.U32, WordType.U64)
    if (point.bits or point.parts) and (point.is_scaled or not is_unsigned):
        yield "bits", "bits need an unscaled unsigned integer"


def _range_flaws(point: Point) -> Iterator[tuple[str, str]]:
    if (point.low is None) != (point.high is None):
        yield "range", "low and high go together"
    if point.low is None or point.high is None:
        return
    if not (point.low.is_finite() and point.high.is_finite()):
        yield "range", f"{point.low} to {point.high} is not a range"
        return
    if point.low > point.high:
        yield "range", f"low {point.low} is above high {point.high}"
    if point.type in _NO_NUMBERS or point.type is WordType.BIT:
        yield "range", f"{point.type} has no range"
    elif (point.type.is_integer or point.type.is_bcd) and not any(_scale_flaws(point)):
        ends = [end * (point.scale or 1) + (point.add or 0) for end in limits(point.type)]
        if max(ends) < point.low or point.high < min(ends):
            text = f"{point.type} is from {min(ends)} to {max(ends)}"
            yield "range", f"{point.low} to {point.high} is never reached, since this {text}"


def _meaning_flaws(point: Point) -> Iterator[tuple[str, str]]:
    values = [value for value, _ in point.meanings]
    twice = sorted({value for value in values if values.count(value) > 1})
    yield from (("meanings", f"{value}: two meanings") for value in twice)
    if values and (point.type in _NO_NUMBERS or point.type.is_float):
        yield "meanings", f"{point.type} is not an enumeration"
    elif point.type not in _JUDGED and not point.is_scaled:
        low, high = limits(point.type)
        outside = [value for value in values if not low <= value <= high]
        for value in outside:
            yield "meanings", f"{value} is never the value, {point.type} is from {low} to {high}"


def _sentinel_flaws(point: Point) -> Iterator[tuple[str, str]]:
    numbers = [number for number, _ in point.sentinels]
    if numbers and not (point.type.is_integer or point.type.is_float or point.type.is_bcd):
        yield "sentinels", f"{point.type} cannot have sentinels"
        return
    if numbers and (point.bits or point.parts):
        yield "sentinels", "a word of bits cannot have sentinels"
    for number in numbers:
        if numbers.count(number) > 1:
            yield "sentinels", f"sentinel {number}: given twice"
        elif not _fits(number, point.type):
            text = f"sentinel {number} is not a number of {point.type}"
            yield "sentinels", text + _sentinel_hint(number, point)


def _sentinel_hint(number: Decimal, point: Point) -> str:
    """What was meant, where words were written as unsigned, or a value for the number."""
    if not number.is_finite():
        return ""
    bits = 16 * point.type.words
    signed = number - (1 << bits)
    if point.type.value.startswith("int") and number > 0 and _fits(signed, point.type):
        return f"; these words are {signed}, or 0x{int(number):0{bits // 4}X}"
    if point.is_scaled and not any(_scale_flaws(point)):
        meant = (number - (point.add or 0)) / (point.scale or 1)
        like = f", like {meant:f}" if _fits(meant, point.type) else ""
        return f"; a sentinel is the number in the device, before scale and add{like}"
    return ""


def _fits(number: Decimal, type_: WordType) -> bool:
    if not (number.is_finite() and math.isfinite(number)):
        return False
    if type_.is_float:
        try:
            struct.pack(">f" if type_ is WordType.F32 else ">d", number)
        except OverflowError:  # the nearest number of the type is an infinity
            return False
        return True
    low, high = limits(type_)
    return number == int(number) and low <= number <= high


def _gate_flaws(point: Point, block: Block) -> Iterator[tuple[str, str]]:
    condition = point.valid_when
    if condition is None:
        return
    if point.type is WordType.TEXT:
        yield "valid_when", "text is always valid"
    owner = next((p for p in block.points if condition.point in p.field_names), None)
    if owner is None:
        yield "valid_when", f"no point {condition.point} in this block"
        return
    if owner.name == point.name:
        yield "valid_when", "a point cannot depend on itself"
    elif owner.can_be_missing:
        yield "valid_when", f"{condition.point} can be missing itself"
    if owner.is_scaled or not (owner.type.is_integer or owner.type is WordType.BIT):
        yield "valid_when", f"{condition.point} is not an unscaled integer or a bit"
        return
    if not condition.values:
        yield "valid_when", "no values, so it would never be valid"
    low, high = _field_limits(owner, condition.point)
    for value in condition.values:
        if not low <= value <= high:
            yield "valid_when", f"{condition.point} is never {value}"


def _field_limits(owner: Point, name: str) -> tuple[int, int]:
    """Of the point itself, one of its bits, or one of its parts."""
    if name == owner.name:
        return limits(owner.type)
    return 0, next(((1 << size) - 1 for _, size, part in owner.parts if part == name), 1)

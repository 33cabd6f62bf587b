"""Words in, values out. Pure, and never a refusal: what looks wrong is marked, not dropped."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from roclog.device_time import time_reader
from roclog.register_map import MAX_RANGED_POINTS, Block, Point, WordOrder, WordType
from roclog.time_flags import TimeFlag
from roclog.word_types import Raw, block_reader

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from decimal import Decimal

__all__ = ["Decoded", "TimeFlag", "Value", "decode", "field_names", "named_values", "scaled"]

Value = int | float | bool | str | bytes
_NO_FLAGS: Final = TimeFlag(0)
_DOUBTS: Final = (1 << MAX_RANGED_POINTS) - 1
"""Of points that come later only an infinity could be doubtful, and that can be seen."""
_KEPT_DECODERS: Final = 1024


class Decoded(NamedTuple):
    """The values of one block.

    values: one for each field of the block, in the order of ``block_fields``.
    doubtful: bit n is set where point n, one of the first 64, lies outside the range its document
    gives, is infinite, or has words that its type does not know.
    device_time: nanoseconds UTC, 0 = unknown (then time_flags say why, where the block has stamps).
    missing: bit n is set where point n is no measurement: a sentinel, a status that says so, or no
    decimal digits. Its value is then NaN; an unscaled integer is kept as read.
    """

    values: tuple[Value, ...]
    doubtful: int
    device_time: int
    time_flags: TimeFlag
    missing: int = 0


def field_names(block: Block) -> tuple[str, ...]:
    """Points in map order, each followed by its named bits and its parts."""
    return tuple(name for point in block.points for name in point.field_names)


def named_values(block: Block, decoded: Decoded) -> dict[str, Value | None]:
    """By field name; None where the measurement is missing."""
    values = iter(decoded.values)
    found: dict[str, Value | None] = {}
    for index, point in enumerate(block.points):
        there = not decoded.missing >> index & 1
        found |= {name: value if there else None for name, value in _take(point, values)}
    return found


def _take(point: Point, values: Iterator[Value]) -> list[tuple[str, Value]]:
    return [(name, next(values)) for name in point.field_names]


def decode(
    block: Block,
    words: Sequence[int],
    order: WordOrder = WordOrder.ABCD,
    *,
    read_at: int = 0,
    changed_after: int | None = None,
) -> Decoded:
    """Decode the words of one block, most significant octet of each register first.

    Args:
        block: what the words mean.
        words: of a block of coils or discrete inputs, each bit as 0 or 1; of a packed one, octets.
        order: the device's, for numbers of several registers.
        read_at: ns UTC, for stamps ahead of the host's clock or without a date; 0 = not known.
        changed_after: ns UTC at which a read still showed another stamp; None = not known.

    Raises:
        ValueError: not as many words as the block has; the bus has checked that before.
    """
    if len(words) != block.count:
        what = "octets" if block.packed else "words"
        raise ValueError(f"block {block.name} has {block.count} {what}, not {len(words)}")
    return _decoder(block, order).decode(words, read_at, changed_after)


def scaled(raw: float, scale: Decimal, add: Decimal | None = None) -> float:
    """The float nearest to the exact result, so that its shortest text is the decimal value."""
    return _Line(scale, add).value(raw)


class _Line:
    """value = number * scale + add, rounded once."""

    def __init__(self, scale: Decimal | None, add: Decimal | None) -> None:
        factor, summand = Fraction(scale if scale is not None else 1), Fraction(add or 0)
        denominator = math.lcm(factor.denominator, summand.denominator)
        self._factor = factor.numerator * (denominator // factor.denominator)
        self._summand = summand.numerator * (denominator // summand.denominator)
        self._denominator = denominator

    @property
    def terms(self) -> tuple[int, int, int]:
        """Factor and summand over one denominator."""
        return self._factor, self._summand, self._denominator

    def value(self, number: float) -> float:
        """NaN and infinities stay what they are."""
        if isinstance(number, int):
            return (number * self._factor + self._summand) / self._denominator
        if not math.isfinite(number):
            return number
        numerator, denominator = number.as_integer_ratio()
        total = numerator * self._factor + self._summand * denominator
        try:
            return total / (denominator * self._denominator)
        except OverflowError:
            return math.inf if total > 0 else -math.inf


class _Step:
    """What is to be done with the number of one point, where it is more than to keep it."""

    def __init__(self, point: Point) -> None:
        self._convert = _CONVERSIONS.get(point.type)
        self._is_bcd = point.type.is_bcd
        self._is_text = point.type is WordType.TEXT
        self._is_integer = point.type.is_integer
        self._is_float = point.is_scaled or point.type.is_float
        self._line = _Line(point.scale, point.add) if point.is_scaled else None
        self._sentinels = frozenset(_number(value, point.type) for value, _ in point.sentinels)
        self._bits = tuple(bit for bit, _ in point.bits)
        self._parts = tuple((first, (1 << size) - 1) for first, size, _ in point.parts)
        self._low: float | None = None
        self._high: float = 0
        if point.low is not None and point.high is not None and point.type is not WordType.TEXT:
            # Integers are compared as integers: 64 bits do not fit a float.
            self._low = float(point.low) if self._is_float else math.ceil(point.low)
            self._high = float(point.high) if self._is_float else math.floor(point.high)

    @property
    def scaling(self) -> tuple[int, int, int] | None:
        """(factor, summand, denominator) where an integer is scaled and nothing else."""
        more = self._convert or self._sentinels or self._bits or self._parts
        if self._line is None or more or self._low is not None or not self._is_integer:
            return None
        return self._line.terms

    def read(self, raw: Raw, values: list[Value]) -> tuple[bool, bool]:
        """Append the values of the point's fields; whether it is doubtful, and missing."""
        if isinstance(raw, bytes) and self._is_text:
            text, legal = _text(raw)
            values.append(text)
            return not legal, False
        if isinstance(raw, bytes):
            values.append(raw)
            return False, False
        number, legal = (raw, True) if self._convert is None else self._convert(raw)
        missing = number in self._sentinels or (self._is_bcd and not legal)
        value = number
        if missing and self._is_float:
            value = math.nan
        elif self._line is not None:
            value = self._line.value(number)
            legal = legal and not math.isinf(value)
        values.append(value)
        if self._bits or self._parts:
            pattern = int(number)
            values += [bool(pattern >> bit & 1) for bit in self._bits]
            values += [pattern >> first & mask for first, mask in self._parts]
        if legal and not missing and self._low is not None:
            legal = self._low <= value <= self._high or value != value  # noqa: PLR0124 - NaN
        return not legal, missing


def _number(value: Decimal, type_: WordType) -> int | float:
    """A number as the device has it: the nearest binary32 where that is the type."""
    if type_ is WordType.F32:
        nearest: float = struct.unpack(">f", struct.pack(">f", value))[0]
        return nearest
    return float(value) if type_ is WordType.F64 else int(value)


def _text(raw: bytes) -> tuple[str, bool]:
    """The text up to its end, and whether it is printable ASCII."""
    octets = raw.partition(b"\0")[0]
    return octets.decode("latin-1"), all(0x20 <= octet <= 0x7E for octet in octets)


def _finite(number: float) -> tuple[float, bool]:
    return number, not math.isinf(number)


def _decimal_digits(raw: float) -> tuple[float, bool]:
    digits = f"{int(raw):x}"
    return (int(digits), True) if digits.isdecimal() else (raw, False)


def _minutes_seconds(raw: float) -> tuple[float, bool]:
    minutes, seconds = divmod(int(raw), 256)
    return minutes * 60 + seconds, minutes < 60 and seconds < 60


def _month_day(raw: float) -> tuple[float, bool]:
    month, day = divmod(int(raw), 256)
    return month * 100 + day, raw == 0 or (1 <= month <= 12 and 1 <= day <= 31)


def _bit(raw: float) -> tuple[float, bool]:
    return bool(raw), True


_CONVERSIONS: Final[Mapping[WordType, Callable[[float], tuple[float, bool]]]] = {
    WordType.F32: _finite,
    WordType.F64: _finite,
    WordType.BCD16: _decimal_digits,
    WordType.BCD32: _decimal_digits,
    WordType.BCD64: _decimal_digits,
    WordType.MINUTES_SECONDS: _minutes_seconds,
    WordType.MONTH_DAY: _month_day,
    WordType.BIT: _bit,
}
"""The number, and whether the words are legal for its type; the other types take any words."""


def _is_plain(point: Point) -> bool:
    """Whether the number is the value, whatever it is; floats are looked at for infinities."""
    more = (point.bits, point.parts, point.sentinels, point.is_scaled, point.low is not None)
    return (point.type.is_integer or point.type.is_float) and not any(more)


class _BlockDecoder:
    """What never changes about the decoding of one block in one order."""

    def __init__(self, block: Block, order: WordOrder) -> None:
        self.block = block
        self._read = block_reader(block, order)
        self._steps = tuple(None if _is_plain(p) else _Step(p) for p in block.points)
        self._is_plain = not any(self._steps)
        self._terms = self._terms_of_scaling()
        self._floats = tuple(
            index
            for index, point in enumerate(block.points[:MAX_RANGED_POINTS])
            if point.type.is_float and self._steps[index] is None
        )
        self._gates = tuple(
            self._gate(index) for index, p in enumerate(block.points) if p.valid_when
        )
        self._time = time_reader(block.time, order, packed=block.packed)

    def _gate(self, index: int) -> tuple[int, int, frozenset[int], int | None]:
        """Bit of the point, place of the status, its good values, place of the value if a float."""
        point, names = self.block.points[index], field_names(self.block)
        condition = point.valid_when
        assert condition is not None
        is_float = point.is_scaled or point.type.is_float
        place = names.index(point.name) if is_float else None
        return 1 << index, names.index(condition.point), frozenset(condition.values), place

    def _terms_of_scaling(self) -> tuple[tuple[int, int, int] | None, ...]:
        """Of every point what scales it, None = nothing; empty where any point needs more.

        Most blocks are like this, and are then decoded in a fifth of the time.
        """
        terms = tuple(None if step is None else step.scaling for step in self._steps)
        more = any(s is not None and t is None for s, t in zip(self._steps, terms, strict=True))
        return () if more or self._is_plain else terms

    def decode(self, words: Sequence[int], read_at: int, changed_after: int | None) -> Decoded:
        raws = self._read(words)
        doubtful = missing = 0
        for index in self._floats:
            if math.isinf(raws[index]):
                doubtful |= 1 << index
        values: list[Any] = []
        if self._is_plain:
            values += raws
        elif self._terms:
            values += _scale_all(raws, self._terms)
        else:
            doubts, missing = self._step_by_step(raws, values)
            doubtful |= doubts
        for bit, status, good, place in self._gates:
            if values[status] not in good:
                missing |= bit
                doubtful &= ~bit
                if place is not None:
                    values[place] = math.nan
        if self._time is None:
            return Decoded(tuple(values), doubtful, 0, _NO_FLAGS, missing)
        device_time, flags = self._time(words, read_at, changed_after)
        return Decoded(tuple(values), doubtful, device_time, flags, missing)

    def _step_by_step(self, raws: Sequence[Any], values: list[Any]) -> tuple[int, int]:
        """Append all values; the masks of the doubtful and of the missing points."""
        doubtful = missing = 0
        for index, (raw, step) in enumerate(zip(raws, self._steps, strict=True)):
            if step is None:
                values.append(raw)
                continue
            doubt, absent = step.read(raw, values)
            doubtful |= doubt << index
            missing |= absent << index
        return doubtful & _DOUBTS, missing


def _scale_all(raws: Sequence[Any], terms: Sequence[tuple[int, int, int] | None]) -> list[Any]:
    return [
        raw if term is None else (raw * term[0] + term[1]) / term[2]
        for raw, term in zip(raws, terms, strict=True)
    ]


_decoders: dict[tuple[int, WordOrder], _BlockDecoder] = {}
"""By identity of the block, whose hash would cost more than the decoding; each keeps its block."""


def _decoder(block: Block, order: WordOrder) -> _BlockDecoder:
    key = (id(block), order)
    found = _decoders.get(key)
    if found is None:
        if len(_decoders) >= _KEPT_DECODERS:
            _decoders.clear()
        found = _decoders[key] = _BlockDecoder(block, order)
    return found


def why_missing(block: Block, words: Sequence[int], order: WordOrder) -> dict[str, str]:
    """By name of each point without a measurement, why there is none."""
    missing = decode(block, words, order).missing
    if not missing:
        return {}
    nothing: dict[str, Any] = dict.fromkeys(("scale", "add", "valid_when", "low", "high"))
    bare = tuple(replace(point, sentinels=(), **nothing) for point in block.points)
    stripped = replace(block, points=bare, time=None, trigger=None)
    numbers = dict(zip(field_names(block), decode(stripped, words, order).values, strict=True))
    gone = (point for index, point in enumerate(block.points) if missing >> index & 1)
    return {point.name: _reason(point, numbers) for point in gone}


def _reason(point: Point, numbers: Mapping[str, Value]) -> str:
    number, condition = numbers[point.name], point.valid_when
    for sentinel, text in point.sentinels:
        if _number(sentinel, point.type) == number:
            return text or f"{number} says so"
    if condition is not None and numbers[condition.point] not in condition.values:
        good = " or ".join(map(str, condition.values))
        return f"{condition.point} is {numbers[condition.point]!r}, valid with {good}"
    return "no decimal digits"


def word_order_doubts(block: Block, words: Sequence[int], order: WordOrder) -> list[str]:
    """What speaks against this word order; a warning for people, never a reason to swap words."""
    decoded = decode(block, words, order)
    values: dict[str, Any] = dict(zip(field_names(block), decoded.values, strict=True))
    doubts: list[str] = []
    for index, point in enumerate(block.points):
        follows = point.type.words > 1 and point.word_order is None
        if follows and point.low is not None and decoded.doubtful >> index & 1:
            span = f"{point.low} to {point.high}"
            doubts.append(f"{point.name} is {values[point.name]}, documented is {span}")
    for left, right in pairwise(block.must_not_increase):
        if values[right] > values[left]:
            doubts.append(f"{right} is larger than {left}")
    return doubts

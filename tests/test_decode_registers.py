"""Every type, order and mark, against printed manuals and against a second implementation."""

from __future__ import annotations

import math
import struct
import tomllib
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.decode import Decoded, TimeFlag, decode, field_names, named_values, why_missing
from roclog.register_map import (
    Block,
    Change,
    Cp32,
    Cp56,
    Point,
    SecondsMicroseconds,
    SplitCalendar,
    Table,
    UnixSeconds,
    ValidWhen,
    WordOrder,
    WordType,
)
from roclog.schema import Origin, sample_type
from roclog.word_types import block_octets, block_words, shortest_float32

if TYPE_CHECKING:
    from collections.abc import Callable

VECTORS = tomllib.loads(
    (Path(__file__).parent / "vectors/registers/manuals.toml").read_text(encoding="utf-8")
)
PROPERTY = settings(derandomize=True, deadline=None)
TIMES: dict[str, type[Any]] = {
    "unix": UnixSeconds,
    "unix_us": SecondsMicroseconds,
    "calendar": SplitCalendar,
    "cp56": Cp56,
}
word = st.integers(0, 0xFFFF)


def block(*points: Point, count: int = 8, **more: Any) -> Block:
    given = {"name": "b", "table": Table.HOLDING_REGISTERS, "address": 0, **more}
    return Block(count=count, points=points, **given)


def point(type_: WordType, offset: int = 0, name: str = "p", **more: Any) -> Point:
    return Point(name=name, offset=offset, type=type_, **more)


def only(a_point: Point, *words: int, order: WordOrder = WordOrder.ABCD) -> Decoded:
    return decode(block(a_point, count=len(words)), words, order)


# Manuals


@pytest.mark.parametrize("vector", VECTORS["value"], ids=lambda v: v["source"][:60])
def test_values_that_manuals_print(vector: dict[str, Any]) -> None:
    type_ = WordType(vector["type"])
    more: dict[str, Any] = {
        key: Decimal(str(vector[key])) for key in ("scale", "add") if key in vector
    }
    more["sentinels"] = tuple((Decimal(n), "none") for n in vector.get("sentinels", ()))
    made = point(type_, words=len(vector["words"]) * type_.has_length, **more)
    decoded = decode(
        block(made, count=len(vector["words"])),
        vector["words"],
        WordOrder(vector.get("word_order", "ABCD")),
    )
    assert bool(decoded.missing) == vector.get("missing", False)
    assert decoded.doubtful == 0
    (value,) = decoded.values
    if type_ is WordType.F32:
        assert isinstance(value, float)
        value = float(f"{value:.6g}")
    if isinstance(value, bytes):  # TOML has none, manuals print hexadecimal digits
        value = value.hex().upper()
    if not decoded.missing:
        assert value == vector["value"]
        assert type(value) is type(vector["value"])


def test_the_orders_of_one_point_and_of_the_device_say_the_same() -> None:
    for vector in VECTORS["value"]:
        if "word_order" in vector and "scale" not in vector:
            order, type_ = WordOrder(vector["word_order"]), WordType(vector["type"])
            own = only(point(type_, word_order=order), *vector["words"])
            assert own == only(point(type_), *vector["words"], order=order)


@pytest.mark.parametrize("vector", VECTORS["time"], ids=lambda v: v["source"][:60])
def test_times_that_manuals_print(vector: dict[str, Any]) -> None:
    given = dict(vector["time"])
    kind = TIMES[given.pop("kind")]
    if "word_order" in given:
        given["word_order"] = WordOrder(given["word_order"])
    decoded = decode(block(count=len(vector["words"]), time=kind(**given)), vector["words"])
    wanted = round(Decimal(str(vector["utc"].timestamp())) * 10**9)
    assert (decoded.device_time, decoded.time_flags) == (wanted, TimeFlag(0))


def test_every_type_and_order_has_a_vector() -> None:
    types = {vector["type"] for vector in VECTORS["value"]}
    assert types == {str(type_) for type_ in WordType} - {"bit"}
    orders = {vector["word_order"] for vector in VECTORS["value"] if "word_order" in vector}
    assert orders == {str(order) for order in WordOrder}


# A second implementation: octets put in order one by one, numbers made by hand

CODES = {
    "uint16": ">H",
    "int16": ">h",
    "uint32": ">I",
    "int32": ">i",
    "uint64": ">Q",
    "int64": ">q",
    "float32": ">f",
    "float64": ">d",
}
LETTERS: dict[str, Callable[[list[int]], list[int]]] = {
    "ABCD": lambda octets: octets,
    "CDAB": lambda octets: [o for pair in reversed(pairs(octets)) for o in pair],
    "BADC": lambda octets: [o for pair in pairs(octets) for o in reversed(pair)],
    "DCBA": lambda octets: list(reversed(octets)),
}


def pairs(octets: list[int]) -> list[list[int]]:
    return [octets[i : i + 2] for i in range(0, len(octets), 2)]


def encoded(type_: str, order: str, value: float) -> list[int]:
    """The registers of a value, by struct and by moving octets about."""
    octets = LETTERS[order](list(struct.pack(CODES[type_], value)))
    return [upper << 8 | lower for upper, lower in pairs(octets)]


def numbers(type_: str) -> st.SearchStrategy[float]:
    if type_.startswith("float"):
        return st.floats(width=32 if type_ == "float32" else 64)
    bits = int(type_.removeprefix("u").removeprefix("int"))
    low = 0 if type_[0] == "u" else -(2 ** (bits - 1))
    return st.integers(low, low + 2**bits - 1)


def same(left: object, right: object) -> bool:
    return left == right or (left != left and right != right)  # noqa: PLR0124 - NaN


@PROPERTY
@given(st.sampled_from(sorted(CODES)), st.sampled_from(sorted(LETTERS)), st.data())
def test_any_number_in_any_order(type_: str, order: str, data: st.DataObject) -> None:
    value = data.draw(numbers(type_))
    words = encoded(type_, order, value)
    made = point(WordType(type_), word_order=WordOrder(order))
    decoded = only(made, *words)
    assert same(decoded.values[0], value)
    assert type(decoded.values[0]) is type(value)
    assert bool(decoded.doubtful) == math.isinf(value)
    if len(words) > 1:
        assert only(point(WordType(type_)), *words, order=WordOrder(order)) == decoded or (
            value != value  # noqa: PLR0124 - NaN
        )


@PROPERTY
@given(st.data())
def test_points_side_by_side_do_not_disturb_each_other(data: st.DataObject) -> None:
    """Any mixture of types and orders in one block gives what each gives alone."""
    points, words, wanted = [], [], []
    for index in range(data.draw(st.integers(1, 12))):
        words += data.draw(st.lists(word, max_size=2))
        type_ = data.draw(st.sampled_from(sorted(CODES)))
        order = data.draw(st.sampled_from(sorted(LETTERS)))
        value = data.draw(numbers(type_))
        made = point(WordType(type_), len(words), f"p{index}", word_order=WordOrder(order))
        points.append(made)
        words += encoded(type_, order, value)
        wanted.append(value)
    decoded = decode(block(*points, count=len(words)), words, WordOrder.DCBA)
    assert all(same(a, b) for a, b in zip(decoded.values, wanted, strict=True))


decimals = st.decimals("-1e6", "1e6", places=4)


@PROPERTY
@given(
    st.sampled_from([t for t in sorted(CODES) if "int" in t]),
    st.decimals("0.0001", "1000", places=4),
    decimals,
    st.data(),
)
def test_scale_and_add_are_exact(
    type_: str, scale: Decimal, add: Decimal, data: st.DataObject
) -> None:
    value = data.draw(numbers(type_))
    decoded = only(point(WordType(type_), scale=scale, add=add), *encoded(type_, "ABCD", value))
    exact = Fraction(int(value)) * Fraction(scale) + Fraction(add)
    assert decoded.values[0] == float(exact)


@PROPERTY
@given(st.floats(width=32, allow_nan=False, allow_infinity=False), decimals)
def test_floats_are_scaled_as_exactly(value: float, add: Decimal) -> None:
    made = point(WordType.F32, scale=Decimal("0.1"), add=add)
    decoded = only(made, *encoded("float32", "ABCD", value))
    assert decoded.values[0] == float(Fraction(value) / 10 + Fraction(add))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_scaled_float_that_is_no_number_stays_what_it_is(value: float) -> None:
    made = point(WordType.F64, scale=Decimal(2), low=Decimal(0), high=Decimal(1))
    decoded = only(made, *encoded("float64", "ABCD", value))
    assert same(decoded.values[0], value)
    assert bool(decoded.doubtful) == math.isinf(value)
    assert not decoded.missing


def test_a_product_beyond_all_floats_is_infinite_and_kept() -> None:
    made = point(WordType.F64, scale=Decimal("1e30"))
    decoded = only(made, *encoded("float64", "ABCD", -1e300))
    assert (decoded.values, decoded.doubtful) == ((-math.inf,), 1)


@PROPERTY
@given(st.sampled_from([1, 2, 4]), st.data())
def test_decimal_digits(size: int, data: st.DataObject) -> None:
    words = data.draw(st.lists(word, min_size=size, max_size=size))
    text = "".join(f"{w:04x}" for w in words)
    decoded = only(point(WordType(f"bcd{16 * size}")), *words)
    if any(c in "abcdef" for c in text):
        assert (decoded.missing, decoded.doubtful) == (1, 1)
        assert decoded.values == (int(text, 16),)
    else:
        assert (decoded.missing, decoded.doubtful, decoded.values) == (0, 0, (int(text),))


@PROPERTY
@given(st.integers(0, 10**8 - 1), st.sampled_from(sorted(LETTERS)))
def test_decimal_digits_of_any_number(number: int, order: str) -> None:
    words = encoded("uint32", order, int(f"{number:08d}", 16))
    made = point(WordType.BCD32, word_order=WordOrder(order), scale=Decimal("0.1"))
    assert only(made, *words).values == (float(Fraction(number, 10)),)


@PROPERTY
@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=8), st.booleans())
def test_texts(text: str, swapped: object) -> None:
    octets = list(text.encode().ljust(8, b"\0"))
    words = [(b << 8 | a) if swapped else (a << 8 | b) for a, b in pairs(octets)]
    order = WordOrder.BADC if swapped else None
    assert only(point(WordType.TEXT, words=4, word_order=order), *words).values == (text,)
    # The device's order is one of numbers.
    if not swapped:
        plain = point(WordType.TEXT, words=4)
        assert only(plain, *words, order=WordOrder.DCBA).values == (text,)


@PROPERTY
@given(word, st.sampled_from(WordOrder))
def test_the_order_of_the_device_leaves_single_registers_alone(
    value: int, order: WordOrder
) -> None:
    assert only(point(WordType.U16), value, order=order).values == (value,)


@PROPERTY
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(LETTERS)))
def test_bits_and_parts(value: int, order: str) -> None:
    bits = tuple((n, f"b{n}") for n in (0, 5, 31))
    made = point(WordType.U32, bits=bits, parts=((6, 10, "mode"),), word_order=WordOrder(order))
    decoded = only(made, *encoded("uint32", order, value))
    pattern = f"{value:032b}"[::-1]
    expected = (value, *(pattern[n] == "1" for n in (0, 5, 31)), int(pattern[6:16][::-1], 2))
    assert decoded.values == expected
    assert field_names(block(made)) == ("p", "b0", "b5", "b31", "mode")


@PROPERTY
@given(st.lists(st.integers(0, 1), min_size=1, max_size=40))
def test_coils(bits: list[int]) -> None:
    made = block(
        *(point(WordType.BIT, n, f"p{n}") for n in range(len(bits))),
        count=len(bits),
        table=Table.COILS,
    )
    octets = bytes(
        sum(bit << n for n, bit in enumerate(bits[first : first + 8]))
        for first in range(0, len(bits), 8)
    )
    assert block_words(made, octets) == tuple(bits)
    assert block_octets(made, bits) == octets
    assert made.octets == len(octets)
    assert decode(made, bits).values == tuple(bit == 1 for bit in bits)


def test_the_example_of_function_1_in_the_specification() -> None:
    """V1.1b3 section 6.1: coils 20 to 38 are CD 6B 05."""
    made = block(point(WordType.BIT), count=19, table=Table.COILS)
    words = block_words(made, bytes.fromhex("CD6B05"))
    assert words[:8] == (1, 0, 1, 1, 0, 0, 1, 1)  # 27 to 20 are on-on-off-off-on-on-off-on
    assert words[16:] == (1, 0, 1)
    with pytest.raises(ValueError, match="has 3 octets, not 2"):
        block_words(made, b"\0\0")


# Missing measurements


STATUS = point(WordType.U16, 0, "status", bits=((0, "valid"),), parts=((4, 2, "mode"),))


def gated(condition: ValidWhen, *words: int, **more: Any) -> Decoded:
    made = block(
        STATUS,
        point(WordType.U16, 1, "scaled", scale=Decimal("0.1"), valid_when=condition, **more),
        point(WordType.U16, 2, "plain", valid_when=condition, bits=((0, "low"),)),
        count=3,
    )
    return decode(made, words)


def test_a_measurement_that_its_status_does_not_cover_is_missing() -> None:
    condition = ValidWhen(point="status", values=(0, 7))
    there = gated(condition, 7, 123, 9)
    assert (there.values[-3:], there.missing) == ((12.3, 9, True), 0)
    away = gated(condition, 1, 123, 9)
    assert math.isnan(float(away.values[3]))
    assert (away.values[4:], away.missing) == ((9, True), 0b110)


@pytest.mark.parametrize(
    ("name", "good", "bad"), [("valid", 0b000001, 0b000010), ("mode", 0b010000, 0b110001)]
)
def test_a_bit_or_a_part_can_be_the_status(name: str, good: int, bad: int) -> None:
    condition = ValidWhen(point=name, values=(1,))
    assert gated(condition, good, 1, 1).missing == 0
    assert gated(condition, bad, 1, 1).missing == 0b110


def test_what_is_missing_is_not_judged() -> None:
    condition = ValidWhen(point="status", values=(0,))
    limits = {"low": Decimal(0), "high": Decimal(1)}
    assert gated(condition, 0, 123, 9, **limits).doubtful == 0b10
    assert gated(condition, 1, 123, 9, **limits).doubtful == 0


def test_missing_values_have_no_name_to_read_them_by() -> None:
    made = block(
        STATUS,
        point(
            WordType.U16,
            1,
            "level",
            valid_when=ValidWhen(point="valid", values=(1,)),
            bits=((0, "low"),),
        ),
        count=2,
    )
    away = {"status": 0, "valid": False, "mode": 0, "level": None, "low": None}
    assert named_values(made, decode(made, [0, 3])) == away
    there = {"status": 1, "valid": True, "mode": 0, "level": 3, "low": True}
    assert named_values(made, decode(made, [1, 3])) == there


@pytest.mark.parametrize(
    ("type_", "sentinel", "value"),
    [
        (WordType.S16, "-32768", -32768),
        (WordType.U32, "4294967295", 2**32 - 1),
        (WordType.U64, str(2**64 - 1), 2**64 - 1),
        (WordType.F32, "-999.9", -999.9),
        (WordType.F64, "-999.9", -999.9),
    ],
)
def test_sentinels(type_: WordType, sentinel: str, value: float) -> None:
    made = point(type_, sentinels=((Decimal(sentinel), "no sensor"),))
    words = encoded(str(type_), "ABCD", value)
    decoded = only(made, *words)
    assert decoded.missing == 1
    kept = decoded.values[0]
    assert math.isnan(kept) if isinstance(kept, float) else kept == value
    words[-1] ^= 1
    assert only(made, *words).missing == 0


def test_a_large_integer_is_compared_with_its_range_exactly() -> None:
    made = point(WordType.U64, low=Decimal(0), high=Decimal(2**63))
    assert only(made, *encoded("uint64", "ABCD", 2**63)).doubtful == 0
    assert only(made, *encoded("uint64", "ABCD", 2**63 + 1)).doubtful == 1


# Times


@pytest.mark.parametrize(
    ("time", "words", "flag"),
    [
        (UnixSeconds(offset=0), [0, 0], TimeFlag.NO_TIME),
        (SecondsMicroseconds(seconds=0, microseconds=2), [0, 0, 0, 0], TimeFlag.NO_TIME),
        (SecondsMicroseconds(seconds=0, microseconds=2), [1, 1, 15, 16960], TimeFlag.DATE_INVALID),
        (SplitCalendar(year=0, month_day=1, hour=2), [0, 0, 0], TimeFlag.NO_TIME),
        (SplitCalendar(year=0, month_day=1, hour=2), [2026, 0x021E, 0], TimeFlag.DATE_INVALID),
        (
            SplitCalendar(year=0, month_day=1, hour=2, zone="Europe/Berlin"),
            [2026, 0x0A19, 2],
            TimeFlag.TIME_UNDECIDED,
        ),
        (Cp56(offset=0), [0, 0, 0, 0], TimeFlag.NO_TIME),
        (Cp32(offset=0), [0x0A00, 0x1E06], TimeFlag.DATE_UNKNOWN),
    ],
)
def test_stamps_that_give_no_time(time: Any, words: list[int], flag: TimeFlag) -> None:
    decoded = decode(block(count=len(words), time=time), words)
    assert decoded.device_time == 0
    assert flag in decoded.time_flags


def instant(text: str) -> int:
    return int(datetime.fromisoformat(text).astimezone(UTC).timestamp()) * 10**9


@pytest.mark.parametrize(
    ("time", "words", "text"),
    [
        (UnixSeconds(offset=0), [0xFFFF, 0xFFFF], "2106-02-07T06:28:15+00:00"),
        (UnixSeconds(offset=0, epoch=946_684_800), [0, 1], "2000-01-01T00:00:01+00:00"),
        (
            SplitCalendar(year_month=0, day_hour=1, minute_second=2, year_base=2000),
            [0x1802, 0x1D17, 0x3B3B],
            "2024-02-29T23:59:59+00:00",
        ),
        (SplitCalendar(year=0, month_day=1, hour=2), [2100, 0x021C, 23], "2100-02-28T23:00:00Z"),
        (SplitCalendar(year=0, month_day=1, hour=2), [2100, 0x021D, 23], None),
        (SplitCalendar(year=0, month_day=1, hour=2), [2024, 0x021D, 24], None),
        (SplitCalendar(year=0, month_day=1, hour=2), [2262, 0x040C, 0], None),
    ],
)
def test_times_at_their_edges(time: Any, words: list[int], text: str | None) -> None:
    decoded = decode(block(count=len(words), time=time), words)
    assert decoded.device_time == (0 if text is None else instant(text))
    assert decoded.time_flags == (TimeFlag.DATE_INVALID if text is None else TimeFlag(0))


@pytest.mark.parametrize(
    ("name", "largest"), [("millisecond", 999), ("millisecond_of_minute", 59_999)]
)
def test_the_last_millisecond(name: str, largest: int) -> None:
    place: dict[str, Any] = {name: 3}
    time = SplitCalendar(year=0, month_day=1, hour_minute=2, **place)
    day = [2024, 0x021D, 0x173B]
    decoded = decode(block(count=4, time=time), [*day, largest])
    assert decoded.device_time == instant("2024-02-29T23:59:00+00:00") + largest * 10**6
    decoded = decode(block(count=4, time=time), [*day, largest + 1])
    assert (decoded.device_time, decoded.time_flags) == (0, TimeFlag.DATE_INVALID)


def test_a_calendar_in_local_time() -> None:
    time = SplitCalendar(year=0, month_day=1, hour_minute=2, zone="Europe/Berlin")
    made = block(count=3, time=time)
    winter = decode(made, [2026, 0x0C18, 0x0C00])
    assert winter.device_time == instant("2026-12-24T12:00:00+01:00")
    summer = decode(made, [2026, 0x0618, 0x0C00])
    assert summer.device_time == instant("2026-06-24T12:00:00+02:00")


def test_a_stamp_without_a_date_is_dated_by_the_read() -> None:
    made = block(count=2, time=Cp32(offset=0), trigger=Change())
    read_at = instant("2026-11-23T00:05:00Z")
    words = [0x983A, 0x3B17]  # 23:59:15.000
    decoded = decode(made, words, read_at=read_at, changed_after=read_at - 600 * 10**9)
    assert decoded.device_time == instant("2026-11-22T23:59:15Z")
    assert decoded.time_flags == TimeFlag.DATE_INFERRED


@pytest.mark.parametrize(
    "time", [UnixSeconds(offset=0), SecondsMicroseconds(seconds=0, microseconds=2)]
)
def test_the_order_of_the_device_holds_for_seconds(time: Any) -> None:
    plain = decode(block(count=4, time=time), [0x522E, 0x5FD4, 0, 7])
    for order in WordOrder:
        words = encoded("uint32", order, 0x522E5FD4) + encoded("uint32", order, 7)
        assert decode(block(count=4, time=time), words, order) == plain


# Floats for people


@PROPERTY
@given(st.floats(width=32))
def test_the_shortest_text_names_the_same_float32(value: float) -> None:
    shown = shortest_float32(value)
    assert same(shown, value) or struct.pack(">f", shown) == struct.pack(">f", value)
    assert len(repr(shown)) <= len(repr(value))


def test_a_float32_is_shown_as_it_was_meant() -> None:
    for text in ("0.1", "22.17", "30.56", "12.34", "16777216.0", "3.4028235e+38", "1e-45"):
        (value,) = struct.unpack(">f", struct.pack(">f", float(text)))
        assert repr(shortest_float32(value)) == text


# Beyond the masks


def test_an_infinity_behind_the_first_64_points_is_a_value_without_a_mark() -> None:
    scale = {"scale": Decimal(2)}
    points = [point(WordType.F32, 2 * n, f"p{n}", **(scale if n % 2 else {})) for n in range(70)]
    made = block(*points, count=140)
    decoded = decode(made, [0x7F80, 0x0000] * 70)
    assert decoded.values == (math.inf,) * 70
    assert decoded.doubtful == 2**64 - 1
    assert decode(block(*points[::2], count=140), [0x7F80, 0x0000] * 70).doubtful == 2**35 - 1


def test_a_large_sample_with_infinities_can_be_recorded() -> None:
    points = [point(WordType.F32, 2 * n, f"p{n}", scale=Decimal(2)) for n in range(65)]
    made = block(*points, count=130, atomic=False)
    decoded = decode(made, [0, 0] * 64 + [0x7F80, 0x0000])
    kind = sample_type("registers", made)
    common = (1, b"e" * 16, Origin.CYCLIC, False, 1, 1, 1, 0, 0, 0, decoded.doubtful)
    octets = kind.pack(iter((*common, block_octets(made, [0] * 130), 1, *decoded.values)))
    assert octets.count(struct.pack("<d", math.inf)) == 1


# Why there is no measurement


def test_why_a_point_is_missing() -> None:
    half = {"scale": Decimal("0.5"), "sentinels": ((Decimal(-32768), "no sensor"),)}
    made = block(
        point(WordType.U16, 0, "status", bits=((3, "cold"),)),
        point(WordType.S16, 1, "level", **half),
        point(WordType.F32, 2, "flow", valid_when=ValidWhen(point="status", values=(0, 1))),
        point(WordType.U16, 4, "heat", valid_when=ValidWhen(point="cold", values=(0,))),
        point(WordType.BCD16, 5, "digits"),
    )
    words = [8, 0x8000, 0x3F80, 0x0000, 5, 0x00F0, 0, 0]
    assert why_missing(made, words, WordOrder.ABCD) == {
        "level": "no sensor",
        "flow": "status is 8, valid with 0 or 1",
        "heat": "cold is True, valid with 0",
        "digits": "no decimal digits",
    }
    assert why_missing(made, [0, 1, 0, 0, 0, 1, 0, 0], WordOrder.ABCD) == {}


def test_the_largest_float_as_manuals_print_it_is_the_sentinel() -> None:
    flow = point(WordType.F32, sentinels=((Decimal("3.4028235e38"), "none"),))
    assert only(flow, 0x7F7F, 0xFFFF).missing == 1
    assert only(flow, 0x7F7F, 0xFFFE).missing == 0


def test_a_sign_can_be_turned_round() -> None:
    made = point(WordType.S16, scale=Decimal("-0.1"), low=Decimal(0), high=Decimal(5))
    assert only(made, 0xFFF6) == Decoded((1.0,), 0, 0, TimeFlag(0), 0)
    assert only(made, 0x000A) == Decoded((-1.0,), 1, 0, TimeFlag(0), 0)

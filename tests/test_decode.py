"""Words in, values out: exact decimals, marks instead of refusals."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.decode import TimeFlag, decode, field_names, scaled, word_order_doubts
from roclog.devices import PROFILES
from roclog.register_map import Block, Point, SplitCalendar, Table, WordOrder, WordType
from roclog.schema import sample_type

SAMPLE = PROFILES["hiac-roc"].block("sample")
PROPERTY = settings(derandomize=True, deadline=None)


def one(point: Point, *words: int, order: WordOrder = WordOrder.ABCD) -> tuple[object, bool]:
    """The value of a block of one point, and whether it is doubtful."""
    block = Block(
        name="one", table=Table.INPUT_REGISTERS, address=0, count=len(words), points=(point,)
    )
    decoded = decode(block, words, order)
    return decoded.values[0], bool(decoded.doubtful)


def exact(raw: int, scale: str) -> Decimal:
    return (raw * Decimal(scale)).normalize()


@pytest.mark.parametrize("scale", ["0.1", "0.01", "0.001", "0.5", "10"])
def test_the_text_of_every_16_bit_value_is_its_decimal(scale: str) -> None:
    for raw in range(-32768, 65536):
        assert Decimal(repr(scaled(raw, Decimal(scale)))) == exact(raw, scale)


def test_the_text_of_32_bit_hundredths_is_their_decimal() -> None:
    step = 104_729  # a prime, so that all endings occur
    for raw in [*range(0, 2**32, step), 57, 250_000_000, 2**32 - 1]:
        assert Decimal(repr(scaled(raw, Decimal("0.01")))) == exact(raw, "0.01")


@PROPERTY
@given(st.integers(0, 2**32 - 1), st.sampled_from(["0.1", "0.01", "0.001", "0.0001", "1", "60"]))
def test_the_text_of_any_32_bit_value_is_its_decimal(raw: int, scale: str) -> None:
    assert Decimal(repr(scaled(raw, Decimal(scale)))) == exact(raw, scale)


def test_a_scale_that_is_no_decimal_fraction_is_rounded_once() -> None:
    assert scaled(3, Decimal("0.1")) == 0.3
    assert scaled(1, Decimal("1e-30")) == 1e-30
    assert scaled(2**32 - 1, Decimal("1e30")) == float((2**32 - 1) * Decimal("1e30"))


@pytest.mark.parametrize(
    ("type_", "words", "value", "doubtful"),
    [
        (WordType.U16, [0xFFFF], 65535, False),
        (WordType.S16, [0x7FFF], 32767, False),
        (WordType.S16, [0x8000], -32768, False),
        (WordType.S16, [0xFFFF], -1, False),
        (WordType.U32, [0x0001, 0x0002], 65538, False),
        (WordType.U32, [0xFFFF, 0xFFFF], 2**32 - 1, False),
        (WordType.MINUTES_SECONDS, [0x3B3B], 3599, False),
        (WordType.MINUTES_SECONDS, [0x003C], 60, True),
        (WordType.MINUTES_SECONDS, [0x3C00], 3600, True),
        (WordType.MINUTES_SECONDS, [0xFFFF], 255 * 60 + 255, True),
        (WordType.MONTH_DAY, [0x0000], 0, False),
        (WordType.MONTH_DAY, [0x0101], 101, False),
        (WordType.MONTH_DAY, [0x0C1F], 1231, False),
        (WordType.MONTH_DAY, [0x0D01], 1301, True),
        (WordType.MONTH_DAY, [0x0120], 132, True),
        (WordType.MONTH_DAY, [0x0100], 100, True),
        (WordType.MONTH_DAY, [0x0001], 1, True),
    ],
)
def test_types(type_: WordType, words: list[int], value: int, *, doubtful: bool) -> None:
    assert one(Point(name="p", offset=0, type=type_), *words) == (value, doubtful)


def test_word_order() -> None:
    point = Point(name="p", offset=0, type=WordType.U32)
    assert one(point, 0x4142, 0x4344)[0] == 0x41424344
    assert one(point, 0x4344, 0x4142, order=WordOrder.CDAB)[0] == 0x41424344


@pytest.mark.parametrize(
    ("words", "text", "doubtful"),
    [
        ([0x3838, 0x3031, 0x0000], "8801", False),
        ([0x4100, 0x4243, 0x4445], "A", False),
        ([0x0041, 0x4243, 0x4445], "", False),
        ([0x4142, 0x4344, 0x4546], "ABCDEF", False),
        ([0x207E, 0, 0], " ~", False),
        ([0x1F41, 0, 0], "\x1fA", True),
        ([0x7F41, 0, 0], "\x7fA", True),
        ([0xB5FF, 0, 0], "\xb5\xff", True),
    ],
)
def test_text(words: list[int], text: str, *, doubtful: bool) -> None:
    assert one(Point(name="p", offset=0, type=WordType.TEXT, words=3), *words) == (text, doubtful)


@pytest.mark.parametrize(
    ("raw", "doubtful"), [(0, True), (99, True), (100, False), (105, False), (106, True)]
)
def test_ranges_are_inclusive_and_exact(raw: int, *, doubtful: bool) -> None:
    scale, low, high = Decimal("0.1"), Decimal("10.0"), Decimal("10.5")
    point = Point(name="p", offset=0, type=WordType.U16, scale=scale, low=low, high=high)
    assert one(point, raw)[1] == doubtful


def test_each_doubt_has_the_bit_of_its_point() -> None:
    words = [0] * SAMPLE.count
    for index, point in enumerate(SAMPLE.points):
        bad = list(words)
        bad[point.offset] = 0x7FFF
        assert decode(SAMPLE, bad).doubtful == 1 << index, point.name


def test_values_and_names_go_together() -> None:
    names = field_names(SAMPLE)
    values = decode(SAMPLE, [0] * 27).values
    assert len(names) == len(values) == 29
    bits = names.index("alarms")
    words = [0] * 27
    words[7] = 0b1010
    assert decode(SAMPLE, words).values[bits : bits + 5] == (10, False, True, False, True)


@pytest.mark.parametrize("count", [0, 26, 28])
def test_another_number_of_words_is_a_mistake_of_the_caller(count: int) -> None:
    with pytest.raises(ValueError, match="has 27 words"):
        decode(SAMPLE, [0] * count)


def stamp(fields: tuple[int, int, int, int, int, int]) -> list[int]:
    year, month, day, hour, minute, second = fields
    words = [0] * SAMPLE.count
    words[1:5] = [year, month << 8 | day, hour, minute << 8 | second]
    return words


@pytest.mark.parametrize(
    ("fields", "nanoseconds"),
    [
        ((2026, 11, 23, 6, 30, 15), 1_795_415_415 * 10**9),
        ((2000, 2, 29, 0, 0, 0), 951_782_400 * 10**9),
        ((1970, 1, 1, 0, 0, 1), 10**9),
        ((2262, 4, 11, 23, 47, 16), 9_223_372_036 * 10**9),
    ],
)
def test_device_time(fields: tuple[int, int, int, int, int, int], nanoseconds: int) -> None:
    decoded = decode(SAMPLE, stamp(fields))
    assert (decoded.device_time, decoded.time_flags) == (nanoseconds, TimeFlag(0))


@pytest.mark.parametrize(
    "fields",
    [
        (2026, 2, 29, 0, 0, 0),
        (2026, 0, 1, 0, 0, 0),
        (2026, 13, 1, 0, 0, 0),
        (2026, 1, 0, 0, 0, 0),
        (2026, 1, 1, 24, 0, 0),
        (2026, 1, 1, 0, 60, 0),
        (2026, 1, 1, 0, 0, 60),
        (0, 1, 1, 0, 0, 0),
        (0, 0, 0, 0, 0, 1),
        (1969, 12, 31, 23, 59, 59),
        (1970, 1, 1, 0, 0, 0),
        (2262, 4, 11, 23, 47, 17),
        (9999, 12, 31, 23, 59, 59),
        (10000, 1, 1, 0, 0, 0),
        (65535, 255, 255, 65535, 255, 255),
    ],
)
def test_stamps_that_give_no_device_time(fields: tuple[int, int, int, int, int, int]) -> None:
    decoded = decode(SAMPLE, stamp(fields))
    assert (decoded.device_time, decoded.time_flags) == (0, TimeFlag.DATE_INVALID)


def test_no_stamp_is_not_a_wrong_stamp() -> None:
    assert decode(SAMPLE, [0] * 27).time_flags is TimeFlag.NO_TIME
    without = replace(SAMPLE, time=None)
    assert decode(without, [0] * 27).time_flags == TimeFlag(0)


CLEAN = [0] * 8 + [0, 40_000, 0, 9_000, 0, 700, 0, 12] + [0] * 11


def swapped(words: list[int]) -> list[int]:
    result = list(words)
    for point in SAMPLE.points:
        if point.type is WordType.U32:
            first, second = words[point.offset : point.offset + 2]
            result[point.offset : point.offset + 2] = [second, first]
    return result


@pytest.mark.parametrize("order", [WordOrder.ABCD, WordOrder.CDAB])
def test_the_right_word_order_raises_no_doubt(order: WordOrder) -> None:
    words = CLEAN if order is WordOrder.ABCD else swapped(CLEAN)
    assert word_order_doubts(SAMPLE, words, order) == []
    assert word_order_doubts(SAMPLE, [0] * 27, order) == []


@pytest.mark.parametrize("order", [WordOrder.ABCD, WordOrder.CDAB])
def test_the_wrong_word_order_raises_doubts(order: WordOrder) -> None:
    words = swapped(CLEAN) if order is WordOrder.ABCD else list(CLEAN)
    doubts = word_order_doubts(SAMPLE, words, order)
    assert any(doubt.startswith("count_1 is ") and "documented" in doubt for doubt in doubts)


@pytest.mark.parametrize("order", [WordOrder.ABCD, WordOrder.CDAB])
def test_alarms_alone_betray_the_word_order(order: WordOrder) -> None:
    words = [0] * 27
    words[7 if order is WordOrder.ABCD else 6] = 320
    assert word_order_doubts(SAMPLE, words, order) == []
    wrong = WordOrder.CDAB if order is WordOrder.ABCD else WordOrder.ABCD
    assert word_order_doubts(SAMPLE, words, wrong) == [
        "alarms is 20971520, documented is 0 to 4095"
    ]


def test_counts_that_grow_with_size_raise_a_doubt() -> None:
    words = list(CLEAN)
    words[13] = 9_001
    assert word_order_doubts(SAMPLE, words, WordOrder.ABCD) == ["count_3 is larger than count_2"]


word = st.integers(0, 0xFFFF)


@PROPERTY
@given(st.lists(word, min_size=27, max_size=27), st.sampled_from(WordOrder))
def test_any_words_decode_and_can_be_recorded(words: list[int], order: WordOrder) -> None:
    decoded = decode(SAMPLE, words, order)
    word_order_doubts(SAMPLE, words, order)
    assert 0 <= decoded.device_time < 2**63
    kind = sample_type("hiac-roc", SAMPLE)
    signature = (1, bytes(16), 1, False, 0, 0, 0, 0, decoded.device_time, decoded.time_flags)
    kind.pack(iter((*signature, decoded.doubtful, bytes(54), 0, *decoded.values)))


@PROPERTY
@given(st.sampled_from(WordType), st.lists(word, min_size=4, max_size=4), st.booleans())
def test_any_words_of_any_type_decode(type_: WordType, words: list[int], scale: object) -> None:
    size = 2 if type_ is WordType.TEXT else type_.words
    scales = Decimal("1e30") if scale else None
    point = Point(name="p", offset=0, type=type_, words=2, scale=scales)
    one(point, *words[:size])


@PROPERTY
@given(st.lists(word, min_size=4, max_size=4))
def test_any_stamp_gives_a_time_or_a_reason(words: list[int]) -> None:
    time = SplitCalendar(year=0, month_day=1, hour=2, minute_second=3)
    block = Block(name="one", table=Table.INPUT_REGISTERS, address=0, count=4, points=(), time=time)
    decoded = decode(block, words)
    assert bool(decoded.device_time) != bool(decoded.time_flags)

"""Requests for blocks: everything is read once, nothing else is, and atomic blocks stay whole."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roclog.modbus.bits import ReadBits
from roclog.modbus.dialect import MSX_E
from roclog.modbus.functions import ReadFunction
from roclog.modbus.request import ReadRegisters
from roclog.register_map import Block, ClearOnRead, Point, SplitCalendar, Table, WordType
from roclog.request_plan import flag_request, plan_requests

if TYPE_CHECKING:
    from random import Random


def block(
    address: int, count: int, *, atomic: bool = False, table: Table = Table.HOLDING_REGISTERS
) -> Block:
    return Block(
        name=f"b{address}", table=table, address=address, count=count, points=(), atomic=atomic
    )


def spans(blocks: list[Block]) -> list[tuple[int, int, int]]:
    """(function, address, count) of every request."""
    return [
        (f.request.function, f.request.address, f.request.count)
        for f in plan_requests(blocks)
        if isinstance(f.request, ReadRegisters)
    ]


def test_neighbours_share_a_request() -> None:
    assert spans([block(10, 5), block(0, 10)]) == [(3, 0, 15)]


def test_atomic_blocks_and_other_tables_do_not() -> None:
    blocks = [block(0, 10, atomic=True), block(10, 5), block(15, 1, table=Table.INPUT_REGISTERS)]
    assert spans(blocks) == [(3, 0, 10), (3, 10, 5), (4, 15, 1)]


def test_a_hole_is_not_read() -> None:
    assert spans([block(0, 10), block(11, 5)]) == [(3, 0, 10), (3, 11, 5)]


def test_a_large_block_is_split_at_the_limit_of_an_answer() -> None:
    assert spans([block(100, 300)]) == [(3, 100, 125), (3, 225, 125), (3, 350, 50)]


def large(*points: Point, count: int = 300, **more: Any) -> Block:
    return replace(block(100, count), points=points, **more)


def test_a_value_is_not_cut_in_two() -> None:
    total = Point(name="total", offset=124, type=WordType.U32)
    assert spans([large(total)]) == [(3, 100, 124), (3, 224, 125), (3, 349, 51)]
    text = Point(name="text", offset=20, type=WordType.TEXT, words=120)
    assert spans([large(text)]) == [(3, 100, 20), (3, 120, 125), (3, 245, 125), (3, 370, 30)]


def test_a_time_is_not_cut_in_two() -> None:
    year = Point(name="year", offset=123, type=WordType.U32)
    time = SplitCalendar(year=124, month=125, day=126, hour=130)
    assert spans([large(year, time=time)])[:2] == [(3, 100, 123), (3, 223, 125)]


def test_a_value_is_not_cut_behind_a_neighbour_either() -> None:
    total = Point(name="total", offset=0, type=WordType.U64)
    blocks = [block(0, 122), replace(block(122, 300), points=(total,))]
    assert spans(blocks) == [(3, 0, 122), (3, 122, 125), (3, 247, 125), (3, 372, 50)]


def test_a_value_longer_than_an_answer_has_no_request() -> None:
    text = Point(name="text", offset=7, type=WordType.TEXT, words=126)
    with pytest.raises(ValueError, match="a value at 7 is longer than an answer"):
        plan_requests([large(text)])


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 125)), min_size=1, max_size=30))
def test_whatever_the_values_each_comes_in_one_answer(shapes: list[tuple[int, int]]) -> None:
    points: list[Point] = []
    at = 0
    for gap, words in shapes:
        at += gap
        points.append(Point(name="p", offset=at, type=WordType.OCTETS, words=words))
        at += words
    made = replace(block(0, at), points=tuple(points))
    requests = spans([block(at, 40), made])
    assert sum(count for _, _, count in requests) == at + 40
    assert all(1 <= count <= 125 for _, _, count in requests)
    for point in points:
        first, end = point.offset, point.offset + point.words
        assert any(a <= first and end <= a + count for _, a, count in requests)


def test_more_bits_than_an_answer_has_fill_the_octets_of_all_but_the_last() -> None:
    fetches = plan_requests([block(7, 4005, table=Table.COILS)])
    requests = [ReadBits(1, 7, 2000), ReadBits(1, 2007, 2000), ReadBits(1, 4007, 5)]
    assert [fetch.request for fetch in fetches] == requests
    parts = [(part.start, part.stop) for fetch in fetches for part in fetch.parts]
    assert parts == [(2, 252), (2, 252), (2, 3)]


def test_a_flag_outside_its_block_is_a_register_or_a_bit() -> None:
    flag = ClearOnRead(table=Table.HOLDING_REGISTERS, address=2)
    assert flag_request(flag) == ReadRegisters(3, 2, 1)
    assert flag_request(replace(flag, table=Table.DISCRETE_INPUTS)) == ReadBits(2, 2, 1)


def test_an_odd_structure_is_asked_for_in_words_and_comes_whole() -> None:
    one = Block(
        name="odd",
        table=Table.HOLDING_REGISTERS,
        address=15450,
        count=133,
        points=(),
        packed=True,
    )
    (fetch,) = plan_requests([one], MSX_E)
    assert fetch.request.pdu.hex(" ") == "03 3c 5a 00 42"
    assert fetch.request.head == b"\x03\x85"
    (part,) = fetch.parts
    assert (part.start, part.stop) == (2, 135)
    (fetch,) = plan_requests([replace(one, address=103)], MSX_E)
    assert fetch.request.head == b"\x03\x00\x85"
    (part,) = fetch.parts
    assert (part.start, part.stop) == (3, 136)


def test_a_block_that_fits_is_not_cut() -> None:
    assert spans([block(0, 100), block(100, 50)]) == [(3, 0, 100), (3, 100, 50)]


blocks_strategy = st.lists(
    st.tuples(st.integers(0, 20), st.integers(1, 300), st.booleans(), st.sampled_from(Table)),
    min_size=1,
    max_size=8,
)


@given(blocks_strategy, st.randoms(use_true_random=False))
def test_every_register_arrives_once_and_in_order(
    shapes: list[tuple[int, int, bool, Table]], random: Random
) -> None:
    at = 0
    blocks = []
    for gap, count, atomic, table in shapes:
        if table.read_function < 3:
            continue  # bits are never joined or split
        at += gap
        blocks.append(block(at, min(count, 125) if atomic else count, atomic=atomic, table=table))
        at += count
    random.shuffle(blocks)
    found: dict[int, list[int]] = {}
    for fetch in plan_requests(blocks):
        request = fetch.request
        assert isinstance(request, ReadRegisters)
        assert fetch.parts[0].start == 2
        assert fetch.parts[-1].stop == request.answer_size
        for before, after in zip(fetch.parts, fetch.parts[1:], strict=False):
            assert before.stop == after.start
        for part in fetch.parts:
            here = blocks[part.block]
            assert request.function == here.table.read_function
            assert not here.atomic or len(fetch.parts) == 1
            first = request.address + (part.start - 2) // 2
            found.setdefault(part.block, []).extend(
                range(first, first + (part.stop - part.start) // 2)
            )
    assert found == {
        index: list(range(b.address, b.address + b.count)) for index, b in enumerate(blocks)
    }


def test_functions_are_called_one_by_one() -> None:
    """Those of the MSX-E, whose numbers touch only by chance."""
    blocks = [block(15000, 2), block(15002, 96), block(1, 2)]
    for order in ("big", "little"):
        dialect = replace(MSX_E, order=order)
        found = plan_requests(blocks, dialect)
        assert [fetch.request for fetch in found] == [
            ReadFunction(b.address, b.count, dialect=dialect) for b in blocks
        ]
        parts = [(part.block, part.start, part.stop) for f in found for part in f.parts]
        assert parts == [(0, 2, 6), (1, 2, 194), (2, 3, 7)]

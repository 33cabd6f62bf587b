"""Packed blocks: structures of octets as a function answers them, at odd offsets and of odd size.

The second implementation is struct without alignment, which is how such a structure is declared in
C; the 133 octets, and a stamp of microseconds before seconds, are those of the vendor's client.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.decode import TimeFlag, decode, field_names, named_values
from roclog.register_map import (
    Block,
    Change,
    Counter,
    Point,
    SecondsMicroseconds,
    Table,
    UnixSeconds,
    WordOrder,
    WordType,
)
from roclog.schema import MessageType, sample_type
from roclog.triggers import Known, judge
from roclog.word_types import block_octets, block_words

PROPERTY = settings(derandomize=True, deadline=None, max_examples=200)
BIG, LITTLE = WordOrder.ABCD, WordOrder.DCBA
MARKS = {BIG: ">", LITTLE: "<"}
CODES = {
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float32": "f",
    "float64": "d",
}


def packed(*points: Point, count: int, **more: Any) -> Block:
    table = Table.HOLDING_REGISTERS
    return Block(
        name="one", table=table, address=15450, count=count, points=points, packed=True, **more
    )


def point(name: str, offset: int, type_: WordType, words: int = 0, **more: Any) -> Point:
    return Point(name=name, offset=offset, type=type_, words=words, **more)


STRUCTURE = packed(
    point("id", 0, WordType.OCTETS, 1),
    point("serial", 1, WordType.U32),
    point("name", 5, WordType.TEXT, 32),
    point("level", 37, WordType.S16),
    point("gain", 39, WordType.F32),
    point("microseconds", 43, WordType.U32),
    point("seconds", 47, WordType.U32),
    point("wide", 51, WordType.F64),
    point("small", 59, WordType.U16),
    point("large", 61, WordType.U64),
    point("signed", 78, WordType.S32),
    point("rest", 82, WordType.OCTETS, 51),
    count=133,
    time=SecondsMicroseconds(microseconds=43, seconds=47),
)
VALUES = {
    "id": b"\x07",
    "serial": 0x01020304,
    "name": "LVDT 5",
    "level": -2,
    "gain": 0.5,
    "microseconds": 250_000,
    "seconds": 1_413_547_200,
    "wide": -1e300,
    "small": 0xFEFF,
    "large": 2**63 + 1,
    "signed": -70_000,
    "rest": bytes(range(51)),
}


def structure(order: WordOrder) -> bytes:
    numbers = {k: v for k, v in VALUES.items() if not isinstance(v, bytes | str)}
    return struct.pack(
        f"{MARKS[order]}c I 32s h f 2I d H Q 9x i 51s",
        VALUES["id"],
        numbers["serial"],
        b"LVDT 5",
        *(numbers[k] for k in ("level", "gain", "microseconds", "seconds", "wide", "small")),
        numbers["large"],
        numbers["signed"],
        VALUES["rest"],
    )


@pytest.mark.parametrize("order", MARKS)
def test_every_field_of_an_odd_structure(order: WordOrder) -> None:
    octets = structure(order)
    assert len(octets) == 133
    words = block_words(STRUCTURE, octets)
    decoded = decode(STRUCTURE, words, order)
    assert named_values(STRUCTURE, decoded) == VALUES
    assert decoded.device_time == 1_413_547_200_250_000_000
    assert (decoded.time_flags, decoded.doubtful, decoded.missing) == (TimeFlag(0), 0, 0)
    assert block_octets(STRUCTURE, words) == octets


@pytest.mark.parametrize("size", [0, 132, 134])
def test_another_size_is_no_answer(size: int) -> None:
    with pytest.raises(ValueError, match="has 133 octets"):
        block_words(STRUCTURE, bytes(size))
    with pytest.raises(ValueError, match="has 133 octets"):
        decode(STRUCTURE, bytes(size))


def test_a_stamp_that_is_none() -> None:
    block = packed(count=8, time=SecondsMicroseconds(microseconds=0, seconds=4))
    assert decode(block, bytes(8)).time_flags == TimeFlag.NO_TIME
    late = struct.pack(">II", 1_000_000, 5)
    assert decode(block, late).time_flags == TimeFlag.DATE_INVALID
    unix = packed(count=5, time=UnixSeconds(offset=1))
    assert decode(unix, b"\xff\0\0\0\x02").device_time == 2 * 10**9
    assert decode(unix, b"\xff\x02\0\0\0", LITTLE).device_time == 2 * 10**9


def test_the_order_of_one_point_is_its_own() -> None:
    numbers = [point(str(order).lower(), 1, WordType.U32, word_order=order) for order in WordOrder]
    found = [decode(packed(one, count=5), b"\0ABCD", LITTLE).values[0] for one in numbers]
    said = dict(zip(WordOrder, found, strict=True))
    assert said[WordOrder.ABCD] == int.from_bytes(b"ABCD")
    assert said[WordOrder.CDAB] == int.from_bytes(b"CDAB")
    assert said[WordOrder.BADC] == int.from_bytes(b"BADC")
    assert said[WordOrder.DCBA] == int.from_bytes(b"DCBA")


field = st.sampled_from([*CODES, "bytes", "text"])
octets = st.binary(min_size=250, max_size=250)


@PROPERTY
@given(st.lists(field, min_size=1, max_size=20), octets, st.sampled_from([BIG, LITTLE]))
def test_any_layout_is_what_struct_reads(types: list[str], data: bytes, order: WordOrder) -> None:
    points: list[Point] = []
    wanted: list[Any] = []
    at = 0
    for index, type_ in enumerate(types):
        size = 3 if type_ in ("bytes", "text") else struct.calcsize(CODES[type_])
        points.append(point(f"p{index}", at, WordType(type_), 3 if type_ not in CODES else 0))
        part = data[at : at + size]
        if type_ == "bytes":
            wanted.append(part)
        elif type_ == "text":
            wanted.append(part.partition(b"\0")[0].decode("latin-1"))
        else:
            wanted += struct.unpack(MARKS[order] + CODES[type_], part)
        at += size
    block = packed(*points, count=at)
    decoded = decode(block, block_words(block, data[:at]), order)
    for value, other in zip(decoded.values, wanted, strict=True):
        assert value == other or (math.isnan(value) and math.isnan(other))  # type: ignore[arg-type]
    read_back(block, data[:at], decoded.values, decoded.doubtful)


def message_class(kind: MessageType) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor_set).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(kind.name))


def read_back(block: Block, raw: bytes, values: tuple[Any, ...], doubtful: int) -> None:
    """The message, read by the protobuf library from its own descriptor."""
    kind = sample_type("msx-e3317", block)
    signature = (1, bytes(16), 1, False, 0, 0, 0, 0, 0, 0, doubtful)
    message = message_class(kind).FromString(kind.pack(iter((*signature, raw, 0, *values))))
    assert message.raw == raw
    for name, value in zip(field_names(block), values, strict=True):
        found = getattr(message, name)
        assert type(found) is type(value)
        assert found == value or math.isnan(found)


def test_a_message_refuses_octets_of_another_size_with_text_too() -> None:
    text, octets = point("t", 0, WordType.TEXT, 3), point("o", 3, WordType.OCTETS, 3)
    with pytest.raises(ValueError, match="2 octets where 3 belong"):
        read_back(packed(text, octets, count=6), bytes(6), ("abc", b"ab"), 0)
    with pytest.raises(ValueError, match="zip"):
        read_back(packed(text, octets, count=6), bytes(6), ("abc",), 0)


@pytest.mark.parametrize("order", MARKS)
def test_a_counter_at_an_odd_octet(order: WordOrder) -> None:
    counter = point("n", 1, WordType.U32)
    block = packed(counter, count=5, trigger=Counter(point="n"))

    def answer(number: int) -> tuple[int, ...]:
        return block_words(block, struct.pack(f"{MARKS[order]}BI", 9, number))

    known, found = judge(block, Known(), answer(2**32 - 2), order)
    assert found.origin is not None
    known, found = judge(block, known, answer(2**32 - 2), order)
    assert found.origin is None
    known, found = judge(block, known, answer(1), order)
    assert (known.seq, found.missed) == (2, 2)


def test_a_change_of_some_octets() -> None:
    block = packed(point("n", 1, WordType.U16), count=4, trigger=Change(payload=((1, 2),)))
    known, _ = judge(block, Known(), (0, 1, 2, 3))
    assert known.payload == b"\x01\x02"
    assert judge(block, known, (9, 1, 2, 9))[1].origin is None
    assert judge(block, known, (9, 1, 3, 9))[1].origin is not None

"""Our packing against the official protobuf runtime, and the promises of the descriptors."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.devices import PROFILES
from roclog.register_map import Block, Point, Table, WordType
from roclog.schema import (
    CLEAR,
    GAP,
    LINK,
    MISSING,
    SIGNATURE,
    Field,
    Kind,
    MessageType,
    Origin,
    block_fields,
    read_signature,
    sample_type,
)

if TYPE_CHECKING:
    from google.protobuf.message import Message

SAMPLE = sample_type("hiac-roc", PROFILES["hiac-roc"].block("sample"))
OF_FIXED_SIZE = [SAMPLE, CLEAR, LINK]
TYPES = [*OF_FIXED_SIZE, GAP]
ALL_TYPES = pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.name)
ALL_OF_FIXED_SIZE = pytest.mark.parametrize("kind", OF_FIXED_SIZE, ids=lambda kind: kind.name)
PROPERTY = settings(derandomize=True, deadline=None)


def runtime(kind: MessageType) -> type[Message]:
    """The class that the official runtime makes of the descriptor in a recording."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor_set).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(kind.name))


RUNTIMES = {kind.name: runtime(kind) for kind in TYPES}
EXTREMES: dict[Kind, list[Any]] = {
    Kind.DOUBLE: [0.0, -0.0, 0.1, -1e308, 5e-324, math.inf, -math.inf, math.nan],
    Kind.UINT64: [0, 1, 2**63, 2**64 - 1],
    Kind.INT64: [0, -1, 2**63 - 1, -(2**63)],
    Kind.UINT32: [0, 1, 2**31, 2**32 - 1],
    Kind.INT32: [0, -1, 2**31 - 1, -(2**31)],
    Kind.BOOL: [False, True],
}


def strategy(field: Field) -> st.SearchStrategy[Any]:
    if field.kind is Kind.OCTETS:
        return st.binary(min_size=field.size, max_size=field.size)
    if field.kind is Kind.TEXT:
        return st.text()
    if field.enum is not None:
        return st.sampled_from(field.enum)
    return st.sampled_from(EXTREMES[field.kind])


def values_of(kind: MessageType) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.tuples(*(strategy(field) for field in kind.fields))


def same(left: object, right: object) -> bool:
    if isinstance(left, float) and isinstance(right, float):
        return struct.pack("<d", left) == struct.pack("<d", right)
    return left == right


@ALL_TYPES
@PROPERTY
@given(data=st.data())
def test_the_runtime_reads_what_we_pack(kind: MessageType, data: st.DataObject) -> None:
    values = data.draw(values_of(kind))
    packed = kind.pack(iter(values))
    message = RUNTIMES[kind.name].FromString(packed)
    for field, value in zip(kind.fields, values, strict=True):
        assert same(getattr(message, field.name), value), field.name
    assert len(packed) == kind.size or kind is GAP


@ALL_OF_FIXED_SIZE
@PROPERTY
@given(data=st.data())
def test_unpack_is_the_inverse_of_pack(kind: MessageType, data: st.DataObject) -> None:
    values = data.draw(values_of(kind))
    packed = kind.pack(iter(values))
    for tail in (b"", b"more"):
        found = kind.unpack(packed + tail)
        assert found is not None
        assert list(found) == [field.name for field in kind.fields]
        assert all(same(a, b) for a, b in zip(found.values(), values, strict=True))
    assert kind.unpack(packed[:-1]) is None
    assert kind.unpack(b"\xff" + packed[1:]) is None


@ALL_OF_FIXED_SIZE
def test_every_field_is_written_even_where_it_is_zero(kind: MessageType) -> None:
    zero = [bytes(f.size) if f.kind is Kind.OCTETS else 0 for f in kind.fields]
    packed = kind.pack(iter(zero))
    message = RUNTIMES[kind.name].FromString(packed)
    assert len(packed) == kind.size > len(message.SerializeToString())


@PROPERTY
@given(values_of(SAMPLE))
def test_the_signature_of_any_sample(values: tuple[Any, ...]) -> None:
    packed = SAMPLE.pack(iter(values))
    found = read_signature(packed)
    assert found is not None
    names = [field.name for field in SIGNATURE] + ["raw"]
    assert list(found.items()) == list(zip(names, values[: len(names)], strict=True))
    assert read_signature(packed[:100]) is None


@pytest.mark.parametrize("count", [1, 27, 63, 64, 125])
def test_the_raw_octets_of_blocks_of_any_size(count: int) -> None:
    point = Point(name="p", offset=0, type=WordType.U16)
    block = Block(name="b", table=Table.INPUT_REGISTERS, address=0, count=count, points=(point,))
    kind = sample_type("x", block)
    raw = bytes(index & 0xFF for index in range(2 * count))
    values = [bytes(16) if field.name == "epoch" else 0 for field in SIGNATURE]
    packed = kind.pack(iter([*values, raw, 1, 7]))
    assert runtime(kind).FromString(packed).raw == raw  # type: ignore[attr-defined]
    found = read_signature(packed)
    assert found is not None
    assert found["raw"] == raw


@PROPERTY
@given(st.binary(max_size=400))
def test_anything_else_has_no_signature(data: bytes) -> None:
    assert read_signature(data) is None
    assert SAMPLE.unpack(data) is None


@PROPERTY
@given(st.integers(0, 400), st.binary(max_size=8))
def test_a_bent_sample_never_raises(at: int, junk: bytes) -> None:
    zero = [bytes(f.size) if f.kind is Kind.OCTETS else 0 for f in SAMPLE.fields]
    packed = SAMPLE.pack(iter(zero))
    bent = packed[:at] + junk + packed[at + len(junk) :]
    found = read_signature(bent)
    assert found is None or found["raw"] is not None
    SAMPLE.unpack(bent)


@ALL_TYPES
def test_what_cannot_be_packed(kind: MessageType) -> None:
    other = {Kind.OCTETS: b"", Kind.TEXT: ""}
    good = [bytes(f.size) if f.size else other.get(f.kind, 0) for f in kind.fields]
    with pytest.raises(ValueError):
        kind.pack(iter(good[:-1]))
    with pytest.raises(ValueError):
        kind.pack(iter([*good, 0]))
    for index, field in enumerate(kind.fields):
        bad = list(good)
        if field.kind is Kind.OCTETS:
            for size in (0, field.size - 1, field.size + 1):
                bad[index] = bytes(size)
                with pytest.raises(ValueError, match="octets where"):
                    kind.pack(iter(bad))
        elif field.kind in (Kind.UINT32, Kind.UINT64):
            bad[index] = -1
            with pytest.raises(struct.error):
                kind.pack(iter(bad))


@ALL_TYPES
def test_the_descriptor_says_what_is_written(kind: MessageType) -> None:
    file = descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor_set).file[0]
    assert file.syntax == "proto3"
    assert f"{file.package}.{file.message_type[0].name}" == kind.name
    fields = file.message_type[0].field
    assert [(f.name, f.number, f.type) for f in fields] == [
        (f.name, f.number, f.kind.value[0]) for f in kind.fields
    ]
    numbers = [field.number for field in kind.fields]
    assert numbers == sorted(set(numbers))
    assert max(numbers) < 19_000
    assert kind.descriptor_set == MessageType(kind.name, kind.fields).descriptor_set


@ALL_TYPES
def test_enums_have_values_that_take_one_octet(kind: MessageType) -> None:
    for field in kind.fields:
        assert (field.enum is not None) == (field.kind is Kind.ENUM)
        if field.enum is not None:
            assert [m.value for m in field.enum] == list(range(len(field.enum)))
            assert len(field.enum) < 128
            assert field.enum(0).name == "UNKNOWN"


def test_all_types_fit_one_pool() -> None:
    pool = descriptor_pool.DescriptorPool()
    for kind in TYPES:
        for file in descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor_set).file:
            pool.Add(file)
    for kind in TYPES:
        assert pool.FindMessageTypeByName(kind.name).full_name == kind.name


def test_json_names_are_the_names() -> None:
    zero = [bytes(f.size) if f.kind is Kind.OCTETS else 1 for f in SAMPLE.fields]
    message = RUNTIMES[SAMPLE.name].FromString(SAMPLE.pack(iter(zero)))
    assert set(json.loads(json_format.MessageToJson(message))) == {f.name for f in SAMPLE.fields}


def test_numbers_of_the_common_fields_are_stable_for_ever() -> None:
    """Recordings carry these numbers. Nothing here may change."""
    common = [(field.name, field.number) for field in SAMPLE.fields[: len(SIGNATURE) + 1]]
    assert common == [
        ("seq", 1),
        ("epoch", 2),
        ("origin", 3),
        ("redelivered", 4),
        ("asked_at", 5),
        ("read_at", 6),
        ("read_at_monotonic", 7),
        ("previous_read_at", 8),
        ("device_time", 9),
        ("time_flags", 10),
        ("doubtful", 11),
        ("raw", 12),
    ]
    assert [(o.name, o.value) for o in Origin] == [
        ("UNKNOWN", 0),
        ("FLAG", 1),
        ("CHANGED", 2),
        ("CYCLIC", 3),
    ]


def test_a_map_grows_only_at_its_end() -> None:
    block = PROFILES["hiac-roc"].block("sample")
    more = replace(block, points=(*block.points, Point(name="more", offset=0, type=WordType.U16)))
    assert block_fields(more)[:-1] == block_fields(block)
    assert block_fields(more)[-1].number == block_fields(block)[-1].number + 1


def test_kinds_of_points() -> None:
    points = (
        Point(name="a", offset=0, type=WordType.U16),
        Point(name="b", offset=1, type=WordType.S16, unit="V"),
        Point(name="c", offset=2, type=WordType.U16, scale=Decimal("0.1")),
        Point(name="d", offset=3, type=WordType.U32, bits=((0, "e"), (31, "f"))),
        Point(name="g", offset=5, type=WordType.MINUTES_SECONDS, unit="s"),
    )
    block = Block(name="b", table=Table.INPUT_REGISTERS, address=0, count=6, points=points)
    assert [(f.name, f.number, f.kind, f.unit) for f in block_fields(block)] == [
        ("a", 16, Kind.UINT32, ""),
        ("b", 17, Kind.INT32, "V"),
        ("c", 18, Kind.DOUBLE, ""),
        ("d", 19, Kind.UINT32, ""),
        ("e", 20, Kind.BOOL, ""),
        ("f", 21, Kind.BOOL, ""),
        ("g", 22, Kind.UINT32, "s"),
    ]


def test_kinds_of_wide_points() -> None:
    kinds = {
        WordType.S32: Kind.INT32,
        WordType.U64: Kind.UINT64,
        WordType.S64: Kind.INT64,
        WordType.F32: Kind.FLOAT,
        WordType.F64: Kind.DOUBLE,
        WordType.BCD16: Kind.UINT32,
        WordType.BCD64: Kind.UINT64,
        WordType.BIT: Kind.BOOL,
    }
    for type_, kind in kinds.items():
        point = Point(name="p", offset=0, type=type_)
        block = Block(name="b", table=Table.COILS, address=0, count=4, points=(point,))
        assert block_fields(block)[0].kind is kind, type_
        added = replace(block, points=(replace(point, add=Decimal(1)),))
        assert block_fields(added)[0].kind is Kind.DOUBLE


def test_parts_of_a_word_follow_its_bits() -> None:
    point = Point(name="p", offset=0, type=WordType.U32, bits=((0, "on"),), parts=((4, 3, "mode"),))
    block = Block(name="b", table=Table.INPUT_REGISTERS, address=0, count=2, points=(point,))
    assert [(f.name, f.kind) for f in block_fields(block)] == [
        ("p", Kind.UINT32),
        ("on", Kind.BOOL),
        ("mode", Kind.UINT32),
    ]


def test_only_what_can_be_missing_has_a_mask() -> None:
    plain = Point(name="p", offset=0, type=WordType.U16)
    block = Block(name="b", table=Table.INPUT_REGISTERS, address=0, count=1, points=(plain,))
    assert MISSING not in sample_type("x", block).fields
    digits = replace(block, points=(replace(plain, type=WordType.BCD16),))
    assert MISSING in sample_type("x", digits).fields
    assert (MISSING.name, MISSING.number, MISSING.kind) == ("missing", 13, Kind.UINT64)


def test_names_of_message_types() -> None:
    block = PROFILES["hiac-roc"].block("sample")
    assert sample_type("hiac-roc", block).name == "roclog.hiac_roc.Sample"
    assert sample_type("x", replace(block, name="iso_code_1")).name == "roclog.x.IsoCode1"

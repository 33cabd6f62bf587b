"""Block to protobuf: the message type, its descriptor, and its fixed-width octets.

Every field is always written and has a fixed width, so that a message is one packed structure: a
constant tag before each value. Only text, among the fields of a block, is as long as it is. Field
numbers are stable for ever: common fields have 1 to 15, the fields of the block follow from 16 in
map order, so a map only ever grows at its end.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Final

from google.protobuf import descriptor_pb2

from roclog.register_map import Block, Point, Table, WordType, camel_case

if TYPE_CHECKING:
    from collections.abc import Iterator

_Proto = descriptor_pb2.FieldDescriptorProto


class Origin(IntEnum):
    """Why a block became a sample."""

    UNKNOWN = 0
    FLAG = 1
    """The device said that it has new data."""
    CHANGED = 2
    """The flag was down, but the payload is not the last one kept."""
    CYCLIC = 3
    """Read on schedule; the block has no flag."""


class Kind(Enum):
    """Fixed-width field kinds: protobuf type, wire type, struct format."""

    DOUBLE = (_Proto.TYPE_DOUBLE, 1, "d")
    FLOAT = (_Proto.TYPE_FLOAT, 5, "f")
    UINT64 = (_Proto.TYPE_FIXED64, 1, "Q")
    INT64 = (_Proto.TYPE_SFIXED64, 1, "q")
    UINT32 = (_Proto.TYPE_FIXED32, 5, "I")
    INT32 = (_Proto.TYPE_SFIXED32, 5, "i")
    BOOL = (_Proto.TYPE_BOOL, 0, "?")
    ENUM = (_Proto.TYPE_ENUM, 0, "B")
    OCTETS = (_Proto.TYPE_BYTES, 2, "s")
    TEXT = (_Proto.TYPE_STRING, 2, "s")


@dataclass(frozen=True, slots=True)
class Field:
    """One field. size: octets of an OCTETS field. enum: values of an ENUM field, below 128."""

    name: str
    number: int
    kind: Kind
    unit: str = ""
    size: int = 0
    enum: type[IntEnum] | None = None


_FIRST_POINT: Final = 16
SIGNATURE: Final = (
    Field("seq", 1, Kind.UINT64),
    Field("epoch", 2, Kind.OCTETS, size=16),
    Field("origin", 3, Kind.ENUM, enum=Origin),
    Field("redelivered", 4, Kind.BOOL),
    Field("asked_at", 5, Kind.INT64, "ns"),
    Field("read_at", 6, Kind.INT64, "ns"),
    Field("read_at_monotonic", 7, Kind.INT64, "ns"),
    Field("previous_read_at", 8, Kind.INT64, "ns"),
    Field("device_time", 9, Kind.INT64, "ns"),
    Field("time_flags", 10, Kind.UINT32),
    Field("doubtful", 11, Kind.UINT64),
)
"""The fields every sample has before its raw octets; DESIGN.md says what each means."""
RAW_NUMBER: Final = 12
MISSING: Final = Field("missing", 13, Kind.UINT64)
"""Behind ``raw``, in types some of whose points can be missing: bit n is set where point n is no
measurement. A missing float is NaN as well; an integer then says nothing."""

ANSWERED: Final = Field("answer_began_at", 14, Kind.INT64, "ns")
"""When the first octet of the answer came; asked_at and read_at are the other two ends."""


def _kind(point: Point) -> Kind:
    return Kind.DOUBLE if point.is_scaled else _KINDS.get(point.type, Kind.UINT32)


_KINDS: Final = {
    WordType.S16: Kind.INT32,
    WordType.S32: Kind.INT32,
    WordType.S64: Kind.INT64,
    WordType.U64: Kind.UINT64,
    WordType.BCD64: Kind.UINT64,
    WordType.F32: Kind.FLOAT,
    WordType.F64: Kind.DOUBLE,
    WordType.BIT: Kind.BOOL,
    WordType.TEXT: Kind.TEXT,
    WordType.OCTETS: Kind.OCTETS,
}
"""Every other type fits 32 bits."""


def block_fields(block: Block) -> tuple[Field, ...]:
    """The fields that come from the map, numbered."""
    kinds: list[tuple[str, Kind, str, int]] = []
    for point in block.points:
        octets = 0
        if point.type is WordType.OCTETS:
            octets = point.words if block.packed else 2 * point.words
        kinds.append((point.name, _kind(point), point.unit, octets))
        kinds += [(name, Kind.BOOL, "", 0) for _, name in point.bits]
        kinds += [(name, Kind.UINT32, "", 0) for _, _, name in point.parts]
    return tuple(
        Field(name, number, kind, unit, octets)
        for number, (name, kind, unit, octets) in enumerate(kinds, start=_FIRST_POINT)
    )


@dataclass(frozen=True)
class MessageType:
    """One protobuf message type and the packing of its messages."""

    name: str
    fields: tuple[Field, ...]

    @cached_property
    def descriptor_set(self) -> bytes:
        """Serialized FileDescriptorSet, the data of an MCAP schema with encoding protobuf."""
        package, _, short = self.name.rpartition(".")
        file = descriptor_pb2.FileDescriptorProto(
            name=f"{self.name.replace('.', '/')}.proto", package=package, syntax="proto3"
        )
        message = file.message_type.add(name=short)
        for field in self.fields:
            self._describe(message, field)
        return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)

    def _describe(self, message: descriptor_pb2.DescriptorProto, field: Field) -> None:
        proto = message.field.add(
            name=field.name,
            number=field.number,
            type=field.kind.value[0],
            label=_Proto.LABEL_OPTIONAL,
            json_name=field.name,
        )
        if field.enum is not None:
            proto.type_name = f".{self.name}.{self._scope(message, field.enum)}"

    def _scope(self, message: descriptor_pb2.DescriptorProto, enum: type[IntEnum]) -> str:
        """Define the enum and give its name within the message.

        The names of its values belong to the message that it stands in, so that one which shares
        some with an earlier enum gets a message of its own around it.
        """
        taken = {value.name for other in message.enum_type for value in other.value}
        name = enum.__name__
        if taken & set(enum.__members__):
            message = message.nested_type.add(name=f"{name}Scope")
            name = f"{name}Scope.{name}"
        values = message.enum_type.add(name=enum.__name__).value
        for member in enum:
            values.add(name=member.name, number=member.value)
        return name

    @cached_property
    def _octets(self) -> list[tuple[int, int]]:
        """Position among the arguments of pack, and size: struct itself would cut and fill."""
        sizes = enumerate(field.size for field in self.fields)
        return [(2 * index + 1, size) for index, size in sizes if size]

    @cached_property
    def _packing(self) -> tuple[struct.Struct, list[Any]]:
        formats = ["<"]
        template: list[Any] = []
        for field in self.fields:
            tag = _varint(field.number << 3 | field.kind.value[1])
            if field.kind is Kind.OCTETS:
                tag += _varint(field.size)
            formats.append(f"{len(tag)}s{field.size or ''}{field.kind.value[2]}")
            template += [tag, None]
        return struct.Struct("".join(formats)), template

    def pack(self, values: Iterator[object]) -> bytes:
        """The message; one value for each field, in order.

        Raises:
            struct.error: a value does not fit its kind; a bug, since decode knows the types.
            ValueError: not as many values as fields, or octets of another size.
        """
        if self._has_text:
            pairs = zip(self.fields, values, strict=True)
            return b"".join(_packed(field, value) for field, value in pairs)
        packing, template = self._packing
        arguments = template.copy()
        arguments[1::2] = values
        for index, size in self._octets:
            if len(arguments[index]) != size:
                raise ValueError(f"{len(arguments[index])} octets where {size} belong")
        return packing.pack(*arguments)

    @cached_property
    def _has_text(self) -> bool:
        return any(field.kind is Kind.TEXT for field in self.fields)

    @property
    def size(self) -> int:
        """Octets of a packed message without text."""
        return self._packing[0].size

    def unpack(self, data: bytes) -> dict[str, Any] | None:
        """Values by field name, of a message that begins with exactly these fields; else None."""
        packing, template = self._packing
        if len(data) < packing.size:
            return None
        parts = packing.unpack_from(data)
        if list(parts[0::2]) != template[0::2]:
            return None
        return {field.name: part for field, part in zip(self.fields, parts[1::2], strict=True)}


def _packed(field: Field, value: Any) -> bytes:
    """One field of a message with text."""
    _, wire, code = field.kind.value
    tag = _varint(field.number << 3 | wire)
    if wire != 2:
        return tag + struct.pack(f"<{code}", value)
    octets: bytes = value.encode() if field.kind is Kind.TEXT else value
    if field.size and len(octets) != field.size:
        raise ValueError(f"{len(octets)} octets where {field.size} belong")
    return tag + _varint(len(octets)) + octets


def _varint(number: int) -> bytes:
    octets = bytearray()
    while number > 0x7F:
        octets.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*octets, number])


class Reason(IntEnum):
    """Why samples may be missing."""

    UNKNOWN = 0
    OVERWRITTEN = 1
    """The device completed another sample before this one could be read."""
    DOWNTIME = 2
    """Nothing was recording."""
    STORAGE = 3
    """The sample was read, but the disk did not take it in time."""
    UNGUARDED_CLEAR = 4
    """An expected sample did not show: it may have been identical and lost its flag to a clear."""
    UNREAD = 5
    """A block that is read on schedule was not: no answer, or the connection was too busy."""
    REPLACED = 6
    """Another device answers at this address; what either completed in between is not known."""


class InputChange(IntEnum):
    """In what the state of an input differs from the one recorded before it."""

    UNKNOWN = 0
    BASELINE = 1
    """The first state ever recorded of this input."""
    CHANGED = 2
    """Value and stamp."""
    RESTAMPED = 3
    """The stamp alone."""
    VALUE_WITHOUT_STAMP = 4
    """The value alone: a fault of the device."""


class ClearResult(IntEnum):
    """How the device took the write that lowers its flag."""

    UNKNOWN = 0
    DONE = 1
    REFUSED = 2
    """Exception response; the code is beside it."""
    UNANSWERED = 3
    """It may have taken effect; the next read tells."""


GAP: Final = MessageType(
    "roclog.Gap",
    (
        Field("from", 1, Kind.INT64, "ns"),
        Field("to", 2, Kind.INT64, "ns"),
        Field("expected", 3, Kind.UINT64),
        Field("reason", 4, Kind.ENUM, enum=Reason),
        Field("possible", 5, Kind.BOOL),
        Field("block", 6, Kind.TEXT),
    ),
)
"""``expected`` samples completed between ``from`` and ``to`` and are not in the recording; where
``possible`` is set, it cannot be told whether that many are missing, or any. ``block`` is empty
where the gap is the whole device's."""

CLEAR: Final = MessageType(
    "roclog.Clear",
    (
        Field("seq", 1, Kind.UINT64),
        Field("epoch", 2, Kind.OCTETS, size=16),
        Field("asked_at", 5, Kind.INT64, "ns"),
        Field("ended_at", 6, Kind.INT64, "ns"),
        Field("result", 7, Kind.ENUM, enum=ClearResult),
        Field("exception_code", 8, Kind.UINT32),
        Field("guarded", 9, Kind.BOOL),
    ),
)
"""One write to a flag. ``guarded``: no further sample could have completed since the read."""

_EXCEPTIONS: Final = (1, 2, 3, 4, 5, 6, 8, 10, 11)
LINK: Final = MessageType(
    "roclog.Link",
    (
        Field("from", 1, Kind.INT64, "ns"),
        Field("to", 2, Kind.INT64, "ns"),
        Field("requests", 3, Kind.UINT64),
        Field("answers", 4, Kind.UINT64),
        Field("timeouts", 5, Kind.UINT64),
        Field("late_answers", 6, Kind.UINT64),
        Field("crc_errors", 7, Kind.UINT64),
        Field("wrong_answers", 8, Kind.UINT64),
        Field("discarded_octets", 9, Kind.UINT64),
        Field("link_losses", 10, Kind.UINT64),
        Field("round_trip_mean", 11, Kind.DOUBLE, "s"),
        Field("round_trip_max", 12, Kind.DOUBLE, "s"),
        Field("bus_load", 13, Kind.DOUBLE, "1"),
        *(Field(f"exception_{code}", 16 + code, Kind.UINT64) for code in _EXCEPTIONS),
        Field("exception_other", 32, Kind.UINT64),
        Field("polls", 33, Kind.UINT64),
        Field("skipped", 34, Kind.UINT64),
        Field("frame_errors", 35, Kind.UINT64),
        Field("parity_errors", 36, Kind.UINT64),
        Field("overruns", 37, Kind.UINT64),
        Field("breaks", 38, Kind.UINT64),
    ),
)
"""What happened on the wire between ``from`` and ``to`` for one device."""


CLOCK_OFFSET: Final = MessageType(
    "roclog.ClockOffset",
    (
        Field("offset", 1, Kind.DOUBLE, "s"),
        Field("uncertainty", 2, Kind.DOUBLE, "s"),
        Field("drift", 3, Kind.DOUBLE, "ppm"),
        Field("drift_uncertainty", 4, Kind.DOUBLE, "ppm"),
    ),
)
"""Device clock less host clock, plus or minus ``uncertainty``; what the device gains, NaN where
that is not known. For people; no time stamp is ever corrected by it."""


@lru_cache(maxsize=256)
def sample_type(profile: str, block: Block) -> MessageType:
    """Message type of a block's samples; ``raw`` holds the registers as on the wire."""
    name = f"roclog.{profile.replace('-', '_')}.{camel_case(block.message or block.name)}"
    raw = Field("raw", RAW_NUMBER, Kind.OCTETS, size=block.octets)
    missing = (MISSING,) if block.can_miss else ()
    return MessageType(name, (*SIGNATURE, raw, *missing, ANSWERED, *block_fields(block)))


def stamped_type(profile: str, table: Table, stamp: int) -> MessageType:
    """Message type of changes of one table's inputs, with stamps of so many octets.

    ``raw`` is value and stamp as on the wire, a discrete input in one octet. The type is the same
    for stamps of 7 and 4 octets, its messages differ in size.
    """
    name = f"roclog.{profile.replace('-', '_')}.{camel_case(table.value)}"
    value = 1 if table.has_bits else 2
    fields = (
        Field("raw", RAW_NUMBER, Kind.OCTETS, size=value + stamp),
        ANSWERED,
        Field("address", 16, Kind.UINT32),
        Field("value", 17, Kind.UINT32),
        Field("change", 18, Kind.ENUM, enum=InputChange),
        Field("hidden", 19, Kind.UINT32),
        Field("time_octets", 20, Kind.OCTETS, size=stamp),
    )
    return MessageType(name, (*SIGNATURE, *fields))


_SIGNATURE_TYPE: Final = MessageType("roclog.Signature", SIGNATURE)
_RAW_TAG: Final = RAW_NUMBER << 3 | 2


def read_signature(data: bytes) -> dict[str, Any] | None:
    """The common fields and ``raw`` of a packed sample of any block; None for anything else."""
    values = _SIGNATURE_TYPE.unpack(data)
    if values is None:
        return None
    at = _SIGNATURE_TYPE.size
    tag, size, at = data[at : at + 1], 0, at + 1
    for shift in (0, 7):
        octet = data[at] if at < len(data) else 0
        size, at = size | (octet & 0x7F) << shift, at + 1
        if octet < 0x80:
            break
    raw = data[at : at + size]
    return {**values, "raw": raw} if tag == bytes([_RAW_TAG]) and len(raw) == size else None

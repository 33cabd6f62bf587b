"""Message types out of a file: descriptors that nobody has vouched for, to plain values."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError, Message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from google.protobuf.descriptor import Descriptor

MAX_SCHEMA: Final = 2**20
MAX_NESTED: Final = 2**20
"""Octets of a message whose type repeats or nests: two octets can become a whole object."""
_MAX_READERS: Final = 1024
_MOMENTS: Final = frozenset({"google.protobuf.Timestamp", "google.protobuf.Duration"})


class UndecodableError(ValueError):
    """A schema that makes no message type, or a message that does not fit its schema."""


class MessageReader:
    """Octets of one message type to its values.

    names: of the fields, in the order of the descriptor.

    Raises:
        UndecodableError: the octets are not a FileDescriptorSet with that message.
    """

    def __init__(self, name: str, descriptor_set: bytes) -> None:
        self.descriptor = _descriptor(name, descriptor_set)
        self.names = tuple(field.name for field in self.descriptor.fields)
        self._class = message_factory.GetMessageClass(self.descriptor)
        self._limit = MAX_NESTED if _nests(self.descriptor) else None
        self._shapes: dict[str, list[tuple[str, Callable[[Any], object]]]] = {}

    def parse(self, data: bytes) -> Any:
        """The message object. Raises UndecodableError."""
        if self._limit is not None and len(data) > self._limit:
            raise UndecodableError(f"a message of {len(data)} octets, more than {self._limit}")
        try:
            return self._class.FromString(data)
        except (DecodeError, UnicodeDecodeError) as error:
            raise UndecodableError(f"not a message of its schema ({error})") from error

    def values(self, message: Any) -> dict[str, object]:
        """All values by name; None for a field with presence that is not there."""
        return {name: get(message) for name, get in self._shape(message.DESCRIPTOR)}

    def has(self, fields: Iterable[tuple[str, int, int]]) -> bool:
        """Whether the type has these fields (name, number, protobuf type), none repeated."""
        mine = {(f.name, f.number, f.type) for f in self.descriptor.fields if not _is_repeated(f)}
        return mine.issuperset(fields)

    def _shape(self, descriptor: Descriptor) -> list[tuple[str, Callable[[Any], object]]]:
        shape = self._shapes.get(descriptor.full_name)
        if shape is None:
            shape = [(field.name, self._getter(field)) for field in descriptor.fields]
            self._shapes[descriptor.full_name] = shape
        return shape

    def _getter(self, field: FieldDescriptor) -> Callable[[Any], object]:
        get: Callable[[Any], Any] = attrgetter(field.name)
        name, value_of = field.name, self._value_of(field)
        if _is_map(field):
            entry: Any = field.message_type
            of_key = self._value_of(entry.fields_by_name["key"])
            of_value = self._value_of(entry.fields_by_name["value"])
            return lambda m: {str(of_key(k)): of_value(v) for k, v in get(m).items()}
        if _is_repeated(field):
            return lambda m: [value_of(item) for item in get(m)]
        if field.has_presence:
            return lambda m: value_of(get(m)) if m.HasField(name) else None
        if field.type == FieldDescriptor.TYPE_ENUM:
            return lambda m: value_of(get(m))
        return get

    def _value_of(self, field: FieldDescriptor) -> Callable[[Any], object]:
        if field.enum_type is not None:
            names: Mapping[int, str] = {v.number: v.name.lower() for v in field.enum_type.values}
            return lambda number: names.get(number, number)
        if field.message_type is None:
            return lambda value: value
        if field.message_type.full_name in _MOMENTS:
            return nanoseconds
        return self.values


class Readers:
    """Message types by schema, made once for all files of a recording."""

    def __init__(self) -> None:
        self._readers: dict[tuple[str, bytes], MessageReader | UndecodableError] = {}

    def reader(self, name: str, descriptor_set: bytes) -> MessageReader:
        """Raises UndecodableError."""
        key = (name, descriptor_set)
        if key not in self._readers:
            if len(self._readers) >= _MAX_READERS:
                self._readers.clear()
            try:
                self._readers[key] = MessageReader(name, descriptor_set)
            except UndecodableError as problem:
                self._readers[key] = problem
        found = self._readers[key]
        if isinstance(found, UndecodableError):
            raise found
        return found


def nanoseconds(moment: Any) -> int:
    """Of a Timestamp or a Duration."""
    return int(moment.seconds) * 10**9 + int(moment.nanos)


def _descriptor(name: str, descriptor_set: bytes) -> Descriptor:
    if len(descriptor_set) > MAX_SCHEMA:
        raise UndecodableError(f"a schema of {len(descriptor_set)} octets, more than {MAX_SCHEMA}")
    pool = descriptor_pool.DescriptorPool()
    try:
        files = {
            f.name: f for f in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set).file
        }
        _add(pool, files)
        descriptor = pool.FindMessageTypeByName(name)
        for file in files:
            _check_names(pool.FindFileByName(file).message_types_by_name.values())
    except UndecodableError:
        raise
    except (DecodeError, TypeError, KeyError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise UndecodableError(f"not a schema of {name!r} ({reason})") from error
    return descriptor


def _add(
    pool: descriptor_pool.DescriptorPool, files: dict[str, descriptor_pb2.FileDescriptorProto]
) -> None:
    """Dependencies first, whatever order the files have; a circle is refused by the pool."""
    waiting = dict(files)
    while waiting:
        ready = [n for n, f in waiting.items() if not any(d in waiting for d in f.dependency)]
        if not ready:
            raise UndecodableError("schema files that depend on each other in a circle")
        for name in ready:
            pool.Add(waiting.pop(name))


def _check_names(descriptors: Iterable[Descriptor]) -> None:
    """A field named like a method of protobuf's message objects could not be read."""
    for descriptor in descriptors:
        for field in descriptor.fields:
            if hasattr(Message, field.name):
                raise UndecodableError(f"a field named {field.name!r}")
        _check_names(descriptor.nested_types)


def _is_repeated(field: FieldDescriptor) -> bool:
    """By the property of protobuf 6.31 and later, or by what it replaced."""
    described: Any = field
    if hasattr(described, "is_repeated"):
        return bool(described.is_repeated)
    return bool(described.label == described.LABEL_REPEATED)


def _is_map(field: FieldDescriptor) -> bool:
    return (
        _is_repeated(field)
        and field.message_type is not None
        and bool(field.message_type.GetOptions().map_entry)
    )


def _nests(descriptor: Descriptor) -> bool:
    return any(
        _is_repeated(field)
        or (field.message_type is not None and field.message_type.full_name not in _MOMENTS)
        for field in descriptor.fields
    )

# ruff: noqa: INP001 - a script beside the files that it writes
"""Writes the files of this directory. Run it after a change of a register map or of the keys.

python schemas/generate.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

from google.protobuf import descriptor_pb2

from roclog.config import json_schema
from roclog.devices import PROFILES
from roclog.register_map import Table
from roclog.schema import (
    CLEAR,
    CLOCK_OFFSET,
    GAP,
    LINK,
    MessageType,
    sample_type,
    stamped_type,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

_Field = descriptor_pb2.FieldDescriptorProto
_KEYWORDS: Final = {
    number: name.removeprefix("TYPE_").lower() for name, number in _Field.Type.items()
}


def files() -> dict[str, str]:
    """Content of every generated file by its name."""
    config = json.dumps(json_schema(), indent=2) + "\n"
    return {"config.schema.json": config} | {
        f"{kind.name}.proto": proto_text(kind) for kind in _message_types()
    }


def _message_types() -> Iterator[MessageType]:
    yield from (GAP, CLEAR, LINK, CLOCK_OFFSET)
    for table in (Table.DISCRETE_INPUTS, Table.INPUT_REGISTERS):
        yield stamped_type("mei-timestamped", table, 7)
    for profile in PROFILES.values():
        for block in profile.samples:
            yield sample_type(profile.name, block)


def proto_text(kind: MessageType) -> str:
    """The descriptor that recordings embed, as protobuf source with the units as comments."""
    descriptors = descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor_set)
    (file,) = descriptors.file
    (message,) = file.message_type
    lines = [f'syntax = "{file.syntax}";', "", f"package {file.package};", ""]
    lines.append(f"message {message.name} {{")
    for enum in message.enum_type:
        lines += [*_enum_text(enum, "  "), ""]
    for scope in message.nested_type:
        lines.append(f"  message {scope.name} {{")
        for enum in scope.enum_type:
            lines += _enum_text(enum, "    ")
        lines += ["  }", ""]
    comments = {field.name: _comment(field.unit, field.size) for field in kind.fields}
    for field in message.field:
        own = f".{file.package}.{message.name}."
        keyword = field.type_name.removeprefix(own) or _KEYWORDS[field.type]
        lines.append(f"  {keyword} {field.name} = {field.number};{comments[field.name]}")
    return "\n".join([*lines, "}", ""])


def _enum_text(enum: descriptor_pb2.EnumDescriptorProto, indent: str) -> list[str]:
    values = [f"{indent}  {value.name} = {value.number};" for value in enum.value]
    return [f"{indent}enum {enum.name} {{", *values, f"{indent}}}"]


def _comment(unit: str, octets: int) -> str:
    if octets:
        return f"  // {octets} octets"
    return f"  // {unit}" if unit else ""


if __name__ == "__main__":
    directory = Path(__file__).parent
    for stale in directory.glob("*.proto"):
        stale.unlink()
    for name, text in files().items():
        (directory / name).write_text(text, encoding="utf-8")

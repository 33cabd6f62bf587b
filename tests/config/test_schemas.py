"""The published schemas are those of the code, and agree with it."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from google.protobuf import descriptor_pb2
from msgspec import Struct  # noqa: TC002 - in an annotation that runs

from roclog.config import json_schema
from roclog.config.profiles import TABLES
from roclog.config.tables import Rtu, RtuOverTcp, Tcp, Udp
from roclog.devices import PROFILES
from roclog.register_map import Table
from roclog.schema import CLEAR, CLOCK_OFFSET, GAP, LINK, sample_type, stamped_type

if TYPE_CHECKING:
    from collections.abc import Callable

DIRECTORY = Path(__file__).parents[2] / "schemas"
COMMAND = "python schemas/generate.py"


def test_files_are_up_to_date() -> None:
    files: Callable[[], dict[str, str]] = runpy.run_path(str(DIRECTORY / "generate.py"))["files"]
    wanted = files()
    there = {p.name: p.read_text() for p in DIRECTORY.iterdir() if p.suffix in {".proto", ".json"}}
    stale = sorted(n for n in wanted.keys() | there.keys() if wanted.get(n) != there.get(n))
    assert not stale, f"out of date: {', '.join(stale)}; run: {COMMAND}"


def test_module_prints_the_schema() -> None:
    command = [sys.executable, "-m", "roclog.config"]
    printed = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    assert json.loads(printed) == json_schema()


def test_schema_has_the_keys_of_the_tables() -> None:
    definitions = json_schema()["definitions"]
    tables: list[type[Struct]] = [Rtu, Tcp, Udp, RtuOverTcp, *TABLES.values()]
    for table in tables:
        keys = set(definitions[table.__name__]["properties"]) - {"transport", "profile"}
        assert keys == set(table.__struct_fields__)
        assert definitions[table.__name__]["additionalProperties"] is False
    assert definitions["Rtu"]["required"] == ["transport", "port"]
    assert definitions["RtuOverTcp"]["required"] == ["transport", "host", "port"]
    assert definitions["HiacRoc"]["required"] == ["profile", "connection"]


def test_schema_leaves_other_profiles_to_plugins() -> None:
    """And no built-in one: its table has its own keys, and no way around them."""
    schema = json_schema()
    choice = schema["properties"]["devices"]["additionalProperties"]
    arms = [arm["$ref"].rpartition("/")[2] for arm in choice["anyOf"]]
    assert sorted(arms) == sorted(["PluginDevice", *(kind.__name__ for kind in TABLES.values())])
    assert "discriminator" not in choice  # which would have to name every profile
    tables = [schema["definitions"][name] for name in arms]
    for profile in (*TABLES, "acme-flow"):
        takers = [table for table in tables if _takes(table["properties"]["profile"], profile)]
        assert len(takers) == 1, profile
        assert takers[0]["additionalProperties"] is False
        assert (takers[0]["title"] == "PluginDevice") == (profile == "acme-flow")
    assert not any(_takes(table["properties"]["profile"], "Acme Flow") for table in tables)


def _takes(words: dict[str, Any], profile: str) -> bool:
    if "enum" in words:
        return profile in words["enum"]
    return profile not in words["not"]["enum"] and re.search(words["pattern"], profile) is not None


def test_proto_texts_say_what_the_descriptors_say() -> None:
    kinds = [GAP, CLEAR, LINK, CLOCK_OFFSET]
    kinds += [stamped_type("mei-timestamped", Table.DISCRETE_INPUTS, 7)]
    kinds += [sample_type(p.name, block) for p in PROFILES.values() for block in p.samples]
    for kind in kinds:
        text = (DIRECTORY / f"{kind.name}.proto").read_text()
        found = re.findall(r"^  ([\w.]+) (\w+) = (\d+);", text, re.MULTILINE)
        described = descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor_set).file[0]
        fields = described.message_type[0].field
        assert [(name, int(number)) for _, name, number in found] == [
            (field.name, field.number) for field in fields
        ]
        assert f"package {described.package};" in text

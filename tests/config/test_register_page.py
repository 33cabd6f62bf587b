"""docs/register-maps.md: it has every word of the vocabulary, and what it shows can be loaded."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from roclog.cli import cli
from roclog.config import json_schema

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "register-maps.md").read_text(encoding="utf-8")
SNIPPETS: list[str] = re.findall(r"^```toml\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
SCHEMA = json_schema()


def reached(node: Any, seen: set[str]) -> Iterator[str]:
    """Names of all definitions that a part of the schema leads to."""
    if isinstance(node, list):
        for item in node:
            yield from reached(item, seen)
    if not isinstance(node, dict):
        return
    name = str(node.get("$ref", "")).rpartition("/")[2]
    if name and name not in seen:
        seen.add(name)
        yield name
        yield from reached(SCHEMA["definitions"][name], seen)
    for item in node.values():
        yield from reached(item, seen)


def words(node: Any) -> Iterator[str]:
    """Every key and every word that a value can be."""
    if isinstance(node, list):
        for item in node:
            yield from words(item)
    if isinstance(node, dict):
        yield from node.get("properties", {})
        yield from (word for word in node.get("enum", ()) if isinstance(word, str))
        for item in node.values():
            yield from words(item)


def test_every_word_stands_in_it() -> None:
    names = ["Registers", *reached(SCHEMA["definitions"]["Registers"], set())]
    vocabulary = {word for name in names for word in words(SCHEMA["definitions"][name])}
    assert {"blocks", "minutes_seconds", "payload", "year_base", "CDAB", "cp32"} <= vocabulary
    prose = re.sub(r"^```.*?^```", "", TEXT, flags=re.DOTALL | re.MULTILINE)
    told = {word for code in re.findall(r"`([^`]+)`", prose) for word in re.findall(r"\w+", code)}
    assert vocabulary - told == set()


def whole(snippet: str) -> str:
    """A configuration of a device, a block or points."""
    if "[connections" in snippet:
        return snippet
    head = SNIPPETS[0].partition("[[")[0]
    if "[[devices" in snippet:
        return SNIPPETS[0] + snippet
    block = f"points = [\n{snippet}]\n" if snippet.startswith("{") else snippet
    given = {"name": '"b"', "table": '"holding_registers"', "address": "100"}
    more = [f"{key} = {value}" for key, value in given.items() if key not in tomllib.loads(block)]
    return "\n".join([head, "[[devices.meter.blocks]]", *more, block])


@pytest.mark.parametrize("snippet", SNIPPETS, ids=lambda text: text.split("\n")[0][:40])
def test_what_it_shows_passes_the_check(snippet: str, tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
    path.write_text(whole(snippet), encoding="utf-8")
    path.chmod(0o644)
    done = CliRunner().invoke(cli, ["check", str(path)])
    assert (done.exit_code, done.stderr) == (0, "")


def test_what_it_links_to_is_there() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", TEXT)
    assert len(links) > 3
    for link in links:
        assert (ROOT / "docs" / link).is_file(), link

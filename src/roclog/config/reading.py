"""From a file to tables whose single values are right, with every problem collected on the way."""

from __future__ import annotations

import re
import stat
import tomllib
from difflib import SequenceMatcher, get_close_matches
from enum import Enum
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Final,
    Literal,
    TypeGuard,
    TypeVar,
    get_args,
    get_origin,
)

import msgspec
from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import fields

from roclog.config.leaves import NAME, parse_leaf, printable, shown
from roclog.config.synonyms import OTHERS_SAY, explanation
from roclog.errors import ConfigError, Problem

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from pathlib import Path

Table = TypeVar("Table", bound=Struct)
_LARGEST_FILE: Final = 1 << 20
_PLACE: Final = re.compile(r"(.*) \(at line (\d+), column (\d+)\)", re.DOTALL)
_KEY_EXPECTED: Final = "Invalid initial character for a key part"


class Problems:
    """What is wrong so far."""

    def __init__(self) -> None:
        self.found: list[Problem] = []

    def add(self, key: str, text: str) -> None:
        """text: may quote the file, whatever that holds."""
        self.found.append(Problem(key, printable(text)))

    def at(self, key: str) -> bool:
        """Whether something is wrong with this key; what depends on it is not judged then."""
        return any(problem.key == key for problem in self.found)

    def below(self, key: str) -> bool:
        """Whether something is wrong with this key or in what it holds."""
        return any(f"{p.key}.".startswith((f"{key}.", f"{key}[")) for p in self.found)

    def unknown_keys(self, key: str, table: Iterable[str], allowed: Collection[str]) -> None:
        for name in table:
            if name not in allowed:
                self.add(joined(key, name), f"unknown key{suggestion(name, allowed)}")


def read_toml(path: Path) -> dict[str, Any]:
    """Raises ConfigError with one problem; that of a syntax error names line and column."""
    try:
        if stat.S_ISDIR(path.stat().st_mode):
            raise ConfigError(path, [Problem("", "is a directory, not a configuration file")])
        with path.open("rb") as file:
            octets = file.read(_LARGEST_FILE + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise ConfigError(path, [Problem("", f"cannot be read: {reason}")]) from error
    if len(octets) > _LARGEST_FILE:
        raise ConfigError(path, [Problem("", "is larger than 1 MiB, so not a configuration")])
    try:
        text = octets.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = octets.count(b"\n", 0, error.start) + 1
        raise ConfigError(path, [Problem(f"line {line}", "is not UTF-8 text")]) from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(path, [_syntax_problem(str(error), text)]) from error
    except RecursionError as error:
        raise ConfigError(path, [Problem("", "arrays or tables are nested too deeply")]) from error
    except ValueError as error:  # an integer of thousands of digits, a date like 2026-02-30
        raise ConfigError(path, [Problem("", f"not a TOML value: {error}")]) from error


def _syntax_problem(message: str, text: str) -> Problem:
    match = _PLACE.fullmatch(message)
    lines = text.split("\n")
    if match is not None:
        rest = lines[int(match[2]) - 1][int(match[3]) - 1 :].strip()
        hint = ""
        if match[1] == _KEY_EXPECTED and (not rest or rest[0] in "#}"):
            hint = "; a table in { } stays on one line and has no comma at its end"
        return Problem(f"line {match[2]}, column {match[3]}", f"not TOML: {match[1]}{hint}")
    reason = message.removesuffix(" (at end of document)")
    place = f"line {len(lines)}, column {len(lines[-1]) + 1}"
    return Problem(place, f"not TOML: {reason} (the file ends here)")


def joined(key: str, name: str) -> str:
    """Key path of ``name`` in the table ``key``, quoted as in TOML where that is needed."""
    bare = re.fullmatch(r"[A-Za-z0-9_-]+", name) is not None
    return f"{key}.{name if bare else shown(name)}".lstrip(".")


def suggestion(word: str, known: Iterable[str]) -> str:
    """``, did you mean "..."?`` where a known word is close or means the same, else nothing."""
    folded = {name.lower(): name for name in known}
    told = explanation(word.lower(), folded)
    if told:
        return f"; {told}"
    same = OTHERS_SAY.get(word.lower())
    close = [same] if same in folded else _closest(word.lower(), list(folded))
    return f', did you mean "{folded[close[0]]}"?' if close else ""


def _closest(word: str, known: list[str]) -> list[str]:
    """None where two are equally close: that would be a guess."""
    close = get_close_matches(word, known, n=2)
    likeness = [SequenceMatcher(None, name, word).ratio() for name in close]
    return [] if len(close) == 2 and likeness[0] == likeness[1] else close[:1]


def named_tables(file: dict[str, Any], key: str, problems: Problems) -> Iterator[tuple[str, Any]]:
    """The tables below connections or devices whose names can be used, with their names."""
    value = file.get(key)
    if value is None or value == {}:
        problems.add(key, f"missing, needed is at least one table [{key}.NAME]")
    elif not isinstance(value, dict):
        problems.add(key, f"{shown(value)} is not a table, write [{key}.NAME]")
    else:
        for name, table in value.items():
            if re.fullmatch(NAME, name) is None:
                text = "name is not 1 to 32 of a-z, 0-9, - and _, with a letter or digit first"
                problems.add(joined(key, name), text)
            yield name, table


def alternatives(words: Iterable[object]) -> str:
    *others, last = (shown(word) for word in words)
    return " or ".join(filter(None, (", ".join(others), last)))


def read_table(kind: type[Table], value: object, key: str, problems: Problems) -> Table:
    """Check every key of one table.

    A key that is wrong is reported and left UNSET, so that the others can still be judged.
    """
    allowed = {field.name: field for field in fields(kind)}
    tag_field = kind.__struct_config__.tag_field
    found: dict[str, Any] = {}
    if isinstance(value, dict):
        problems.unknown_keys(key, value, allowed.keys() | ({tag_field} if tag_field else set()))
        for name, field in allowed.items():
            if name in value:
                found[name] = _read_value(field.type, value[name], joined(key, name), problems)
            elif field.required:
                problems.add(joined(key, name), f"missing, needed is {_needed(_plain(field.type))}")
    else:
        example = getattr(kind, "EXAMPLE", "")
        like = f", needed is one like {example}" if example else ""
        problems.add(key, f"{shown(value)} is not a table{like}")
    return kind(**{field.name: found.get(field.name, UNSET) for field in allowed.values()})


def _read_value(kind: Any, value: object, key: str, problems: Problems) -> object:
    plain = _plain(kind)
    if isinstance(plain, type) and issubclass(plain, Struct):
        return read_table(plain, value, key, problems)
    member = _struct_of_list(plain)
    if member is not None:
        return _read_tables(member, value, _title(plain), key, problems)
    if _names_texts(plain) and isinstance(value, dict):
        return _read_texts(value, plain, key, problems)
    single = _single(plain, value)
    if single is not None:
        return _read_singles(value, single, key, problems)
    try:
        return msgspec.convert(value, plain, dec_hook=parse_leaf)
    except msgspec.ValidationError as error:
        problems.add(key, _refusal(plain, value, error))
        return UNSET


def _read_tables(
    kind: type[Struct], value: object, title: str | None, key: str, problems: Problems
) -> object:
    if not isinstance(value, list):
        hint = f", needed are {title}" if title else ""
        problems.add(key, f"{shown(value)} is not an array of tables{hint}")
        return UNSET
    return [read_table(kind, item, f"{key}[{index}]", problems) for index, item in enumerate(value)]


def _names_texts(kind: Any) -> bool:
    return get_origin(kind) is Annotated and get_args(kind)[0] == dict[str, str]


def _read_texts(value: dict[str, Any], kind: Any, key: str, problems: Problems) -> object:
    """A table whose values are texts: each other value is told by its own key."""
    wrong = [name for name, text in value.items() if not isinstance(text, str)]
    for name in wrong:
        text = f"{shown(value[name])} is not a text in quotes, needed is {_title(kind)}"
        if isinstance(value[name], dict):  # TOML takes -9999.0 for a table -9999 with a key 0
            dotted = shown(f"{name}.{next(iter(value[name]), '')}")
            text = f"a key with a dot is written in quotes, {dotted} = ..."
        problems.add(joined(key, name), text)
    return UNSET if wrong else value


def _single(kind: Any, value: object) -> Any | None:
    """What an array or a table holds, where the value is one and it is known what to call that."""
    inner = kind.__origin__
    if get_origin(inner) not in (dict, list) or not isinstance(value, get_origin(inner)):
        return None
    member = get_args(inner)[-1]
    return member if get_origin(member) is Annotated and _title(member) else None


def _read_singles(value: Any, kind: Any, key: str, problems: Problems) -> object:
    """Each one that is wrong is told by its own key."""
    named = isinstance(value, dict)
    pairs = value.items() if named else enumerate(value)
    found: dict[Any, Any] = {}
    for name, item in pairs:
        try:
            found[name] = msgspec.convert(item, kind, dec_hook=parse_leaf)
        except msgspec.ValidationError as error:
            place = joined(key, str(name)) if named else f"{key}[{name}]"
            problems.add(place, _refusal(kind, item, error))
    if len(found) < len(value):
        return UNSET
    return found if named else list(found.values())


def _struct_of_list(kind: Any) -> type[Struct] | None:
    """The table of an array of tables, None for everything else."""
    inner = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    member = get_args(inner)[0] if get_origin(inner) is list else None
    return member if isinstance(member, type) and issubclass(member, Struct) else None


def _plain(kind: Any) -> Any:
    return next(arm for arm in get_args(kind) if arm is not UnsetType)


def _title(kind: Any) -> str | None:
    return next((meta.title for meta in kind.__metadata__ if meta.title), None)


def _words(kind: Any) -> list[object]:
    """All that a value can be, where it is one of some words; else nothing."""
    inner = kind.__origin__
    if get_origin(inner) is Literal:
        return list(get_args(inner))
    return [str(word.value) for word in inner] if _is_enum(inner) else []


def _is_enum(kind: object) -> TypeGuard[type[Enum]]:
    return isinstance(kind, type) and issubclass(kind, Enum)


def _needed(kind: Any) -> str | None:
    """What the value should be: the title, and the words where it does not have them itself."""
    title, words = _title(kind), _words(kind)
    if not words or (title is not None and all(str(word) in title for word in words)):
        return title
    return ": ".join(filter(None, (title, alternatives(words))))


def _refusal(kind: Any, value: object, error: msgspec.ValidationError) -> str:
    if isinstance(error.__cause__, (TypeError, ValueError)):  # raised by parse_leaf
        return str(error.__cause__)
    known = [word for word in _words(kind) if isinstance(word, str)]
    hint = suggestion(value, known) if isinstance(value, str) else ""
    wanted = (_title(kind) if hint else None) or _needed(kind)
    return f"{shown(value)} is not {wanted}{hint}"

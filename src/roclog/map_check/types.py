"""Whether a register map that somebody else has written is made of what the words ask for.

A type checker tells an author as much and more; this is for maps that nobody has shown to one.
"""

from __future__ import annotations

import reprlib
import types
from dataclasses import is_dataclass
from decimal import Decimal
from enum import Enum
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final, Union, get_args, get_origin, get_type_hints

from roclog.register_map import RegisterMap, Table
from roclog.register_map.writable import Writable

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAMES: Final = {"Decimal": Decimal, "Table": Table, "Writable": Writable}
"""Words of annotations that their modules know for type checkers only."""
_WORDS: Final = RegisterMap.__module__
"""The package of all of them."""


def type_flaws(register_map: RegisterMap) -> list[str]:
    """Every value of another type than its word has, with the way to it."""
    return [text.lstrip(".") for text in _flaws(register_map, RegisterMap, "")]


def _flaws(value: object, kind: Any, path: str) -> Iterator[str]:
    if get_origin(kind) in (Union, types.UnionType):
        yield from _union_flaws(value, get_args(kind), path)
    elif get_origin(kind) is tuple:
        yield from _tuple_flaws(value, get_args(kind), path)
    elif not _is_a(value, kind):
        yield f"{path}: {_shown(value)}, not {_title(kind)}"
    elif _has_words(kind):
        for name, hint in _hints(kind).items():
            yield from _flaws(getattr(value, name), hint, f"{path}.{name}")


def _has_words(kind: Any) -> bool:
    return is_dataclass(kind) and kind.__module__.startswith(_WORDS)


def _union_flaws(value: object, arms: tuple[Any, ...], path: str) -> Iterator[str]:
    for arm in arms:
        if _is_a(value, get_origin(arm) or arm):
            yield from _flaws(value, arm, path)
            return
    yield f"{path}: {_shown(value)}, not {' or '.join(map(_title, arms))}"


def _tuple_flaws(value: object, inner: tuple[Any, ...], path: str) -> Iterator[str]:
    if not isinstance(value, tuple):
        yield f"{path}: {_shown(value)}, not a tuple"
    elif inner[-1] is Ellipsis:
        for index, item in enumerate(value):
            yield from _flaws(item, inner[0], f"{path}[{index}]")
    elif len(value) != len(inner):
        yield f"{path}: {_shown(value)}, not a tuple of {len(inner)}"
    else:
        for index, (item, kind) in enumerate(zip(value, inner, strict=True)):
            yield from _flaws(item, kind, f"{path}[{index}]")


def _is_a(value: object, kind: type) -> bool:
    if isinstance(value, bool):
        return kind is bool
    if kind is int:
        return isinstance(value, int) and not isinstance(value, Enum)
    return isinstance(value, (int, float) if kind is float else kind)


_hints = cache(partial(get_type_hints, localns=_NAMES))


def _shown(value: object) -> str:
    return f"{reprlib.repr(value)} ({type(value).__name__})"


def _title(kind: Any) -> str:
    return "None" if kind is type(None) else str(getattr(kind, "__name__", kind))

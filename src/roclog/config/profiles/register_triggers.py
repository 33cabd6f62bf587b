"""Triggers and time sources as a configuration writes them."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from msgspec import UnsetType

from roclog.config.leaves import shown
from roclog.config.profiles.register_tables import given
from roclog.config.reading import suggestion
from roclog.register_map import (
    Change,
    ClearOnRead,
    Counter,
    Cp32,
    Cp56,
    FlagAndClear,
    SecondsMicroseconds,
    SplitCalendar,
    UnixSeconds,
    WordOrder,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from roclog.config.profiles.register_tables import (
        ClearOnReadTable,
        CounterOrChangeTable,
        TimeTable,
        TriggerTable,
    )
    from roclog.config.reading import Problems
    from roclog.register_map import Table, TimeSource, Trigger

    Spans = Mapping[str, tuple[int, int]]
    """Names that a trigger may use: the first offset of each, and how many."""

_KINDS: Final = {
    "flag": {"new", "clear", "payload"},
    "clear_on_read": set[str](),
    "counter": {"first", "last"},
    "change": set[str](),
}
"""Each kind of trigger, and the keys that only it has."""
_SOURCES: Final[dict[str, tuple[type[Any], set[str], set[str]]]] = {
    "unix": (UnixSeconds, {"offset"}, {"word_order", "epoch"}),
    "unix_us": (SecondsMicroseconds, {"seconds", "microseconds"}, {"word_order"}),
    "calendar": (SplitCalendar, set(), {f.name for f in fields(SplitCalendar)} - {"zone"}),
    "cp56": (Cp56, {"offset"}, {"word_order"}),
    "cp32": (Cp32, {"offset"}, {"word_order"}),
}
"""Each source, the keys it needs and the keys it can have."""


def trigger(
    said: TriggerTable | UnsetType, table: Table, spans: Spans, key: str, problems: Problems
) -> Trigger | None:
    """None where the file gives none, or where it is not whole; that is reported.

    table: of the block.
    """
    if isinstance(said, UnsetType) or not _is_one(said, key, problems):
        return None
    if not isinstance(said.clear_on_read, UnsetType):
        return _clear_on_read(said.clear_on_read, table)
    if isinstance(said.flag, UnsetType):
        return _counter_or_change(said, spans, key, problems)
    assumed = isinstance(said.payload, UnsetType)
    chosen = spans if isinstance(said.payload, UnsetType) else said.payload
    payload = _ranges(chosen, spans, f"{key}.payload", problems)
    more = given(said, "flag", "new", "clear")
    return FlagAndClear(payload=payload, is_assumed=assumed, **more)


def counter_or_change(
    said: CounterOrChangeTable | UnsetType, spans: Spans, key: str, problems: Problems
) -> Trigger | None:
    """As ``trigger``."""
    if isinstance(said, UnsetType) or not _is_one(said, key, problems):
        return None
    return _counter_or_change(said, spans, key, problems)


def _is_one(said: CounterOrChangeTable, key: str, problems: Problems) -> bool:
    """Whether it is one kind of trigger; else that is reported, as is a key of another kind."""
    found = given(said, *said.__struct_fields__)
    can = [kind for kind in _KINDS if kind in said.__struct_fields__]
    kinds = [kind for kind in can if kind in found]
    if len(kinds) != 1:
        if not any(f"{problem.key}.".startswith(f"{key}.") for problem in problems.found):
            what = " and ".join(kinds) if kinds else "nothing"
            problems.add(key, f"is {what}, needed is one of {', '.join(can)}")
        return False
    for kind, own in _KINDS.items():
        for name in sorted(own & found.keys()) if kind != kinds[0] else ():
            problems.add(f"{key}.{name}", f"only with {kind}")
    return True


def _counter_or_change(
    said: CounterOrChangeTable, spans: Spans, key: str, problems: Problems
) -> Trigger:
    if not isinstance(said.counter, UnsetType):
        return Counter(point=said.counter, **given(said, "first", "last"))
    names = [] if isinstance(said.change, UnsetType) else said.change
    return Change(payload=_ranges(names, spans, f"{key}.change", problems))


def _clear_on_read(said: ClearOnReadTable, table: Table) -> ClearOnRead | None:
    where = table if isinstance(said.table, UnsetType) else said.table
    if isinstance(said.address, UnsetType):
        return None
    mask = 0xFFFF if isinstance(said.mask, UnsetType) else said.mask
    usual = 1 if isinstance(said.mask, UnsetType) else mask
    new = usual if isinstance(said.new, UnsetType) else said.new
    return ClearOnRead(table=where, address=said.address, mask=mask, new=new)


def _ranges(
    names: Iterable[str], spans: Spans, key: str, problems: Problems
) -> tuple[tuple[int, int], ...]:
    """(first offset, words) of these points, neighbours joined."""
    words: set[int] = set()
    for name in names:
        if name not in spans:
            problems.add(key, f"no point {shown(name)} in this block{suggestion(name, spans)}")
        else:
            first, size = spans[name]
            words.update(range(first, first + size))
    places = sorted(words)
    breaks = [index for index, (a, b) in enumerate(pairwise(places), start=1) if b > a + 1]
    edges = [0, *breaks, len(places)]
    return tuple((places[a], b - a) for a, b in pairwise(edges) if b > a)


def time_source(
    said: TimeTable | UnsetType, key: str, zone: str, problems: Problems
) -> TimeSource | None:
    """As ``trigger``."""
    if isinstance(said, UnsetType) or isinstance(said.source, UnsetType):
        return None
    kind, needed, can = _SOURCES[said.source]
    names = [name for name in said.__struct_fields__ if name != "source"]
    found = given(said, *names)
    missing = [name for name in sorted(needed) if name not in found]
    for name in missing:
        if not problems.at(f"{key}.{name}"):
            problems.add(f"{key}.{name}", f"missing, needed for {said.source}")
    for name in sorted(found.keys() - needed - can):
        having = [source for source, (_, a, b) in _SOURCES.items() if name in a | b]
        problems.add(f"{key}.{name}", f"only with source = {' or '.join(map(shown, having))}")
        del found[name]
    if missing:
        return None
    if "word_order" in found:
        text = {"AB": "ABCD", "BA": "BADC"}.get(found["word_order"], found["word_order"])
        found["word_order"] = WordOrder(text)
    if said.source in ("calendar", "cp56", "cp32"):
        found["zone"] = zone
    made: TimeSource = kind(**found)
    return made

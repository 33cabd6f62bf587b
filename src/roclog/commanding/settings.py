"""Settings of a device as people write and read them: parsed, judged, planned, compared.

Words are those of the block of settings, as on the wire. Problems are collected, never the first
only, and named by the setting.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.commanding.values import (
    ReadingOf,
    allowed_text,
    number_of,
    problem_of,
    readings_of,
    text_of,
    word_of,
)
from roclog.decode import decode, named_values
from roclog.quantities import parse_instant

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from roclog.register_map import Block, Point, RegisterMap
    from roclog.register_map.writable import Writable

CLOCK: Final = "clock"
"""Name under which all settings of a device's clock are set at once."""
_NOW: Final = "now"
_ZONE: Final = re.compile(r"(Z|[+-]\d\d:\d\d)$")
_SECOND: Final = 10**9


class SettingErrors(ValueError):
    """Settings that cannot be written. problems: all of them, each naming its setting."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problems))


class Step(NamedTuple):
    """One register to write: what it holds, and what it is to hold."""

    name: str
    address: int
    old: int
    new: int


class Plan(NamedTuple):
    """What to write, in order. already: settings that hold the wanted value. remarks: for people.

    The setting that is the device's own address comes last: the others go to the old one.
    """

    steps: tuple[Step, ...]
    already: tuple[str, ...]
    remarks: tuple[str, ...]


class Difference(NamedTuple):
    """A register that does not hold what it should. name: empty where it has none."""

    name: str
    address: int
    wanted: int
    found: int


class Shown(NamedTuple):
    """A setting for people. value: in ``unit``. allowed: what may be written.

    doubtful: the word is outside what the document gives.
    """

    name: str
    address: int
    word: int
    value: int
    text: str
    unit: str
    allowed: str
    meaning: str
    doubtful: bool
    readings: tuple[ReadingOf, ...]
    remark: str


def writable_of(register_map: RegisterMap) -> Writable:
    """Raises ValueError where the map declares no settings."""
    if register_map.writable is None:
        raise ValueError(f"profile {register_map.name} declares no settings")
    return register_map.writable


def setting_block(register_map: RegisterMap) -> Block:
    """The block that has the settings."""
    return register_map.block(writable_of(register_map).block)


def parse_settings(register_map: RegisterMap, texts: Sequence[str], now: int) -> dict[str, int]:
    """The words of texts like ``sample_period=10s``, by the name of the setting.

    now: nanoseconds UTC, for ``clock=now``.

    Raises:
        SettingErrors: a name that is not known or comes twice, or a value that no document allows.
    """
    writable, points = writable_of(register_map), _points(register_map)
    numbers: dict[str, int] = {}
    problems: list[str] = []
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            if not equals:
                raise ValueError(f"{text!r}: write NAME=VALUE")  # noqa: TRY301
            new = _named_numbers(name, value, writable, points, now)
        except ValueError as error:
            problems.append(str(error))
            continue
        problems += [f"{each}: set twice" for each in new if each in numbers]
        numbers |= new
    for name, number in numbers.items():
        setting = writable.setting(name)
        assert setting is not None
        problem = problem_of(setting, points, number, numbers.get(setting.selector))
        problems += [problem] if problem else []
    if problems:
        raise SettingErrors(problems)
    return {name: word_of(points[name].type, number) for name, number in numbers.items()}


def plan(register_map: RegisterMap, wanted: Mapping[str, int], words: Sequence[int]) -> Plan:
    """What to write to a device whose settings are ``words``. wanted: as of parse_settings.

    Raises:
        SettingErrors: a value that the document allows, but not with the device's other settings.
    """
    writable, block = writable_of(register_map), setting_block(register_map)
    points = _points(register_map)
    steps, already, problems = [], [], []
    after = [wanted.get(_name_at(block, offset), word) for offset, word in enumerate(words)]
    values = _values(block, after)
    for setting in writable.settings:
        name = setting.point
        if name not in wanted:
            continue
        selected = values[setting.selector] if setting.selector else None
        problem = problem_of(setting, points, values[name], selected)
        problems += [problem] if problem else []
        offset = points[name].offset
        if words[offset] == wanted[name]:
            already.append(name)
        else:
            steps.append(Step(name, block.address + offset, words[offset], wanted[name]))
    if problems:
        raise SettingErrors(problems)
    steps.sort(key=lambda step: (step.name == writable.unit, step.address))
    written = {step.name for step in steps}
    remarks = [s.remark for s in writable.settings if s.point in written and s.remark]
    remarks += _left_behind(writable, points, values, written)
    return Plan(tuple(steps), tuple(already), tuple(dict.fromkeys(remarks)))


def expected(register_map: RegisterMap, words: Sequence[int], steps: Sequence[Step]) -> list[int]:
    """The words after these steps."""
    first = setting_block(register_map).address
    after = list(words)
    for step in steps:
        after[step.address - first] = step.new
    return after


def differences(
    register_map: RegisterMap, wanted: Sequence[int], found: Sequence[int], elapsed: int
) -> list[Difference]:
    """Where the device's words are not the wanted ones.

    elapsed: nanoseconds in which a clock, where it runs, may have moved on from ``wanted``.
    """
    block = setting_block(register_map)
    moved = _clock_offsets(register_map) if _runs(register_map, wanted, found, elapsed) else ()
    return [
        Difference(_name_at(block, offset), block.address + offset, *pair)
        for offset, pair in enumerate(zip(wanted, found, strict=True))
        if pair[0] != pair[1] and offset not in moved
    ]


def describe(register_map: RegisterMap, words: Sequence[int]) -> list[Shown]:
    """Every setting, in the order of the map."""
    writable, block = writable_of(register_map), setting_block(register_map)
    points, values = _points(register_map), _values(block, words)
    doubtful = decode(block, words).doubtful
    shown = []
    for setting in writable.settings:
        point, number = points[setting.point], values[setting.point]
        selected = values[setting.selector] if setting.selector else None
        entry = Shown(
            name=setting.point,
            address=block.address + point.offset,
            word=words[point.offset],
            value=number,
            text=text_of(point.type, number),
            unit=point.unit,
            allowed=allowed_text(setting, point, selected),
            meaning=dict(point.meanings).get(number, ""),
            doubtful=bool(doubtful >> block.points.index(point) & 1),
            readings=readings_of(setting, point, number, selected),
            remark=setting.remark,
        )
        shown.append(entry)
    return shown


def assumed(texts: Sequence[str]) -> tuple[str, ...]:
    """What is taken for granted in texts of which parse_settings has found nothing wrong."""
    instants = [text.removeprefix(f"{CLOCK}=") for text in texts if text.startswith(f"{CLOCK}=")]
    return tuple(
        f"{CLOCK}: {text} names no zone, it is taken as UTC"
        for text in instants
        if text != _NOW and not _ZONE.search(text)
    )


def clock_words(register_map: RegisterMap, words: Sequence[int]) -> tuple[int, ...]:
    """Those of the device's clock, largest unit first: a later time is a greater tuple."""
    return tuple(words[offset] for offset in _clock_offsets(register_map))


def _points(register_map: RegisterMap) -> dict[str, Point]:
    return {point.name: point for point in setting_block(register_map).points}


def _name_at(block: Block, offset: int) -> str:
    return next((point.name for point in block.points if point.offset == offset), "")


def _values(block: Block, words: Sequence[int]) -> dict[str, int]:
    """Numbers of all points of one register."""
    found = named_values(block, decode(block, words))
    return {name: value for name, value in found.items() if isinstance(value, int)}


def _named_numbers(
    name: str, text: str, writable: Writable, points: Mapping[str, Point], now: int
) -> dict[str, int]:
    """Numbers by the names of settings, of one text."""
    if name == CLOCK and writable.clock:
        return dict(zip(writable.clock, _clock_numbers(text, now), strict=True))
    if writable.setting(name) is None:
        known = ", ".join(setting.point for setting in writable.settings)
        more = f", {CLOCK}" if writable.clock else ""
        raise ValueError(f"{name}: no such setting; there is {known}{more}")
    try:
        return {name: number_of(points[name], text)}
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _clock_numbers(text: str, now: int) -> tuple[int, int, int, int]:
    """Year, month and day, hour, seconds since the hour."""
    try:
        instant = now if text == _NOW else parse_instant(text)
        at = datetime.fromtimestamp(instant // _SECOND, UTC)
    except (ValueError, OverflowError) as error:
        reason = "" if text in str(error) else f" ({error})"
        wanted = "write now, or an instant like 2026-11-23T06:00:00Z"
        raise ValueError(f"{CLOCK}: {text!r} is no date and time{reason}: {wanted}") from error
    if text != _NOW and instant % _SECOND:
        raise ValueError(f"{CLOCK}: {text!r} is finer than a second")
    return at.year, 100 * at.month + at.day, at.hour, 60 * at.minute + at.second


def _left_behind(
    writable: Writable,
    points: Mapping[str, Point],
    values: Mapping[str, int],
    written: set[str],
) -> Iterator[str]:
    """Numbers that another one is about to take out of their range."""
    for setting in writable.settings:
        if setting.selector not in written or setting.point in written:
            continue
        selected, number = values[setting.selector], values[setting.point]
        has_range = any(choice.when == selected for choice in setting.ranges)
        if has_range and (problem := problem_of(setting, points, number, selected)):
            yield f"{problem}; it stays as it is"


def _clock_offsets(register_map: RegisterMap) -> tuple[int, ...]:
    points = _points(register_map)
    return tuple(points[name].offset for name in writable_of(register_map).clock)


def _runs(
    register_map: RegisterMap, wanted: Sequence[int], found: Sequence[int], elapsed: int
) -> bool:
    """Whether the device's clock has moved on as a clock does, and may be left out."""
    names = writable_of(register_map).clock
    block = setting_block(register_map)
    times = [_instant([_values(block, words)[n] for n in names]) for words in (wanted, found)]
    if not names or times[0] is None or times[1] is None:
        return False
    return 0 <= times[1] - times[0] <= elapsed // _SECOND + 1


def _instant(numbers: Sequence[int]) -> int | None:
    """Seconds since 1970; None where the numbers are no instant."""
    try:
        year, month_day, hour, second = numbers
        day = datetime(year, month_day // 100, month_day % 100, hour, tzinfo=UTC)
    except ValueError:
        return None
    return int(day.timestamp()) + second

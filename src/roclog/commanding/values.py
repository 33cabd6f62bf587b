"""One setting of a device: its text, its number, its word, and what may be written. Pure.

A number is the value in the unit of its point: seconds of MM:SS, month * 100 + day.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.quantities import parse_duration
from roclog.register_map import WordType

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from decimal import Decimal

    from roclog.register_map import Point
    from roclog.register_map.writable import Range, Setting

_SECOND: Final = 10**9
_WHOLE: Final = re.compile(r"0|-?[1-9][0-9]{0,99}")
"""Without leading zeros: 00 is the name of a class, not the number 0."""
_MINUTES_SECONDS: Final = re.compile(r"([0-9]{1,2}):([0-9]{2})")
_MONTH_DAY: Final = re.compile(r"([0-9]{1,2})-([0-9]{1,2})")


class ReadingOf(NamedTuple):
    """A number under one of the readings that its document leaves open.

    inside: whether the range in force allows it; None = none is in force.
    """

    name: str
    value: Decimal
    inside: bool | None


def number_of(point: Point, text: str) -> int:
    """The value in the unit of the point; its range is not looked at.

    Raises:
        ValueError: not a value of this type.
    """
    for number, meaning in point.meanings:
        if text.casefold() == meaning.casefold() or _is_word(text, meaning):
            return number
    if point.type is WordType.MINUTES_SECONDS:
        return _seconds(text)
    if point.type is WordType.MONTH_DAY:
        match = _MONTH_DAY.fullmatch(text)
        if match is None or not (1 <= int(match[1]) <= 12 and 1 <= int(match[2]) <= 31):
            raise ValueError(f"{text!r} is not a month and a day from 01-01 to 12-31")
        return 100 * int(match[1]) + int(match[2])
    if _WHOLE.fullmatch(text):
        return int(text)
    words = ", ".join(meaning for _, meaning in point.meanings)
    raise ValueError(f"{text!r} is not a whole number" + (f", nor one of {words}" if words else ""))


def _is_word(text: str, meaning: str) -> bool:
    """Whether it is the same words, joined in another way: CleanToDirty, clean_to_dirty."""
    plain = re.sub("[ _-]", "", text).casefold()
    return text[:1].isalpha() and plain == re.sub("[ _-]", "", meaning).casefold()


def _seconds(text: str) -> int:
    match = _MINUTES_SECONDS.fullmatch(text)
    if match is not None and int(match[2]) < 60:
        return 60 * int(match[1]) + int(match[2])
    try:
        nanoseconds = parse_duration(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a time like 10s, 2min or 01:30 (MM:SS)") from None
    if nanoseconds % _SECOND:
        raise ValueError(f"{text!r} is not a whole number of seconds")
    return nanoseconds // _SECOND


def word_of(type_: WordType, number: int) -> int:
    if type_ is WordType.MINUTES_SECONDS:
        return number // 60 << 8 | number % 60
    if type_ is WordType.MONTH_DAY:
        return number // 100 << 8 | number % 100
    return number & 0xFFFF


def text_of(type_: WordType, number: int) -> str:
    if type_ is WordType.MINUTES_SECONDS:
        return f"{number // 60:02}:{number % 60:02}"
    if type_ is WordType.MONTH_DAY:
        return f"{number // 100:02}-{number % 100:02}"
    return str(number)


def problem_of(
    setting: Setting, points: Mapping[str, Point], number: int, selected: int | None
) -> str:
    """Why this number cannot be written; empty where it can.

    selected: number of the selector, None while it is not known: then any of the ranges will do.
    """
    point = points[setting.point]
    text = text_of(point.type, number)
    if not setting.ranges:
        if _is_allowed(setting, point, number):
            return ""
        return f"{setting.point}: {text} is not {allowed_text(setting, point)}"
    choices = [c for c in setting.ranges if selected is None or c.when == selected]
    if not choices and all(number in choice.numbers for choice in setting.ranges):
        return ""
    if not choices:
        meaning = dict(points[setting.selector].meanings).get(selected or 0, str(selected))
        return (
            f"{setting.point}: the document gives no range while {setting.selector} is {meaning}: "
            f"set {setting.selector} as well, to {_either([c.name for c in setting.ranges])}"
        )
    if any(number in choice.numbers or _fits(setting, choice, number) for choice in choices):
        return ""
    allowed = "; ".join(_range_text(setting, choice) for choice in choices)
    return f"{setting.point}: {text} is not one of {allowed}"


def _bounds(setting: Setting, point: Point) -> tuple[Decimal | None, Decimal | None]:
    return (point.low, point.high) if setting.low is None else (setting.low, setting.high)


def _is_allowed(setting: Setting, point: Point, number: int) -> bool:
    low, high = _bounds(setting, point)
    if low is None or high is None:
        return number in dict(point.meanings)
    return low <= number <= high


def _fits(setting: Setting, choice: Range, number: int) -> bool:
    return any(choice.low <= number * r.factor <= choice.high for r in setting.readings)


def allowed_text(setting: Setting, point: Point, selected: int | None = None) -> str:
    """What may be written, in words. selected: number of the selector; None = not known."""
    if setting.ranges:
        in_force = [choice for choice in setting.ranges if choice.when == selected]
        return "; ".join(_range_text(setting, choice) for choice in in_force or setting.ranges)
    low, high = _bounds(setting, point)
    if low is None or high is None or len(point.meanings) == high - low + 1:
        return _either([f"{number} ({meaning})" for number, meaning in point.meanings])
    return f"{text_of(point.type, int(low))} to {text_of(point.type, int(high))}"


def _range_text(setting: Setting, choice: Range) -> str:
    """Whole numbers that any of the readings allows."""
    low = min(choice.low / reading.factor for reading in setting.readings)
    high = max(choice.high / reading.factor for reading in setting.readings)
    numbers = ", ".join(map(str, sorted(choice.numbers)))
    return f"{numbers}, {low:f} to {high:f} ({choice.name})"


def _either(texts: Sequence[str]) -> str:
    return " or ".join([", ".join(texts[:-1]), texts[-1]]) if len(texts) > 1 else texts[0]


def readings_of(
    setting: Setting, point: Point, number: int, selected: int | None
) -> tuple[ReadingOf, ...]:
    """Nothing where all readings are the same: zero, and numbers with a meaning of their own."""
    if number == 0 or number in dict(point.meanings):
        return ()
    choice = next((c for c in setting.ranges if c.when == selected), None)
    found = []
    for reading in setting.readings:
        value = number * reading.factor
        inside = None if choice is None else choice.low <= value <= choice.high
        found.append(ReadingOf(reading.name, value, inside))
    return tuple(found)

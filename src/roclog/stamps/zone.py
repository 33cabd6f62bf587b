"""Time zones: local time with its summer time bit to UTC, and back."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from functools import lru_cache
from typing import Final
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from roclog.stamps.fields import DAY_MS
from roclog.time_flags import TimeFlag

_OFFSET = re.compile(r"([+-])(\d\d):(\d\d)", re.ASCII)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_+-]*(/[A-Za-z0-9_+-]+)*", re.ASCII)
_LOCAL: Final = datetime(1970, 1, 1)  # noqa: DTZ001 - local time, its zone is put on later
_MILLISECOND: Final = timedelta(milliseconds=1)
_ZERO: Final = timedelta(0)
_DAYS_OF_YEAR: Final = range(1, 365, 4)
"""No zone has kept to another time for less than four days."""


def parse_zone(text: str) -> Zone:
    """The zone of ``"UTC"``, a fixed offset like ``"+01:00"``, or a name like ``"Europe/Berlin"``.

    Raises:
        ValueError: none of these, or this machine has no table for it.
    """
    if text == "UTC":
        return Zone(text, UTC)
    if match := _OFFSET.fullmatch(text):
        hours, minutes = int(match[2]), int(match[3])
        offset = timedelta(hours=hours, minutes=minutes) * (-1 if match[1] == "-" else 1)
        if minutes > 59 or not timedelta(hours=-12) <= offset <= timedelta(hours=14):
            raise ValueError(f"{text!r} is not an offset from UTC: -12:00 to +14:00")
        return Zone(text, timezone(offset))
    if _NAME.fullmatch(text) and text != "localtime":  # that one depends on the machine
        table = _table(text)
        if table is not None:
            return Zone(text, table)
        if _table("Europe/Berlin") is None:
            raise ValueError(
                f"{text!r} cannot be looked up: this machine has no time zone tables;"
                " install the Debian package tzdata or the Python package tzdata"
            )
    raise ValueError(
        f"{text!r} is not a time zone: UTC, an offset like +01:00, or a name like Europe/Berlin"
    )


def _table(name: str) -> ZoneInfo | None:
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):  # OSError: the name of a folder
        return None


class Zone:
    """A time zone. All times are milliseconds from 1970, local or UTC."""

    def __init__(self, name: str, table: tzinfo) -> None:
        self.name = name
        self._table = table
        self._has_short_winter = lru_cache(256)(self._look_for_short_winter)

    def __repr__(self) -> str:
        return f"Zone({self.name!r})"

    def resolve(self, local: int, su: int) -> tuple[int, int]:
        """UTC of a local time and its summer time bit, and flags.

        Where a flag says that the time does not exist or is undecided, UTC is only good for
        comparing it with times a day away.
        """
        first = (_LOCAL + local * _MILLISECOND).replace(tzinfo=self._table)
        second = first.replace(fold=1)
        before, after = _offset(first), _offset(second)
        if after > before:
            return local - before, TimeFlag.TIME_NONEXISTENT
        summers = self._is_summer(first), self._is_summer(second)
        if after == before:
            return local - before, 0 if summers[0] == su else TimeFlag.SU_CONTRADICTION
        if summers[0] != summers[1]:
            return local - (before if summers[0] == su else after), TimeFlag.TIME_AMBIGUOUS
        flags = 0 if summers[0] == su else int(TimeFlag.SU_CONTRADICTION)
        return local - before, flags | TimeFlag.TIME_UNDECIDED

    def local(self, utc: int) -> tuple[int, int]:
        """Local time of a UTC instant, and 1 where it is summer time."""
        moment = (_LOCAL + utc * _MILLISECOND).replace(tzinfo=UTC).astimezone(self._table)
        return utc + _offset(moment), self._is_summer(moment)

    def whole_day(self, midnight: int) -> tuple[int, int] | None:
        """Offset and summer time of a local day; None where one of them changes in its course."""
        found = set()
        for local in (midnight, midnight + DAY_MS):  # no zone changes twice within a day
            first = (_LOCAL + local * _MILLISECOND).replace(tzinfo=self._table)
            for moment in (first, first.replace(fold=1)):
                found.add((_offset(moment), self._is_summer(moment)))
        return found.pop() if len(found) == 1 else None

    def _is_summer(self, moment: datetime) -> int:
        """Whether clocks are ahead of the zone's standard; some zones' tables turn that round."""
        saving = moment.dst() or _ZERO
        if saving:
            return int(saving > _ZERO)
        return int(self._has_short_winter(moment.year))

    def _look_for_short_winter(self, year: int) -> bool:
        """Whether the table calls the time in summer standard and the winter's an hour less."""
        new_year = datetime(year, 1, 1, 12, tzinfo=self._table)
        return any(((new_year + timedelta(day)).dst() or _ZERO) < _ZERO for day in _DAYS_OF_YEAR)


def _offset(moment: datetime) -> int:
    offset = moment.utcoffset()
    assert offset is not None
    return offset // _MILLISECOND

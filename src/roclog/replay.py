"""Records again at the pace at which they were recorded, and as lines for people."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.quantities import format_instant
from roclog.recording.objects import TIME_FIELDS, fields_of, kind_of
from roclog.recording.records import Event, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from roclog.recording.records import Channel, Record

_NUMBERED: Final = re.compile(r"(.+)_\d+")
_UNITS: Final = {"Cel": "°C", "1/mL": "/mL", "[ppm]": "ppm", "1": ""}
_MOST_GROUPS: Final = 6
_SHORT: Final = {"iso_code": "ISO"}
_STAMPED: Final = frozenset({"address", "value", "change", "time_octets"})
"""Fields of a channel with one message for each change of an input."""
_MS: Final = 10**6


def logged_at(record: Record) -> int:
    """Host time, ns UTC."""
    return record.log_time


def happened_at(record: Record) -> int:
    """The device's own time of a sample that has one, else host time; ns UTC."""
    return (isinstance(record, Sample) and record.device_time) or record.log_time


def paced(
    records: Iterable[Record],
    speed: float | None,
    now: Callable[[], float],
    sleep: Callable[[float], None],
    instant: Callable[[Record], int] = logged_at,
) -> Iterator[Record]:
    """Each record when it is due: differences of its instant, divided by ``speed``.

    Where the instants step back, as with the wall clock, there is no wait. Waits do not add up:
    each is counted from the first record on.

    Args:
        records: in the order in which they come out.
        speed: above 0; None = as fast as possible.
        now: seconds of a monotonic clock.
        sleep: waits for seconds.
        instant: ns of a record.
    """
    due = begin = previous = None
    for record in records:
        if speed is not None:
            if begin is None or due is None or previous is None:
                begin, due = now(), 0.0
            else:
                due += max(0, instant(record) - previous) / 1e9 / speed
                wait = begin + due - now()
                if wait > 0:
                    sleep(wait)
            previous = instant(record)
        yield record


class Group(NamedTuple):
    """Fields shown together: points that are numbered alike and share a unit, or a single one."""

    label: str
    names: tuple[str, ...]
    unit: str


def groups(channel: Channel, values: Iterable[str]) -> list[Group]:
    """The values worth a place on a line: those with a unit first, then series, then others.

    values: the names of those that a sample has; another one of the channel may have others.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for name in values:
        unit = channel.units.get(name, "")
        match = _NUMBERED.fullmatch(name)
        found.setdefault((match[1] if match else name, unit), []).append(name)
    made = [
        Group(
            _SHORT.get(label, (label if len(names) > 1 else names[0]).replace("_", " ")),
            tuple(names),
            _UNITS.get(unit, unit),
        )
        for (label, unit), names in found.items()
    ]
    main = [group for group in made if _is_main(group)] or made
    return sorted(main, key=lambda group: (group.label != "ISO", not group.unit, -len(group.names)))


def _is_main(group: Group) -> bool:
    return bool(group.unit) or len(group.names) > 1 or group.label in _SHORT.values()


class Lines:
    """Records as aligned lines; columns only grow, so that neighbours stand below each other.

    Args:
        channels: of the recording, by topic.
        instant: logged_at or happened_at, the time that a line begins with.
    """

    def __init__(
        self, channels: Mapping[str, Channel], instant: Callable[[Record], int] = logged_at
    ) -> None:
        self._channels = channels
        self._instant = instant
        self._groups: dict[tuple[str, tuple[str, ...]], list[Group]] = {}
        self._widths: dict[tuple[str, int], int] = {}

    def line(self, record: Record) -> str:
        head = [self._fit("", 0, _to_the_millisecond(self._instant(record)))]
        if isinstance(record, Sample):
            cells = [record.device, record.block, *self._sample(record)]
        elif isinstance(record, Event):
            cells = [record.device or "-", record.level, f"{record.kind}: {record.text}"]
        else:
            cells = [record.device, kind_of(record), *_named(fields_of(record))]
        layout = record.topic if isinstance(record, Sample) else kind_of(record)
        for column, cell in enumerate(cells, start=1):
            head.append(self._fit("" if column < 3 else layout, column, cell))
        return "  ".join(head).rstrip()

    def _sample(self, sample: Sample) -> Iterator[str]:
        if sample.values.keys() >= _STAMPED:
            yield from self._event(sample)
            return
        shape = sample.topic, tuple(sample.values)
        if shape not in self._groups:
            self._groups[shape] = groups(self._channels[sample.topic], sample.values)
        shown = self._groups[shape]
        flags = [name for name, value in sample.values.items() if value is True]
        plain = [g for g in shown if not isinstance(sample.values[g.names[0]], bool)]
        for group in plain[:_MOST_GROUPS]:
            values = [self._value(sample, name) for name in group.names]
            unit = f" {group.unit}" if group.unit else ""
            text = " ".join(value.rjust(self._width(group, value)) for value in values)
            yield f"{group.label} {text}{unit}"
        if len(plain) > _MOST_GROUPS:
            flags.append(f"and {len(plain) - _MOST_GROUPS} more")
        if sample.redelivered:
            flags.append("redelivered")
        if sample.origin == "changed":
            flags.append("changed")
        if self._instant is happened_at and sample.device_time is None:
            flags.append("host time")
        yield " ".join(flags)

    def _event(self, sample: Sample) -> Iterator[str]:
        """A change of an input: its address and value, what changed, and what its stamp says."""
        values = sample.values
        known = sample.device_time
        value = str(values["value"])
        width = self._width(Group(f"value {sample.topic}", ("value",), ""), value)
        yield f"{values['address']!s:>5} = {value.rjust(width)}"
        yield str(values["change"]).replace("_", " ")
        if self._instant is logged_at:
            yield "no device time" if known is None else f"device {_to_the_millisecond(known)}"
        notes = list(sample.time_flags)
        if known is None and self._instant is not logged_at:
            notes.insert(0, "host time:")
        if values.get("hidden"):
            notes.append("went away and came back unseen")
        yield " ".join(notes)

    def _value(self, sample: Sample, name: str) -> str:
        value = sample.values.get(name)
        doubt = "?" if name in sample.doubtful else ""
        if value is None:
            return "-"
        if isinstance(value, float):
            return f"{value:.10g}" + (".0" if value == int_or_none(value) else "") + doubt
        return (value.hex() if isinstance(value, bytes) else str(value)) + doubt

    def _width(self, group: Group, text: str) -> int:
        key = (f"value {group.label}", 0)
        self._widths[key] = max(self._widths.get(key, 0), len(text))
        return self._widths[key]

    def _fit(self, layout: str, column: int, text: str) -> str:
        key = (layout, column)
        self._widths[key] = max(self._widths.get(key, 0), len(text))
        return text.ljust(self._widths[key])


def _to_the_millisecond(nanoseconds: int) -> str:
    text = format_instant(nanoseconds // _MS * _MS)
    return f"{text[:19]}.{nanoseconds // _MS % 1000:03d}Z"


def int_or_none(value: float) -> int | None:
    """The integer that a float is, if its shortest text would show no decimals."""
    return int(value) if abs(value) < 1e9 and value == int(value) else None


def _named(values: Mapping[str, object]) -> Iterator[str]:
    for name, value in values.items():
        if isinstance(value, int) and name in TIME_FIELDS:
            yield f"{name} {format_instant(value // 10**6 * 10**6)}"
        elif not isinstance(value, bytes) and value not in (0, False, ""):
            yield f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"

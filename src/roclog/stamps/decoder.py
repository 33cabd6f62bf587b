"""Stamps to UTC, one device at a time. Never a refusal: what spoils a time is a flag."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.stamps.fields import (
    DAY_MS,
    MINUTE_MS,
    YEAR_PIVOT,
    check_pivot,
    check_size,
    date_octets,
    hour_octet,
    minute_octet,
)
from roclog.stamps.zone import Zone, parse_zone
from roclog.time_flags import TimeFlag, is_trusted

if TYPE_CHECKING:
    from collections.abc import Sequence

TOLERANCE: Final = 600 * 10**9
"""Nanoseconds a device's clock may be ahead of the host's; less than any mistake in the zone."""
UTC_ZONE: Final = parse_zone("UTC")
_END_OF_TIME: Final = 2**63
_KEPT: Final = 1024
"""Days that a decoder remembers, in each of its memories."""
_HALF_DAY: Final = DAY_MS // 2
_NS: Final = 10**6
_MINUTES: Final = tuple(minute_octet(octet) for octet in range(256))
_HOURS: Final = tuple(hour_octet(octet) for octet in range(256))
_UNPLACED: Final = int(
    TimeFlag.NO_TIME | TimeFlag.DATE_INVALID | TimeFlag.MINUTE_RANGE | TimeFlag.HOUR_RANGE
)
"""Without these, date, hour and minute are a local time."""
_OF_THE_ZONE: Final = int(TimeFlag.SU_CONTRADICTION | TimeFlag.LENIENT)
_DOUBTFUL: Final = int(TimeFlag.MS_RANGE | TimeFlag.SU_CONTRADICTION)
_DAY_NS: Final = DAY_MS * _NS
_NEVER: Final = 2**70
_MINUTE_NS: Final = [_NEVER if flags else past * _NS for past, flags in _MINUTES]
"""Of minute octets without any flag; the others lead out of every range."""
_HOUR_NS: Final = [
    [
        past * _NS if mark == su and not flags & ~TimeFlag.SU else _NEVER
        for past, mark, flags in _HOURS
    ]
    for su in (0, 1)
]
_DATED: Final = struct.Struct("<HBB3s")
_new: Final = tuple.__new__  # half the time of the named tuple's own
_DATELESS: Final = struct.Struct("<HBB")
_NO_TIME: Final = int(TimeFlag.NO_TIME)
_DATE_INFERRED: Final = int(TimeFlag.DATE_INFERRED)
_DATE_UNKNOWN: Final = int(TimeFlag.DATE_UNKNOWN)
_NONEXISTENT: Final = int(TimeFlag.TIME_NONEXISTENT)


class Stamp(NamedTuple):
    """One stamp as it is recorded.

    octets: as on the wire. device_time: nanoseconds UTC, 0 = unknown, and then flags say why.
    """

    octets: bytes
    device_time: int
    flags: TimeFlag

    def marked(self, flags: TimeFlag) -> Stamp:
        """The same with more flags, and without its time where they spoil it."""
        both = self.flags | flags
        return Stamp(self.octets, self.device_time if is_trusted(both) else 0, both)


class _Day(NamedTuple):
    """One local day. midnight: its first millisecond as if local were UTC, None = there is no date.

    flags: for either value of the summer time bit.
    offset: local less UTC in milliseconds, None where the time changes in the course of the day.
    summer: 1 where all of it is summer time.
    """

    midnight: int | None
    flags: tuple[int, int] = (0, 0)
    offset: int | None = None
    summer: int = 0


class StampDecoder:
    """Decodes the stamps of one device.

    zone: in which the device's clock runs.
    year_pivot: 70 to 100; two-digit years from here on belong to the 1900s (100: none does).
    lenient: let milliseconds above 59999 run over into the next minute, and let the zone overrule
    a summer time bit that contradicts it. Such a stamp is marked LENIENT.
    tolerance: nanoseconds that the device's clock may be ahead of the host's.
    """

    def __init__(
        self,
        zone: Zone = UTC_ZONE,
        *,
        year_pivot: int = YEAR_PIVOT,
        lenient: bool = False,
        tolerance: int = TOLERANCE,
    ) -> None:
        check_pivot(year_pivot)
        if not 0 <= tolerance <= _HALF_DAY * _NS:
            raise ValueError(f"a tolerance of {tolerance} ns is not between 0 and half a day")
        self.zone = zone
        self._pivot = year_pivot
        self._lenient = lenient
        self._tolerance = tolerance
        self._dates: dict[bytes, _Day] = {}
        self._days: dict[int, _Day] = {}
        self._usual: dict[bytes, tuple[int, list[int], TimeFlag]] = {}
        self._flags: dict[int, TimeFlag] = {}

    def decode(self, octets: bytes, *, read_at: int, changed_after: int | None) -> Stamp:
        """Decode one stamp of 7 or 4 octets.

        read_at: UTC ns, when the answer with it had come.
        changed_after: UTC ns, when a read still gave another stamp; None where there was none. A
        stamp of 4 octets gets its date from these two. To be safe from steps of the wall clock,
        pass read_at less the monotonic time between the two reads.

        Raises:
            ValueError: neither 7 nor 4 octets, or a read_at outside 1970 to 2262.
        """
        check_size(octets)
        return self.decode_all((octets,), read_at=read_at, changed_after=changed_after)[0]

    def decode_all(
        self, stamps: Sequence[bytes], *, read_at: int, changed_after: int | None
    ) -> list[Stamp]:
        """As ``decode``, for all stamps of one answer."""
        if not 0 <= read_at < _END_OF_TIME:
            raise ValueError(f"read_at {read_at} ns is not between 1970 and 2262")
        sizes = set(map(len, stamps))
        if sizes == {7}:
            return self._all_dated(stamps, read_at + self._tolerance)
        if sizes == {4}:
            return self._all_dateless(stamps, read_at, changed_after)
        for octets in stamps:
            check_size(octets)
        return [
            self.decode(octets, read_at=read_at, changed_after=changed_after) for octets in stamps
        ]

    def _all_dated(self, stamps: Sequence[bytes], limit: int) -> list[Stamp]:
        """Days that were met before are looked up; whatever is unusual takes the long way."""
        usual_days, decoded = self._usual, []
        for octets, (milliseconds, minute, hour, date) in zip(
            stamps, _DATED.iter_unpack(b"".join(stamps)), strict=True
        ):
            day = usual_days.get(date)
            if day is not None and milliseconds < MINUTE_MS:
                start, hours, flags = day
                device_time = start + hours[hour] + _MINUTE_NS[minute] + milliseconds * _NS
                if device_time <= limit:
                    decoded.append(_new(Stamp, (octets, device_time, flags)))
                    continue
            decoded.append(self._dated(octets, limit))
        return decoded

    def _dated(self, octets: bytes, limit: int) -> Stamp:
        day = self._dates.get(octets[4:]) or self._date(octets[4:])
        flags = _MINUTES[octets[2]][1] | _HOURS[octets[3]][2] | day.flags[octets[3] >> 7]
        if day.midnight is None or flags & _UNPLACED:
            flags &= ~_OF_THE_ZONE
            return self._stamp(octets, 0, flags | self._overrun(octets), limit)
        utc, more = self._place(octets, day)
        return self._stamp(octets, utc * _NS, flags | more, limit)

    def _all_dateless(
        self, stamps: Sequence[bytes], read_at: int, changed_after: int | None
    ) -> list[Stamp]:
        """As ``_all_dated``: the short way where clocks do not change around the host's day."""
        limit = read_at + self._tolerance
        today = self.zone.local(read_at // _NS)[0] // DAY_MS
        days = [self._day(today + n) for n in (-1, 0, 1)]
        midnight, _, offset, su = days[1]
        if changed_after is None or offset is None or any(d[1:] != days[1][1:] for d in days):
            return [self._dateless(o, days, limit, changed_after) for o in stamps]
        flag = self._flag(_DATE_INFERRED | (TimeFlag.SU if su else 0))
        assert midnight is not None
        start = (midnight - offset) * _NS
        low = max(1, changed_after - _HALF_DAY * _NS)
        high = min(_END_OF_TIME, changed_after - self._tolerance + _DAY_NS)
        hours, decoded = _HOUR_NS[su], []
        for octets, (milliseconds, minute, hour) in zip(
            stamps, _DATELESS.iter_unpack(b"".join(stamps)), strict=True
        ):
            past = hours[hour] + _MINUTE_NS[minute] + milliseconds * _NS
            if milliseconds < MINUTE_MS and (past or su):
                device_time = start + past
                if device_time > limit:
                    device_time -= _DAY_NS
                elif device_time + _DAY_NS <= limit:
                    device_time += _DAY_NS
                if low <= device_time < high:
                    decoded.append(_new(Stamp, (octets, device_time, flag)))
                    continue
            decoded.append(self._dateless(octets, days, limit, changed_after))
        return decoded

    def _dateless(
        self, octets: bytes, days: list[_Day], limit: int, changed_after: int | None
    ) -> Stamp:
        """A stamp without its date: the latest not after the read, where only that one fits."""
        flags = _MINUTES[octets[2]][1] | _HOURS[octets[3]][2]
        if not any(octets):  # as of a point that never changed; midnight cannot be told from it
            return self._stamp(octets, 0, _NO_TIME, limit)
        if flags & _UNPLACED:
            return self._stamp(octets, 0, flags | self._overrun(octets), limit)
        if changed_after is None:
            return self._stamp(octets, 0, flags | self._overrun(octets) | _DATE_UNKNOWN, limit)
        dated = [self._place(octets, day) for day in days]
        dated.sort(key=lambda placed: (placed[0], not placed[1] & _NONEXISTENT))
        fit = [(utc, more) for utc, more in dated if utc * _NS <= limit]
        utc, more = fit[-1] if fit else dated[0]
        too_old = not fit or utc * _NS < changed_after - _HALF_DAY * _NS
        others = [past for past, marks in fit[:-1] if not marks & _NONEXISTENT]
        twice = any(past * _NS >= changed_after - self._tolerance for past in others)
        flags |= more | (_DATE_UNKNOWN if too_old or twice else _DATE_INFERRED)
        return self._stamp(octets, utc * _NS, flags, limit)

    def _place(self, octets: bytes, day: _Day) -> tuple[int, int]:
        """UTC milliseconds on that day, and flags."""
        assert day.midnight is not None
        past_hours, su, _ = _HOURS[octets[3]]
        local = day.midnight + past_hours + _MINUTES[octets[2]][0]
        milliseconds = octets[0] | octets[1] << 8
        overrun = self._overrun(octets)
        if day.offset is not None:
            flags = day.flags[su] | overrun
            return local + milliseconds - day.offset, flags
        beyond = milliseconds if overrun else 0
        utc, flags = self.zone.resolve(local + milliseconds - beyond, su)
        return utc + beyond, flags | overrun | self._forgiven(flags)

    def _stamp(self, octets: bytes, device_time: int, flags: int, limit: int) -> Stamp:
        trusted = is_trusted(flags)
        if trusted and not 0 < device_time < _END_OF_TIME:
            trusted = False
            flags |= TimeFlag.DATE_INVALID
        if trusted and device_time > limit:
            flags |= TimeFlag.FUTURE
        return Stamp(octets, device_time if trusted else 0, self._flag(flags))

    def _overrun(self, octets: bytes) -> int:
        if octets[0] | octets[1] << 8 < MINUTE_MS:
            return 0
        return TimeFlag.MS_RANGE | self._forgiven(TimeFlag.MS_RANGE)

    def _forgiven(self, flags: int) -> int:
        return int(TimeFlag.LENIENT) if self._lenient and flags & _DOUBTFUL else 0

    def _flag(self, bits: int) -> TimeFlag:
        """Kept, since an enumeration is slow to make."""
        flag = self._flags.get(bits)
        if flag is None:
            flag = self._flags[int(bits)] = TimeFlag(bits)
        return flag

    def _date(self, octets: bytes) -> _Day:
        number, flags = date_octets(octets, self._pivot)
        if number is None:
            day = _Day(None, (flags, flags))
        else:
            plain = self._day(number)
            day = plain._replace(flags=(plain.flags[0] | flags, plain.flags[1] | flags))
        if len(self._dates) >= _KEPT:
            self._dates.clear()
            self._usual.clear()
        self._dates[octets] = day
        self._remember(octets, day, flags)
        return day

    def _remember(self, octets: bytes, day: _Day, flags: int) -> None:
        """The short way for stamps of a day on which clocks do not change."""
        if day.midnight is None or day.offset is None:
            return
        start = (day.midnight - day.offset) * _NS
        if start > 0:
            flag = self._flag(flags | (TimeFlag.SU if day.summer else 0))
            self._usual[octets] = start, _HOUR_NS[day.summer], flag

    def _day(self, number: int) -> _Day:
        day = self._days.get(number)
        if day is None:
            midnight = number * DAY_MS
            whole = self.zone.whole_day(midnight)
            if whole is None:
                day = _Day(midnight)
            else:
                offset, summer = whole
                wrong = TimeFlag.SU_CONTRADICTION | self._forgiven(TimeFlag.SU_CONTRADICTION)
                day = _Day(midnight, (wrong, 0) if summer else (0, wrong), offset, summer)
            if len(self._days) >= _KEPT:
                self._days.clear()
            self._days[number] = day
        return day

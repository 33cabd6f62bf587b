"""What happens on a half-duplex line, as arithmetic: no clock, no terminal, no thread.

All times are nanoseconds of one monotonic clock. Frames, the silence between them and the pause
of 1.5 characters that ends one follow the MODBUS over Serial Line guide V1.02, 2.5.1.1, with its
fixed times above 19200 baud.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Final

from roclog.simulators.serial_line.statistics import Lateness, Statistics

if TYPE_CHECKING:
    from collections.abc import Iterable

NS_PER_S: Final = 1_000_000_000
FIXED_ABOVE_BAUD: Final = 19_200
FIXED_SILENCE_NS: Final = 1_750_000
FIXED_PAUSE_NS: Final = 750_000
PAUSE_CHARACTERS: Final = 1.5
GARBLE: Final = 0x55
SENDER_BUFFER: Final = 4096
"""Octets that may wait for the line, as in the driver of a port."""


class Side(Enum):
    """The ends of the line."""

    CLIENT = 0
    SERVER = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSettings:
    """How a line is.

    Args:
        baud: Bits per second. None: octets take no time.
        character_bits: Bits of a character with start, parity and stop bits: 10 is 8N1, 11 is 8E1
            or 8N2.
        turnaround_ns: Time from the end of a request on the line to the beginning of its answer.
            A device that is ready sooner waits.
        usb_latency_ns: The client sees octets only at ticks this far apart, like the latency timer
            of a USB adapter; 0 is none. A full buffer of the adapter does not cut a tick short.
        silence_characters: Least silence before a request, in characters; at least 1.75 ms above
            19200 baud. A request after less is counted and carried nevertheless.
        silence_ns: The same as a time; counts instead of the characters when not None.
        fifo: Deliver octets that were sent together in groups of so many, when the last one of the
            group has arrived, as from the FIFO of a UART; worth it from 57600 baud.

    Raises:
        ValueError: A value that no line has.
    """

    baud: int | None = None
    character_bits: int = 10
    turnaround_ns: int = 0
    usb_latency_ns: int = 0
    silence_characters: float = 3.5
    silence_ns: int | None = None
    fifo: int = 1

    def __post_init__(self) -> None:
        if self.baud is not None and not 1 <= self.baud <= 10_000_000:
            raise ValueError(f"{self.baud} baud is not from 1 to 10000000")
        if not 7 <= self.character_bits <= 12:
            raise ValueError(f"{self.character_bits} bits are not a character: 7 to 12")
        if self.fifo < 1:
            raise ValueError(f"a FIFO of {self.fifo} octets is not possible")
        times = (self.turnaround_ns, self.usb_latency_ns, self.silence_ns or 0)
        if min(*times, self.silence_characters) < 0:
            raise ValueError("a time is negative")

    @property
    def character_ns(self) -> int:
        """How long an octet occupies the line."""
        return 0 if self.baud is None else round(self.character_bits * NS_PER_S / self.baud)

    @property
    def least_silence_ns(self) -> int:
        """Least silence before a request."""
        if self.silence_ns is not None:
            return self.silence_ns
        asked = round(self.silence_characters * self.character_ns)
        return max(asked, FIXED_SILENCE_NS) if self._is_fast else asked

    @property
    def pause_ns(self) -> int:
        """The longest pause inside a frame."""
        return FIXED_PAUSE_NS if self._is_fast else round(PAUSE_CHARACTERS * self.character_ns)

    @property
    def _is_fast(self) -> bool:
        return self.baud is not None and self.baud > FIXED_ABOVE_BAUD


@dataclass(slots=True)
class _Group:
    """Octets that are delivered together. `begin` and `end` are on the line, `due` is at the end
    of the line that receives them.
    """

    begin: int
    end: int
    due: int
    octets: bytearray
    garbled: set[int] = field(default_factory=set)


@dataclass(slots=True)
class _Sender:
    end: int | None = None
    """When its last octet leaves, or has left, the line."""
    frame_begin: int = 0
    is_spoilt: bool = False
    """Whether its present frame has been counted in a collision."""
    frames: int = 0
    octets: int = 0
    underway: deque[_Group] = field(default_factory=deque)


class Wire:
    """A line from `now` on.

    Octets go in with `send`, when a side has written them, and come out with `receive`; the times
    given to both never run backwards.
    """

    def __init__(self, settings: LineSettings, now: int) -> None:
        self._settings = settings
        self._character = settings.character_ns
        self._began = now
        self._senders = {Side.CLIENT: _Sender(), Side.SERVER: _Sender()}
        self._last_sender: Side | None = None
        self._request_end: int | None = None
        self._lateness = Lateness()
        self._crossed = 0
        self._short_gaps = 0
        self._collisions = 0
        self._garbled = 0
        self._late_answers = 0
        self._dropped = 0

    def send(self, side: Side, octets: bytes, now: int) -> None:
        """Put octets that `side` has written at `now` on the line, after those it wrote before."""
        sender, other = self._senders[side], self._senders[_opposite(side)]
        begin = self._begin(side, now)
        for at in range(0, len(octets), self._settings.fifo):
            part = bytearray(octets[at : at + self._settings.fifo])
            end = begin + len(part) * self._character
            group = _Group(begin, end, self._due(side, end), part)
            if other.end is not None and begin < other.end:
                self._collide(group, sender, other)
            sender.underway.append(group)
            begin = end
        sender.end = begin
        sender.octets += len(octets)

    def receive(self, side: Side, now: int) -> bytes:
        """Take the octets that have arrived at `side`."""
        octets = b""
        underway = self._senders[_opposite(side)].underway
        while underway and underway[0].due <= now:
            group = underway.popleft()
            octets += group.octets
            self._lateness.add(now - group.due)
            if side is Side.SERVER:
                self._request_end = group.end
        self._crossed += len(octets)
        return octets

    def drop(self, count: int) -> None:
        """Take note of received octets that could not be handed over."""
        self._dropped += count

    def next_due(self) -> int | None:
        """When there is something to receive next."""
        return min((each.underway[0].due for each in self._all() if each.underway), default=None)

    def has_room(self, side: Side, now: int) -> bool:
        """Tell whether `side` may send more, or enough of its octets wait for the line."""
        end = self._senders[side].end
        return end is None or end - now <= SENDER_BUFFER * self._character

    def statistics(self, now: int) -> Statistics:
        client, server = self._all()
        duration = max(now - self._began, 1)
        return Statistics(
            baud=self._settings.baud,
            duration_s=round(duration / NS_PER_S, 6),
            requests=client.frames,
            answers=server.frames,
            request_octets=client.octets,
            answer_octets=server.octets,
            short_gaps=self._short_gaps,
            collisions=self._collisions,
            garbled_octets=self._garbled,
            late_answers=self._late_answers,
            dropped_octets=self._dropped,
            busy=round(self._crossed * self._character / duration, 6),
            lateness_p50_ms=self._lateness.quantile_ms(0.5),
            lateness_p99_ms=self._lateness.quantile_ms(0.99),
            lateness_max_ms=self._lateness.most_ms,
        )

    def _all(self) -> tuple[_Sender, _Sender]:
        return self._senders[Side.CLIENT], self._senders[Side.SERVER]

    def _begin(self, side: Side, now: int) -> int:
        """Find when octets written now begin on the line, and whether a frame begins with them."""
        sender = self._senders[side]
        if sender.end is not None and now <= sender.end:
            return sender.end
        begin = now
        if side is Side.SERVER and self._request_end is not None:
            begin = self._after_turnaround(self._request_end, now)
            self._request_end = None
        if (
            sender.end is None
            or begin - sender.end > self._settings.pause_ns
            or self._last_sender is not side
        ):
            if side is Side.CLIENT:
                self._check_silence(begin)
            sender.frames += 1
            sender.frame_begin = begin
            sender.is_spoilt = False
        self._last_sender = side
        return begin

    def _after_turnaround(self, request_end: int, now: int) -> int:
        ready = request_end + self._settings.turnaround_ns
        if self._settings.turnaround_ns and now > ready:
            self._late_answers += 1
        return max(now, ready)

    def _check_silence(self, begin: int) -> None:
        # While the other side is still sending, this is a collision and no gap.
        ends = [e.end for e in self._all() if e.end is not None and e.frame_begin <= begin]
        if ends and 0 <= begin - max(ends) < self._settings.least_silence_ns:
            self._short_gaps += 1

    def _due(self, sender: Side, end: int) -> int:
        tick = self._settings.usb_latency_ns
        if sender is Side.CLIENT or not tick:
            return end
        return self._began + -(-(end - self._began) // tick) * tick

    def _collide(self, group: _Group, sender: _Sender, other: _Sender) -> None:
        for each in other.underway:
            begin, end = max(group.begin, each.begin), min(group.end, each.end)
            if begin < end:
                self._garble(group, begin, end)
                self._garble(each, begin, end)
                self._collisions += not sender.is_spoilt
                sender.is_spoilt = other.is_spoilt = True

    def _garble(self, group: _Group, begin: int, end: int) -> None:
        first = (begin - group.begin) // self._character
        behind = -(-(end - group.begin) // self._character)
        for place in _new(range(first, behind), group.garbled):
            group.octets[place] ^= GARBLE
            group.garbled.add(place)
            self._garbled += 1


def _opposite(side: Side) -> Side:
    return Side.SERVER if side is Side.CLIENT else Side.CLIENT


def _new(places: Iterable[int], known: set[int]) -> list[int]:
    return [place for place in places if place not in known]

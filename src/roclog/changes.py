"""What is new about an input that carries its own time stamp? Pure rules and their memory.

Reading changes nothing in the device, and the device keeps only the last state of each input: its
value and the stamp of its last change. So a state is known by its octets, and the rules are:

C1  An input that was never recorded: its state is the baseline, once in the life of a recording.
C2  Value or stamp differ from the state last recorded: a state of its own, recorded. ``changed``
    where both differ, ``restamped`` where only the stamp does, ``value_without_stamp`` where only
    the value does - a fault of the device worth seeing.
C3  Nothing differs: nothing is recorded, however often it is read, in this run or another.
C4  A stamp without a date gets its date when it is first seen. The date belongs to the state from
    then on: an input that stays as it is does not move to the next day with the host.
C5  What is remembered is what is on disk or on its way there. A change that was given up on the way
    is forgotten, and the next read shows it again. If a commit of it failed and the disk has it all
    the same, it is there twice then, under two numbers.

The latest state is never missed. What came and went between two reads cannot be seen: the time
between them says how much that may be, and ``Change.hidden`` what is certain. A state that equals
the one recorded last in value and octets is that state for anybody who reads; a 4-octet stamp
repeats to the millisecond a day later.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Resolve = Callable[[bytes, "ChangeKind"], tuple[int, int]]
    """Device time (UTC ns, 0 = unknown) and time flags of stamp octets seen for the first time.

    A baseline may be of any age: a stamp without a date gets the nearest one not later than the
    host's clock and a tolerance, and a flag that says so.
    """

_RUN: Final = struct.Struct(">HHB")
"""First address, number of inputs, octets of a stamp."""
_STATE: Final = struct.Struct(">HqI")
"""Value, device time, time flags; the stamp follows."""


class ChangeKind(StrEnum):
    """In what a state differs from the one recorded before it."""

    BASELINE = "baseline"
    CHANGED = "changed"
    RESTAMPED = "restamped"
    VALUE_WITHOUT_STAMP = "value_without_stamp"


@dataclass(frozen=True, slots=True)
class State:
    """One input at one time.

    value: 0 to 65535. stamp: as on the wire. device_time: UTC ns, 0 = unknown. time_flags: 32 bits.
    """

    value: int
    stamp: bytes
    device_time: int = 0
    time_flags: int = 0


@dataclass(frozen=True, slots=True)
class Change:
    """A state to record."""

    address: int
    kind: ChangeKind
    state: State

    def hidden(self, *, discrete: bool) -> int:
        """States that certainly came and went unseen, if the device stamps changes only.

        A single bit that is as it was under a new stamp went away and came back. A register may
        have been given the same value again, which hides nothing.
        """
        return 1 if discrete and self.kind is ChangeKind.RESTAMPED else 0


def judge(
    known: State | None, value: int, stamp: bytes, resolve: Resolve
) -> tuple[ChangeKind, State] | None:
    """Compare what was read with the state last recorded; None where it is that state.

    A stamp of another length belongs to another setting and compares with nothing: a baseline.
    """
    if known is None or len(known.stamp) != len(stamp):
        kind = ChangeKind.BASELINE
    elif stamp == known.stamp:
        if value == known.value:
            return None
        state = State(value, stamp, known.device_time, known.time_flags)
        return ChangeKind.VALUE_WITHOUT_STAMP, state
    else:
        kind = ChangeKind.RESTAMPED if value == known.value else ChangeKind.CHANGED
    return kind, State(value, stamp, *resolve(stamp, kind))


class ChangeMemory:
    """The latest state of each input of one table, recorded or on its way to the disk.

    Raises:
        ValueError: a text that ``text`` did not write.
    """

    def __init__(self, text: str = "") -> None:
        self._recorded = dict(_states(bytes.fromhex(text)))
        self._waiting: dict[int, Change] = {}

    def judge(self, address: int, value: int, stamp: bytes, resolve: Resolve) -> Change | None:
        """What there is to record of an input; not remembered before ``keep``."""
        waiting = self._waiting.get(address)
        known = self._recorded.get(address) if waiting is None else waiting.state
        found = judge(known, value, stamp, resolve)
        return None if found is None else Change(address, *found)

    def keep(self, change: Change) -> None:
        """It is on its way to the disk: the next read is compared with it."""
        self._waiting[change.address] = change

    def committed(self, change: Change) -> None:
        """It is on disk."""
        self.restore(change.address, change.state)
        self.give_up(change)

    def give_up(self, change: Change) -> None:
        """It will not get to the disk. A younger change of the same input waits on."""
        if self._waiting.get(change.address) is change:
            del self._waiting[change.address]

    def restore(self, address: int, state: State) -> None:
        """A state that was found on disk behind what the text says."""
        self._recorded[address] = state

    def text(self) -> str:
        """What holds once everything that waits is on disk, at 42 digits for each input at most.

        To be asked for when a commit begins: what is given up later must not be in it.
        """
        waiting = {address: change.state for address, change in self._waiting.items()}
        return b"".join(_runs(self._recorded | waiting)).hex()


def _runs(states: dict[int, State]) -> Iterator[bytes]:
    run: list[bytes] = []
    first, size = 0, 0
    for address in sorted(states):
        state = states[address]
        if run and (address != first + len(run) or len(state.stamp) != size):
            yield _RUN.pack(first, len(run), size) + b"".join(run)
            run = []
        if not run:
            first, size = address, len(state.stamp)
        head = _STATE.pack(state.value, state.device_time, state.time_flags)
        run.append(head + state.stamp)
    if run:
        yield _RUN.pack(first, len(run), size) + b"".join(run)


def _states(octets: bytes) -> Iterator[tuple[int, State]]:
    at = 0
    try:
        while at < len(octets):
            first, count, size = _RUN.unpack_from(octets, at)
            at += _RUN.size
            for address in range(first, first + count):
                head = _STATE.unpack_from(octets, at)
                at += _STATE.size + size
                yield address, State(head[0], octets[at - size : at], *head[1:])
            if first + count > 0x10000:
                raise ValueError(f"inputs beyond address 65535: {count} from {first} on")
    except struct.error:
        at = len(octets) + 1
    if at > len(octets):
        raise ValueError("a memory of changes that ends too early")

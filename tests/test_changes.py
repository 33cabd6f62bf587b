"""The change rules, their memory, and every order of changes, polls, disk faults and crashes.

The functions under test are the real ones; the model only plays the device, the queue and the disk
around them.

(a) What is on disk, without second copies of one number, are states that the device had, in the
    order in which it had them, each once.
(b) A state that two polls of one run saw in turn, with a commit that ended well in between, is on
    disk, unless it was given up in between, which is a gap on record.
(c) Whatever happened, one more poll and a commit that ends well put the present state on disk.
(d) Under one stamp there is one device time.

Taken for granted: no state comes back under its own stamp, and what is given up is not on disk.
"""

from __future__ import annotations

import json
import sys
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog import changes
from roclog.changes import Change, ChangeKind, ChangeMemory, State, judge

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.changes import Resolve

PROPERTY = settings(derandomize=True, deadline=None, max_examples=300)
STAMP, LATER = b"\1\0\0\0", b"\2\0\0\0"
DAY = 86_400_000_000_000


def resolve(stamp: bytes, kind: ChangeKind) -> tuple[int, int]:
    return 100 + stamp[0], int(kind is ChangeKind.BASELINE)


def never(stamp: bytes, kind: ChangeKind) -> tuple[int, int]:
    pytest.fail("a stamp that was seen before is not resolved again")


def test_the_four_kinds() -> None:
    known = State(5, STAMP, 101, 0)
    assert judge(None, 5, STAMP, resolve) == (ChangeKind.BASELINE, State(5, STAMP, 101, 1))
    assert judge(known, 5, STAMP, never) is None
    assert judge(known, 6, LATER, resolve) == (ChangeKind.CHANGED, State(6, LATER, 102, 0))
    assert judge(known, 5, LATER, resolve) == (ChangeKind.RESTAMPED, State(5, LATER, 102, 0))
    without = (ChangeKind.VALUE_WITHOUT_STAMP, State(6, STAMP, 101, 0))
    assert judge(known, 6, STAMP, never) == without
    assert [kind.value for kind in ChangeKind] == [
        "baseline", "changed", "restamped", "value_without_stamp",
    ]  # fmt: skip


def test_a_stamp_that_goes_back_is_a_change_like_any_other() -> None:
    found = judge(State(5, LATER), 5, STAMP, resolve)
    assert found is not None
    assert found[0] is ChangeKind.RESTAMPED


def test_a_stamp_of_another_length_begins_anew() -> None:
    found = judge(State(5, bytes(7)), 5, bytes(4), resolve)
    assert found is not None
    assert found[0] is ChangeKind.BASELINE


def test_what_is_certain_of_hidden_states() -> None:
    hidden = {
        kind: [Change(1, kind, State(1, STAMP)).hidden(discrete=bit) for bit in (True, False)]
        for kind in ChangeKind
    }
    assert hidden.pop(ChangeKind.RESTAMPED) == [1, 0]
    assert set(map(tuple, hidden.values())) == {(0, 0)}


@PROPERTY
@given(st.lists(st.integers(0, 1), min_size=1, max_size=8))
def test_hidden_is_never_more_than_there_was(values: list[int]) -> None:
    """A device that stamps each change, polled before the first and after the last of them."""
    history = [v for v, before in zip(values, [None, *values], strict=False) if v != before]
    first, last = history[0], history[-1]
    found = judge(State(first, b"\0"), last, bytes([len(history) - 1]), resolve)
    unseen = max(0, len(history) - 2)
    if found is None:
        assert unseen == 0
    else:
        assert Change(0, *found).hidden(discrete=True) <= unseen
        assert Change(0, *found).hidden(discrete=True) == (first == last)


def found_in(memory: ChangeMemory, value: int, stamp: bytes, address: int = 8) -> Change:
    change = memory.judge(address, value, stamp, resolve)
    assert change is not None
    return change


def test_nothing_is_remembered_before_it_is_kept() -> None:
    memory = ChangeMemory()
    change = found_in(memory, 1, STAMP)
    assert found_in(memory, 1, STAMP) == change
    memory.keep(change)
    assert memory.judge(8, 1, STAMP, never) is None
    memory.committed(change)
    assert memory.judge(8, 1, STAMP, never) is None


def test_what_is_given_up_is_shown_again() -> None:
    memory = ChangeMemory()
    base = found_in(memory, 0, STAMP)
    memory.keep(base)
    memory.committed(base)
    lost = found_in(memory, 1, LATER)
    memory.keep(lost)
    assert ChangeMemory(memory.text()).judge(8, 1, LATER, never) is None
    memory.give_up(lost)
    again = found_in(memory, 1, LATER)
    assert (again.kind, again.state) == (lost.kind, lost.state)
    assert found_in(ChangeMemory(memory.text()), 1, LATER).kind is ChangeKind.CHANGED


def test_giving_up_an_older_change_leaves_the_younger_waiting() -> None:
    """Also where both are the same state: value forth, back and forth again under one stamp."""
    memory = ChangeMemory()
    changes = []
    for value in (1, 0, 1):
        changes.append(found_in(memory, value, STAMP))
        memory.keep(changes[-1])
    memory.give_up(changes[0])
    assert memory.judge(8, 1, STAMP, never) is None
    memory.committed(changes[1])
    assert memory.judge(8, 1, STAMP, never) is None
    memory.committed(changes[2])
    assert memory.judge(8, 1, STAMP, never) is None
    assert found_in(memory, 0, STAMP).kind is ChangeKind.VALUE_WITHOUT_STAMP


def test_600_inputs_are_carried_in_26_kilobytes_of_json() -> None:
    memory = ChangeMemory()
    for address in (*range(196, 496), *range(1000, 1300)):
        stamp = bytes([address & 0xFF] * 7)
        memory.restore(address, State(1, stamp, 1_700_000_000 * 10**9 + address, 0x8001))
    carried = json.dumps({"points": memory.text()})
    assert len(carried) < 26_000
    restored = ChangeMemory(json.loads(carried)["points"])
    assert restored.judge(495, 1, bytes([495 & 0xFF] * 7), never) is None
    wrong = restored.judge(495, 0, bytes([495 & 0xFF] * 7), never)
    assert wrong is not None
    assert wrong.state.device_time == 1_700_000_000 * 10**9 + 495
    assert wrong.state.time_flags == 0x8001
    assert found_in(restored, 1, bytes(7), 500).kind is ChangeKind.BASELINE


states = st.builds(
    State,
    st.integers(0, 0xFFFF),
    st.one_of(st.binary(min_size=4, max_size=4), st.binary(min_size=7, max_size=7)),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(0, 2**32 - 1),
)


@PROPERTY
@given(st.dictionaries(st.one_of(st.integers(0, 9), st.integers(0, 0xFFFF)), states, max_size=20))
def test_a_memory_comes_back_whole(given_states: dict[int, State]) -> None:
    memory = ChangeMemory()
    for address, state in given_states.items():
        memory.restore(address, state)
    restored = ChangeMemory(memory.text())
    assert restored.text() == memory.text()
    for address, state in given_states.items():
        assert restored.judge(address, state.value, state.stamp, never) is None
        other = restored.judge(address, state.value ^ 1, state.stamp, never)
        assert other is not None
        assert (other.state.device_time, other.state.time_flags) == (
            state.device_time, state.time_flags,
        )  # fmt: skip


@pytest.mark.parametrize("text", ["0", "zz", "0008", "0008000104", "00080001040001", "ffff000204"])
def test_texts_that_are_no_memory(text: str) -> None:
    with pytest.raises(ValueError):
        ChangeMemory(text)


def test_a_memory_cut_anywhere_is_refused() -> None:
    memory = ChangeMemory()
    memory.restore(8, State(1, bytes(7)))
    memory.restore(9, State(1, bytes(7)))
    text = memory.text()
    for end in range(1, len(text)):
        with pytest.raises(ValueError):
            ChangeMemory(text[:end])
    far = "ffff000204" + "00" * 36
    with pytest.raises(ValueError, match="65535"):
        ChangeMemory(far)


def test_an_input_that_rests_does_not_move_to_another_day() -> None:
    """A 4-octet stamp is dated by the host's day; the date is given once."""
    memory = ChangeMemory()
    for day in range(5):
        today = (day * DAY, 0)
        change = memory.judge(8, 1, STAMP, lambda *_, today=today: today)
        assert (change is None) == (day > 0)
        if change is not None:
            memory.keep(change)
            memory.committed(change)
        memory = ChangeMemory(memory.text())
    late = memory.judge(8, 0, STAMP, lambda *_: (9 * DAY, 0))
    assert late is not None
    assert late.state.device_time == 0


# The model: one input, a queue of one change, and a disk that takes a batch whole or not at all.
# What a restart knows is the carried text at the head of the newest segment and the records behind.


class Record(NamedTuple):
    number: int
    value: int
    stamp: int
    time: int


class Queued(NamedTuple):
    record: Record
    change: Change


class Held(NamedTuple):
    """A ChangeMemory that can be compared."""

    recorded: tuple[tuple[int, State], ...] = ()
    waiting: tuple[Change, ...] = ()

    @classmethod
    def of(cls, memory: ChangeMemory) -> Held:
        return cls(tuple(memory._recorded.items()), tuple(memory._waiting.values()))

    def thaw(self) -> ChangeMemory:
        memory = ChangeMemory()
        for address, state in self.recorded:
            memory.restore(address, state)
        for change in self.waiting:
            memory.keep(change)
        return memory


class World(NamedTuple):
    """history: states of the device, value and stamp; the last one holds.

    seen: index of the state that the latest poll of this run saw, unless given up since.
    settled: a commit ended well since.
    proven: indices of states that must be on disk.
    tail: how many records of the disk are behind the carried text of the newest segment.
    changes, crashes, faults, days: how many more may happen. Polls and commits have no limit.
    """

    history: tuple[tuple[int, int], ...] = ((0, 0),)
    day: int = 0
    seen: int = -1
    settled: bool = False
    proven: frozenset[int] = frozenset()
    queue: tuple[Queued, ...] = ()
    memory: Held = Held()
    number: int = 0
    disk: tuple[Record, ...] = ()
    carry: str = ""
    tail: int = 0
    changes: int = 2
    crashes: int = 2
    faults: int = 1
    days: int = 1


class BrokenError(Exception):
    """One of (a) to (d) does not hold."""


@dataclass(frozen=True)
class Policy:
    """The logger around the rules.

    inherit: a restart begins with the carried text. replay: and with the records behind it.
    tell: the memory is told what the queue gives up.
    dated_once: a state that rests keeps its device time.
    """

    inherit: bool = True
    replay: bool = True
    tell: bool = True
    dated_once: bool = True


Step = tuple[str, World]


def stamp_octets(stamp: int) -> bytes:
    return stamp.to_bytes(4)


def steps(world: World, policy: Policy) -> Iterator[Step]:
    yield from device(world)
    yield poll(world, policy)
    yield "commit", commit(world)
    if world.faults and world.queue:
        faulty = world._replace(faults=world.faults - 1)
        yield "commit fails", faulty
        yield "commit fails, batch on disk", on_disk(faulty)
        if knows_its_disk(world):
            yield "given up", give_up(faulty, policy)
    if world.crashes:
        yield "crash", restart(world, policy)
        if world.queue:
            yield "crash, batch on disk", restart(on_disk(world), policy)


def device(world: World) -> Iterator[Step]:
    value, stamp = world.history[-1]
    if world.changes:
        for state in ((1 - value, stamp + 1), (value, stamp + 1), (1 - value, stamp)):
            if state not in world.history:  # no state comes back under its own stamp
                history = (*world.history, state)
                yield f"device {state}", world._replace(history=history, changes=world.changes - 1)
    if world.days:
        yield "midnight", world._replace(day=world.day + 1, days=world.days - 1)


def poll(world: World, policy: Policy) -> Step:
    """Judge the present state, queue what is new; a full queue gives up its oldest."""
    present = len(world.history) - 1
    value, stamp = world.history[present]
    memory = world.memory.thaw()
    device_time = 1 + world.day
    change = memory.judge(8, value, stamp_octets(stamp), lambda *_: (device_time, 0))
    if change is None and not policy.dated_once:
        again = State(value, stamp_octets(stamp), device_time)
        if again not in [state for _, state in world.memory.recorded]:
            change = Change(8, ChangeKind.RESTAMPED, again)
    queue, number = world.queue, world.number
    if change is not None:
        memory.keep(change)
        number += 1
        record = Record(number, value, stamp, change.state.device_time)
        queue = (*queue, Queued(record, change))
        if len(queue) > 1:
            if policy.tell:
                memory.give_up(queue[0].change)
            queue = queue[1:]
    sure = world.settled and world.seen == present
    return f"poll: {change and change.kind}", world._replace(
        seen=present, settled=False, proven=world.proven | {present} if sure else world.proven,
        queue=queue, memory=Held.of(memory), number=number,
    )  # fmt: skip


def give_up(world: World, policy: Policy) -> World:
    """The disk fails for so long that the changes of other inputs need the room."""
    memory = world.memory.thaw()
    for queued in world.queue if policy.tell else ():
        memory.give_up(queued.change)
    return world._replace(seen=-1, queue=(), memory=Held.of(memory))


def knows_its_disk(world: World) -> bool:
    """No commit that failed got to the disk all the same."""
    last = [(record.value, stamp_octets(record.stamp)) for record in world.disk[-1:]]
    return last == [(state.value, state.stamp) for _, state in world.memory.recorded]


def on_disk(world: World) -> World:
    records = tuple(queued.record for queued in world.queue)
    return world._replace(disk=world.disk + records, tail=world.tail + len(records))


def commit(world: World) -> World:
    memory = world.memory.thaw()
    promised = memory.text()
    for queued in world.queue:
        memory.committed(queued.change)
    assert memory.text() == promised
    return on_disk(world)._replace(settled=True, queue=(), memory=Held.of(memory))


def restart(world: World, policy: Policy) -> World:
    """The new run's segment begins with the text as the restart found it."""
    memory = ChangeMemory(world.carry if policy.inherit else "")
    tail = world.disk[len(world.disk) - world.tail :]
    for record in tail if policy.replay else ():
        memory.restore(8, State(record.value, stamp_octets(record.stamp), record.time))
    number = max((record.number for record in world.disk), default=0)
    return world._replace(
        seen=-1, settled=False, queue=(), memory=Held.of(memory), number=number,
        carry=memory.text(), tail=0, crashes=world.crashes - 1,
    )  # fmt: skip


def check(world: World, policy: Policy) -> None:
    kept = list(dict.fromkeys(world.disk))
    shown = [(record.value, record.stamp) for record in kept]
    if any(state not in world.history for state in shown):
        raise BrokenError("(a) a state that never was")
    order = [world.history.index(state) for state in shown]
    if order != sorted(set(order)):
        raise BrokenError(f"(a) order or copies: {kept}")
    if any(world.history[n] not in shown for n in world.proven):
        raise BrokenError("(b) a state seen twice is not on disk")
    after = commit(poll(world, policy)[1])
    if world.history[-1] not in [(record.value, record.stamp) for record in after.disk]:
        raise BrokenError("(c) the latest state is not on disk")
    times: dict[int, int] = {}
    for record in kept:
        if times.setdefault(record.stamp, record.time) != record.time:
            raise BrokenError(f"(d) another device time under the same stamp: {kept}")


def explore(policy: Policy, world: World) -> int:
    """Number of worlds that can be reached: all of them.

    Raises:
        BrokenError: with the trail to the first world that is wrong.
    """
    came_from: dict[World, tuple[str, World] | None] = {world: None}
    waiting = deque([world])
    while waiting:
        world = waiting.popleft()
        try:
            check(world, policy)
        except BrokenError as error:
            raise BrokenError(f"{error} after {', '.join(trail(came_from, world))}") from None
        for name, after in steps(world, policy):
            if after not in came_from:
                came_from[after] = (name, world)
                waiting.append(after)
    return len(came_from)


def trail(came_from: dict[World, tuple[str, World] | None], world: World) -> list[str]:
    names: list[str] = []
    while (step := came_from[world]) is not None:
        names.append(step[0])
        world = step[1]
    return names[::-1]


def test_every_order_of_everything() -> None:
    assert explore(Policy(), World()) > 50_000


@pytest.mark.parametrize(
    ("policy", "broken"),
    [
        pytest.param(Policy(inherit=False), r"\(a\) order or copies", id="no carried text"),
        pytest.param(Policy(replay=False), r"\(a\) order or copies", id="records unread"),
        pytest.param(Policy(tell=False), r"\(c\) the latest state", id="given up untold"),
        pytest.param(Policy(dated_once=False), r"\(a\) order or copies", id="dated anew"),
    ],
)
def test_without_a_rule_it_breaks(policy: Policy, broken: str) -> None:
    with pytest.raises(BrokenError, match=broken):
        explore(policy, World())


def broken_judge(
    known: State | None, value: int, stamp: bytes, resolve: Resolve, *, mistake: str
) -> tuple[ChangeKind, State] | None:
    """The rules with one of them wrong."""
    found = judge(known, value, stamp, resolve)
    if found is None or known is None:
        return found
    if mistake == "stamps do not count" and value == known.value:
        return None
    if mistake == "values do not count" and stamp == known.stamp:
        return None
    if mistake == "old stamps are dated anew" and stamp == known.stamp:
        return found[0], State(value, stamp, *resolve(stamp, found[0]))
    return found


@pytest.mark.parametrize(
    ("mistake", "broken"),
    [
        ("stamps do not count", r"\(c\)"),
        ("values do not count", r"\(c\)"),
        ("old stamps are dated anew", r"\(d\)"),
    ],
)
def test_without_a_comparison_it_breaks(
    mistake: str, broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(changes, "judge", partial(broken_judge, mistake=mistake))
    with pytest.raises(BrokenError, match=broken):
        explore(Policy(), World())


if __name__ == "__main__":
    # The long version: python tests/test_changes.py CHANGES CRASHES FAULTS
    budget = World(changes=int(sys.argv[1]), crashes=int(sys.argv[2]), faults=int(sys.argv[3]))
    print(f"{explore(Policy(), budget)} worlds, none wrong")

"""Explicit-state model of the handshake: every order of completions, crashes and lost messages.

The functions under test are the real ones; the model only plays the device, the disk, the wire and
the poller around them. ``counterexamples`` gives scripts on which other policies fail.
"""

from __future__ import annotations

import inspect
import sys
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from functools import cache
from itertools import product
from time import monotonic
from types import ModuleType
from typing import NamedTuple

import pytest

from roclog import handshake
from roclog.handshake import Memory, Note, Seen, Verdict, after_clear, judge, recover
from roclog.schema import ClearResult

Words = tuple[int, ...]
Judge = Callable[[Memory, Seen], tuple[Memory, Verdict]]

NOTHING = 0  # identity of what the device held before its first sample, or since a power-up
TORN = -1


class Act(Enum):
    """One step of a script. The first group is the device's part, the second the logger's."""

    COMPLETE = auto()  # words: the new sample; the flag goes up
    TEAR = auto()  # words: what the block shows in the middle of the update; flag: as it shows
    FINISH = auto()  # words: the new sample is whole; flag: as it shows
    POWER_UP = auto()
    OTHER_CLEAR = auto()  # by another master
    LATE_CLEAR = auto()  # a clear that got no answer takes effect

    READ = auto()  # words and flag: what the logger gets
    READ_FAILS = auto()
    COMMIT = auto()
    CLEAR = auto()  # how: what becomes of it
    CRASH = auto()  # how: what of the unsynced survives


@dataclass(frozen=True)
class Event:
    act: Act
    words: Words = ()
    flag: bool = False
    how: str = ""

    def __str__(self) -> str:
        block = f" {list(self.words)} flag {int(self.flag)}" if self.words else ""
        return f"{self.act.name.lower()}{block} {self.how}".rstrip()


@dataclass(frozen=True)
class World:
    """What can happen. ``samples[0]`` is the block before the first sample is complete."""

    samples: tuple[Words, ...]
    crashes: int = 0
    losses: int = 0
    late_clears: int = 0
    power_ups: int = 0
    tears: bool = False
    other_master: bool = False
    acknowledge: bool = True


class Order(Enum):
    COMMIT_FIRST = auto()
    CLEAR_FIRST = auto()


@dataclass(frozen=True)
class Policy:
    """The poller around the rules, and the rules.

    look: used instead of ``judge`` for the read right after a clear.
    guard: False = clear without asking whether another sample may have completed.
    resend: an unanswered clear is sent again at once.
    """

    judge: Judge = judge
    after_clear: Callable[[Memory, ClearResult], Memory] = after_clear
    recover: Callable[..., Memory] = recover
    order: Order = Order.COMMIT_FIRST
    look: Judge | None = None
    guard: bool = True
    resend: bool = False


class At(Enum):
    """Where the poller is."""

    IDLE = auto()
    LOOK = auto()
    COMMIT = auto()
    CLEAR = auto()
    RECHECK = auto()
    SEND = auto()


class Record(NamedTuple):
    seq: int
    payload: bytes
    sample: int
    durable: bool


class Kept(NamedTuple):
    """News in RAM, on the way to the disk."""

    seq: int
    payload: bytes
    sample: int


class State(NamedTuple):
    # The device. ``held``: identity of the block; ``rest``: what an update in progress still owes.
    begun: int
    words: Words
    flag: bool
    held: int
    updating: bool
    raise_flag: bool
    torn_read: bool
    late_clear: bool
    # The logger's RAM. ``candidate`` is the identity behind memory.candidate.
    at: At
    memory: Memory
    candidate: int
    news: tuple[Kept, ...]
    clear: bool
    guarded: bool
    shaky: bool
    # The disk. ``mark``: seq whose clear mark is there, never synced.
    disk: tuple[Record, ...]
    mark: int
    # What is left of the budgets.
    crashes: int
    losses: int
    late_clears: int
    power_ups: int
    # Ghosts: sets of samples as bit masks, and what the logger was last told.
    read: int
    excused: int
    distinct: int
    known_down: bool
    flagged: int


Step = tuple[Event, State]


class Violation(Exception):
    pass


def octets(words: Words) -> bytes:
    return b"".join(word.to_bytes(2) for word in words)


def after_reader(disk: tuple[Record, ...]) -> tuple[list[Record], set[int]]:
    """What a reader keeps: a copy is dropped only when seq and payload are equal."""
    first: dict[tuple[int, bytes], Record] = {}
    for record in disk:
        first.setdefault((record.seq, record.payload), record)
    kept = list(first.values())
    return kept, {record.sample for record in kept if record.sample > 0}


class Machine:
    """All steps of one policy in one world."""

    def __init__(self, world: World, policy: Policy) -> None:
        self.world = world
        self.policy = policy
        self.payloads = [octets(words) for words in world.samples]
        self.identical = len(set(self.payloads)) < len(self.payloads)
        self._judged: dict[tuple[object, ...], tuple[Memory, Verdict]] = {}

    def start(self) -> State:
        return State(
            begun=0, words=self.world.samples[0], flag=False, held=NOTHING, updating=False,
            raise_flag=False, torn_read=False, late_clear=False, at=At.IDLE,
            memory=self.policy.recover(0, None, cleared=True), candidate=TORN, news=(), clear=False,
            guarded=False, shaky=True, disk=(), mark=0, crashes=self.world.crashes,
            losses=self.world.losses, late_clears=self.world.late_clears,
            power_ups=self.world.power_ups, read=0, excused=0, distinct=0, known_down=False,
            flagged=NOTHING,
        )  # fmt: skip

    def steps(self, s: State) -> Iterator[Step]:
        yield from self._device(s)
        if s.crashes:
            yield from self._crash(s)
        if s.at in (At.IDLE, At.LOOK, At.RECHECK):
            yield from self._read(s)
        elif s.at is At.COMMIT:
            yield self._commit(s)
        elif s.at is At.CLEAR:
            yield from self._guard(s)
        else:
            yield from self._send(s)

    # The device.

    def _device(self, s: State) -> Iterator[Step]:
        if s.updating:
            yield self._finish(s)
        elif s.begun + 1 < len(self.world.samples):
            yield from self._begin(s)
        if s.power_ups:
            yield self._power_up(s)
        if self.world.other_master and s.flag:
            yield Event(Act.OTHER_CLEAR), s._replace(flag=False)
        if s.late_clear:
            yield Event(Act.LATE_CLEAR), s._replace(flag=False, late_clear=False)

    def _overwritten(self, s: State) -> int:
        """A sample that goes before any intact read of it is the cadence's to report."""
        unread = s.held > 0 and not s.read >> s.held & 1
        return s.excused | (1 << s.held if unread else 0)

    def _begin(self, s: State) -> Iterator[Step]:
        k = s.begun + 1
        new = self.world.samples[k]
        begun = s._replace(begun=k, shaky=True)
        whole = begun._replace(words=new, held=k, excused=self._overwritten(s))
        if self.identical and s.known_down:
            whole = whole._replace(distinct=s.distinct | 1 << k)
        yield Event(Act.COMPLETE, new, flag=True), whole._replace(flag=True, known_down=False)
        if not self.world.tears:
            return
        for cut, first in product(range(len(new) + 1), (True, False)):
            if (cut == 0 and not first) or (cut == len(new) and first):
                continue
            words = new[:cut] + s.words[cut:]
            flag = first or s.flag
            after = begun if cut == 0 else whole if cut == len(new) else whole._replace(held=TORN)
            event = Event(Act.TEAR, words, flag)
            yield event, after._replace(words=words, flag=flag, updating=True, raise_flag=not first)

    def _finish(self, s: State) -> Step:
        new = self.world.samples[s.begun]
        flag = s.flag or s.raise_flag
        excused = s.excused if s.held in (TORN, s.begun) else self._overwritten(s)
        after = s._replace(
            words=new, flag=flag, held=s.begun, updating=False, raise_flag=False, torn_read=False,
            excused=excused,
        )  # fmt: skip
        return Event(Act.FINISH, new, flag), after

    def _power_up(self, s: State) -> Step:
        zeros = (0,) * len(s.words)
        excused = self._overwritten(s)
        if s.updating and s.held != s.begun:
            excused |= 1 << s.begun  # never completed
        after = s._replace(
            words=zeros, flag=False, held=NOTHING, updating=False, raise_flag=False,
            torn_read=False, power_ups=s.power_ups - 1, excused=excused, shaky=True,
        )  # fmt: skip
        return Event(Act.POWER_UP), after

    # The logger.

    def _judge(self, s: State, seen: Seen) -> tuple[Memory, Verdict]:
        use = self.policy.look if s.at is At.LOOK and self.policy.look else self.policy.judge
        key = (s.memory, s.candidate, seen, seen.reading, use)
        if key not in self._judged:
            self._judged[key] = use(s.memory, seen)
        return self._judged[key]

    def _read(self, s: State) -> Iterator[Step]:
        if s.at is not At.IDLE:
            yield Event(Act.READ_FAILS), s._replace(at=At.IDLE, clear=False)
        if s.torn_read:
            return  # an update lasts at most across one read
        seen = Seen(s.flag, octets(s.words), s.held)
        memory, verdict = self._judge(s, seen)
        candidate = memory.candidate.reading if memory.candidate else TORN
        assert isinstance(candidate, int)
        news = tuple(Kept(n.seq, n.seen.payload, _identity(n.seen)) for n in verdict.news)
        self._check_verdict(s, seen, memory, verdict)
        after = s._replace(
            memory=memory, candidate=candidate, news=news, torn_read=s.updating,
            clear=verdict.clear and self.world.acknowledge, guarded=False,
            shaky=s.shaky and memory.candidate is not seen,
            known_down=self.identical and not seen.flag,
            flagged=s.held if seen.flag and s.held != TORN else s.flagged,
        )  # fmt: skip
        after = self._with_ghosts(s, after, seen, verdict)
        event = Event(Act.READ, s.words, s.flag)
        yield event, after._replace(at=self._next(after, rechecked=s.at is At.RECHECK))

    def _next(self, s: State, *, rechecked: bool) -> At:
        if s.clear and not s.news and rechecked:
            return At.SEND
        if s.clear and self.policy.order is Order.CLEAR_FIRST:
            return At.CLEAR
        if s.news:
            return At.COMMIT
        return At.CLEAR if s.clear else At.IDLE

    def _with_ghosts(self, s: State, after: State, seen: Seen, verdict: Verdict) -> State:
        baseline = Note.BASELINE.name in {note.name for note, _ in verdict.notes}
        if self._is_shown(s, after, seen) and not (baseline and s.held > 0):
            after = after._replace(read=after.read | 1 << s.held)
        if baseline and s.held > 0 and self.world.other_master:
            after = after._replace(excused=after.excused | 1 << s.held)
        quiet = not (verdict.news or verdict.again or verdict.clear or after.memory.candidate)
        if quiet and s.at is At.IDLE and not s.updating:
            self._check_quiet(after)
        return after

    def _is_shown(self, s: State, after: State, seen: Seen) -> bool:
        """Whether this read is an intact one of a block that the ones before it were not."""
        if s.held == TORN or (s.held == NOTHING and s.updating):
            return False
        if s.held == after.candidate or s.held in {kept.sample for kept in after.news}:
            return True
        candidate = s.memory.candidate
        return seen.payload not in (s.memory.payload, candidate and candidate.payload)

    def _commit(self, s: State) -> Step:
        chunk = tuple(Record(*kept, True) for kept in s.news)
        disk = s.disk + chunk
        self._check_disk(disk)
        more = s.clear and self.policy.order is Order.COMMIT_FIRST
        after = s._replace(disk=disk, news=(), at=At.CLEAR if more else At.IDLE)
        return Event(Act.COMMIT), after._replace(clear=more)

    def _guard(self, s: State) -> Iterator[Step]:
        """A guard that holds is right; that it does not hold says nothing."""
        if not self.policy.guard or not s.shaky:
            yield from self._send(s._replace(guarded=True))
        if self.policy.guard:
            yield from self._read(s._replace(at=At.RECHECK))

    def _send(self, s: State) -> Iterator[Step]:
        self._check_clear(s)
        down = s._replace(flag=False, excused=self._unguarded(s))
        mark = s.memory.seq
        kind = "guarded" if s.guarded else "unguarded"
        done = down._replace(mark=mark, known_down=self.identical)
        yield self._cleared(done, ClearResult.DONE, f"{kind}, done")
        if s.losses:
            s, down = s._replace(losses=s.losses - 1), down._replace(losses=s.losses - 1)
            yield self._cleared(s, ClearResult.REFUSED, f"{kind}, refused")
            yield self._cleared(s, ClearResult.UNANSWERED, f"{kind}, request lost")
            yield self._cleared(down, ClearResult.UNANSWERED, f"{kind}, answer lost")
        if s.late_clears and not s.late_clear:
            late = s._replace(late_clears=s.late_clears - 1, late_clear=True)
            yield self._cleared(late, ClearResult.UNANSWERED, f"{kind}, request late")

    def _unguarded(self, s: State) -> int:
        """An unguarded clear is in the recording; it may hit a sample that nothing tells apart."""
        hit = s.flag and s.held > 0 and not s.guarded and not s.distinct >> s.held & 1
        same = s.held > 0 and self.payloads[s.held] == s.memory.payload
        return s.excused | (1 << s.held if hit and same else 0)

    def _cleared(self, s: State, result: ClearResult, how: str) -> Step:
        at = At.COMMIT if s.news else At.LOOK if self.policy.look else At.IDLE
        if self.policy.resend and result is ClearResult.UNANSWERED:
            at = At.SEND
        memory = self.policy.after_clear(s.memory, result)
        return Event(Act.CLEAR, how=how), s._replace(
            memory=memory, at=at, clear=False, guarded=s.guarded and at is At.SEND
        )

    def _crash(self, s: State) -> Iterator[Step]:
        chunk = tuple(Record(*kept, False) for kept in s.news) if s.at is At.COMMIT else ()
        volatile = [i for i, record in enumerate(s.disk) if not record.durable]
        for fates in product((True, False), repeat=len(volatile)):
            lost = {i for i, kept in zip(volatile, fates, strict=True) if not kept}
            old = tuple(record for i, record in enumerate(s.disk) if i not in lost)
            for new in {(), chunk}:
                for mark in {0, s.mark}:
                    yield self._crashed(s, old + new, mark, bool(new))

    def _crashed(self, s: State, disk: tuple[Record, ...], mark: int, chunk: bool) -> Step:
        self._check_disk(disk)
        if disk:
            last = disk[-1]
            memory = self.policy.recover(last.seq, last.payload, cleared=mark == last.seq)
        else:
            memory = self.policy.recover(0, None, cleared=True)
        on_disk = sum({1 << record.sample for record in disk if record.sample > 0})
        gone = sum(1 << j for j in self._completed(s) if not on_disk >> j & 1 and j != s.held)
        survived = [name for name, kept in (("record", chunk), ("mark", mark)) if kept]
        event = Event(Act.CRASH, how=f"survived: {', '.join(survived) or 'what was synced'}")
        return event, s._replace(
            at=At.IDLE, memory=memory, candidate=TORN, news=(), clear=False, guarded=False,
            shaky=True, disk=disk, mark=mark, crashes=s.crashes - 1, read=on_disk,
            excused=s.excused | gone, distinct=0, known_down=False, flagged=NOTHING,
        )  # fmt: skip

    # Properties.

    def _completed(self, s: State) -> range:
        return range(1, s.begun + (not s.updating or s.held == s.begun))

    def check(self, s: State) -> None:
        """(a) A completed sample is on disk, in the device, in RAM, or its loss will be told."""
        _, kept = after_reader(s.disk)
        safe = kept | {s.held, s.candidate} | {n.sample for n in s.news}
        for j in self._completed(s):
            if j not in safe and not s.excused >> j & 1:
                raise Violation(f"sample {j} is lost")

    def _check_quiet(self, s: State) -> None:
        """(a) When the logger is content, what the device holds is on disk and its flag is down."""
        _, kept = after_reader(s.disk)
        if s.held > 0 and s.held not in kept and not s.excused >> s.held & 1:
            raise Violation(f"sample {s.held} will never be recorded")
        if s.flag and self.world.acknowledge:
            raise Violation("the flag stays up")

    def _check_disk(self, disk: tuple[Record, ...]) -> None:
        """(b) nothing twice, (c) no key conflict."""
        kept, samples = after_reader(disk)
        if sum(record.sample > 0 for record in kept) != len(samples):
            raise Violation("a sample is there twice")
        if len({record.seq for record in kept}) != len(kept):
            raise Violation("two payloads under one key")

    def _check_verdict(self, s: State, seen: Seen, memory: Memory, verdict: Verdict) -> None:
        """(c) Nothing invented; a block whose predecessor no read has shown is at least noted."""
        noted = [said for note, said in verdict.notes if note.name == Note.OVERTAKEN.name]
        for news in verdict.news:
            excuse = news.seen in noted and any(news.seen.payload) and self._unread_before(s)
            if _identity(news.seen) <= 0 and not excuse:
                raise Violation(f"{news.seen.payload.hex(' ', 2)} is no sample")
        if verdict.again and s.memory.candidate == seen and not verdict.news:
            raise Violation("the confirming read is read again for ever")

    def _unread_before(self, s: State) -> bool:
        """Whether some state since the last record went by without an intact read."""
        last = max((record.sample for record in s.disk), default=NOTHING)
        unread = any(not s.read >> j & 1 for j in range(last, s.begun))
        return unread or s.power_ups < self.world.power_ups

    def _check_clear(self, s: State) -> None:
        """(d) Never a clear before the sample last read with the flag is durable."""
        durable = {record.payload for record in s.disk if record.durable}
        if s.flagged > 0 and self.payloads[s.flagged] not in durable:
            raise Violation(f"sample {s.flagged} is cleared, but not committed")


def _identity(seen: Seen) -> int:
    assert isinstance(seen.reading, int)
    return seen.reading


@dataclass(frozen=True)
class Result:
    states: int
    violation: str = ""
    script: tuple[Event, ...] = ()

    def __str__(self) -> str:
        lines = [f"{self.states} states: {self.violation or 'no violation'}"]
        return "\n".join(lines + [f"  {n}. {e}" for n, e in enumerate(self.script, start=1)])


def explore(world: World, policy: Policy | None = None) -> Result:
    """Breadth first, so that the script of a violation is a shortest one."""
    machine = Machine(world, policy or Policy())
    start = machine.start()
    came: dict[State, tuple[State, Event] | None] = {start: None}
    queue = deque([start])
    while queue:
        state = queue.popleft()
        try:
            machine.check(state)
            for event, after in machine.steps(state):
                if after not in came:
                    came[after] = (state, event)
                    queue.append(after)
        except Violation as violation:
            return Result(len(came), str(violation), _script(came, state))
    return Result(len(came))


def _script(came: dict[State, tuple[State, Event] | None], state: State) -> tuple[Event, ...]:
    events: list[Event] = []
    step = came[state]
    while step is not None:
        events.append(step[1])
        step = came[step[0]]
    return tuple(reversed(events))

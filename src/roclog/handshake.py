"""Is this block a sample? The rules of the new-data handshake, as pure functions.

A device with a flag holds one sample. It completes a sample, raises the flag, and overwrites the
sample when the next one is complete, read or not. The client reads, commits, lowers the flag. What
can go wrong in between, and the rule that answers it:

R1  Flag up: a new sample, unless it is the last committed one whose clear is still owed.
R2  Flag down, payload not the one last kept: a sample whose flag somebody else, or our own clear of
    its predecessor, has lowered (origin CHANGED).
R3  The first block ever seen with the flag down is the baseline, not a sample.
R4  A payload of zeros behind a lowered flag is a device that has just powered up.
R5  News is confirmed by a second read with the same payload: a block may be read in the middle of
    its update. If the second differs, the first was torn when each of its words is either old or
    new; if any word is neither, it was a sample of its own, overtaken. That one is kept, and noted:
    it may still be torn if the state before it was never read, and nothing can tell any more.
R6  Same payload, flag up, clear still owed: the clear was lost. Clear again, record nothing.
R7  As R6, but first thing after a start: the crash may have come between write and sync, or between
    commit and clear. Record a copy under the same key, marked redelivered, then clear.

The functions know no time, no device and no disk. ``judge`` returns what to do and what will be
true once that is done; the caller adopts the new memory, keeps the news until they are committed,
and never clears before. The model in tests/test_handshake_model.py plays these very functions
against every order of completions, crashes and lost messages; each rule is needed there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum, auto

from roclog.schema import ClearResult, Origin


@dataclass(frozen=True, slots=True)
class Seen:
    """One read of a flagged block, reduced to what the rules look at.

    payload: the words whose change means another sample, two octets each.
    reading: whatever the caller wants back with the news (words and times); not compared.
    """

    flag: bool
    payload: bytes
    reading: object = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Memory:
    """What is known of a flagged block between two reads.

    seq: number of the last sample, 0 before the first.
    payload: of the last sample or of the baseline; None = the block was never seen.
    cleared: the flag of that sample is known to have been lowered.
    restarted: nothing was read yet in this run.
    dark: the latest read that was not news showed the zeros of a power-up.
    candidate: news that waits for its second read.
    """

    seq: int = 0
    payload: bytes | None = None
    cleared: bool = True
    restarted: bool = True
    dark: bool = False
    candidate: Seen | None = None


class Note(Enum):
    """What deserves an event beside, or instead of, a sample."""

    BASELINE = auto()
    POWER_UP = auto()
    TORN = auto()
    OVERTAKEN = auto()
    REDELIVERED = auto()


@dataclass(frozen=True, slots=True)
class News:
    """A sample to commit."""

    seen: Seen
    seq: int
    origin: Origin
    redelivered: bool = False


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to do about a read: commit ``news`` in order, read ``again`` soon, then ``clear``."""

    news: tuple[News, ...] = ()
    again: bool = False
    clear: bool = False
    notes: tuple[tuple[Note, Seen], ...] = ()


def judge(memory: Memory, seen: Seen) -> tuple[Memory, Verdict]:
    """Apply the rules to one read."""
    if memory.candidate is None:
        return _first_look(memory, seen)
    if seen.payload == memory.candidate.payload:
        return _confirmed(memory, memory.candidate, seen)
    first = memory.candidate
    memory = replace(memory, candidate=None)
    if _is_torn(first.payload, memory, seen.payload):
        memory, verdict = _first_look(memory, seen)
        return memory, replace(verdict, notes=((Note.TORN, first), *verdict.notes))
    memory, overtaken = _keep(memory, first, cleared=not first.flag)
    memory, verdict = _first_look(memory, seen)
    notes = ((Note.OVERTAKEN, first), *verdict.notes)
    return memory, replace(verdict, news=(overtaken, *verdict.news), notes=notes)


def after_clear(memory: Memory, result: ClearResult) -> Memory:
    """Only an answered clear is known to have lowered the flag; otherwise the next read tells."""
    return replace(memory, cleared=True) if result is ClearResult.DONE else memory


def recover(seq: int, payload: bytes | None, *, cleared: bool) -> Memory:
    """Memory at the start of a run, from what the recording says; all unknown is Memory()."""
    return Memory(seq=seq, payload=payload, cleared=cleared, restarted=True)


def _first_look(memory: Memory, seen: Seen) -> tuple[Memory, Verdict]:
    restarted = memory.restarted
    owed = not memory.cleared and seen.flag and seen.payload == memory.payload
    memory = replace(memory, restarted=False, cleared=memory.cleared or not seen.flag)
    if owed and not restarted:
        verdict = Verdict(clear=True)
    elif owed:
        copy = News(seen, memory.seq, Origin.FLAG, redelivered=True)
        verdict = Verdict((copy,), clear=True, notes=((Note.REDELIVERED, seen),))
    elif seen.flag:
        memory, verdict = replace(memory, candidate=seen), Verdict(again=True)
    elif memory.payload is None:
        verdict = Verdict(notes=((Note.BASELINE, seen),))
        memory = replace(memory, payload=seen.payload)
    elif seen.payload == memory.payload:
        memory, verdict = replace(memory, dark=False), Verdict()
    elif any(seen.payload):
        memory, verdict = replace(memory, candidate=seen), Verdict(again=True)
    else:
        verdict = Verdict() if memory.dark else Verdict(notes=((Note.POWER_UP, seen),))
        memory = replace(memory, dark=True)
    return memory, verdict


def _confirmed(memory: Memory, first: Seen, second: Seen) -> tuple[Memory, Verdict]:
    kept = second if second.flag and not first.flag else first
    memory = replace(memory, candidate=None)
    memory, news = _keep(memory, kept, cleared=not second.flag)
    return memory, Verdict(news=(news,), clear=second.flag)


def _keep(memory: Memory, seen: Seen, *, cleared: bool) -> tuple[Memory, News]:
    news = News(seen, memory.seq + 1, Origin.FLAG if seen.flag else Origin.CHANGED)
    memory = replace(memory, seq=news.seq, payload=seen.payload, cleared=cleared, dark=False)
    return memory, news


def _is_torn(first: bytes, memory: Memory, second: bytes) -> bool:
    """Whether every word of ``first`` is a word of the state before it or of the state after it."""
    # The state before is the one last kept, or the zeros of a power-up that no read has shown.
    states = (memory.payload or b"", bytes(len(first)), second)
    return all(
        any(first[i : i + 2] == state[i : i + 2] for state in states)
        for i in range(0, len(first), 2)
    )

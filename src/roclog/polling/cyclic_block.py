"""One block without a flag: which of its reads are samples, and what was missed between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.register_map import ClearOnRead, Counter
from roclog.samples import Reading
from roclog.schema import Reason
from roclog.triggers import Finding, Known, judge

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roclog.bus.bus import Answer
    from roclog.clock import Instant
    from roclog.outbox import Outbox
    from roclog.recording.entries import Entry
    from roclog.samples import SampleMaker
    from roclog.triggers import Note

_SHORTEST_PERCENT: Final = 95
"""Of the time between two samples, that a device may be early by its own clock."""


class CyclicBlock:
    """Judges the reads of one block, numbers its samples and counts what was missed between them.

    period: nanoseconds between reads. known: what earlier runs leave; raw: octets of their last
    sample, where a trigger compares with it.
    read_until: UTC ns at which an earlier run last read the block, 0 = never.
    cycle: nanoseconds between samples of the device, None = not known.
    """

    def __init__(
        self,
        maker: SampleMaker,
        period: int,
        known: Known | None = None,
        read_until: int = 0,
        raw: bytes = b"",
        *,
        cycle: int | None = None,
    ) -> None:
        self.maker = maker
        self._period = period
        self._cycle = cycle
        self._known = known or Known()
        self._read_until = read_until
        self._last: Instant | None = None
        self._seen: Instant | None = None
        self._began = self._reckoned = 0
        self._is_lost = False
        self._raw = raw
        self._told: Note | None = None

    @property
    def seq(self) -> int:
        """Number of the last sample."""
        return self._known.seq

    def begin(self, due: int) -> None:
        """The first turn of a run is due at this monotonic nanosecond."""
        self._began, self._reckoned = due, due - self._period

    def take(
        self, octets: bytes, answer: Answer, asked: Instant, outbox: Outbox, *, due: int
    ) -> Entry | None:
        """One read, and its sample if it is one.

        asked: of its first request, where several were needed. due: when its turn was.
        """
        seen, self._seen = self._seen, self._seen_by(asked, answer.read)
        words = self.maker.words(octets)
        most = self._most(seen, answer.read)
        counts = self._counts
        self._known, finding = judge(
            self.maker.block, self._known, words, self.maker.order, most=most
        )
        self._tell_missed(finding, seen, answer.read, outbox)
        self._tell_unread(seen, due, answer.read, outbox, is_told=counts)
        if finding.note is not self._told:
            self._told = finding.note
            if finding.note is not None:
                outbox.event(
                    "warning", "counter", f"{finding.note.name.lower()}: {octets.hex(' ')}"
                )
        if finding.origin is None:
            return None
        self._raw = octets
        previous = seen.utc if seen is not None else 0
        reading = Reading(words, asked, answer.began, answer.read, previous)
        carry = self._carry(self._seen, answer.read)
        entry = self.maker.message(reading, self.seq, finding.origin, carry)
        outbox.add(entry)
        return entry

    def skip(self, answer: Answer, outbox: Outbox, *, due: int) -> None:
        """A flag outside the block says in ``answer`` that there is nothing new in it."""
        seen, self._seen = self._seen, answer.asked
        self._tell_unread(seen, due, answer.read, outbox, is_told=False)

    def lose(self) -> None:
        """An answer never came; where a read lowers the flag it may have taken a sample with it."""
        self._is_lost = isinstance(self.maker.block.trigger, ClearOnRead)

    def close(self, latest: int, now: Instant, outbox: Outbox, *, is_end: bool) -> None:
        """Let the next run know until when this one has read, or told what it has not.

        Where samples are numbered the next number tells everything since the last one.

        latest: when the last turn was due. is_end: of the run; else the turn in hand is for the
        next device to bring.
        """
        carry = None if self._seen is None else self._carry(self._seen, now)
        if latest - self._reckoned >= self._period or self._is_lost:
            until = now.monotonic if is_end else latest
            gap = self._unread(self._seen, self._left_out(until, now), now)
            carry = carry if self._counts else self._carry(now, now)
            outbox.add(gap._replace(carry=carry, carry_topic=self.maker.topic))
        elif carry is not None and outbox.empty:
            outbox.checkpoint(self.maker.topic, carry)

    def _left_out(self, until: int, now: Instant) -> int:
        """Turns until a monotonic instant since the last that brought a sample, in any run."""
        if self._seen is None and self._read_until:
            return (now.utc - self._since(None, now)) // self._period
        return (until - self._reckoned) // self._period

    @property
    def _counts(self) -> bool:
        """The device numbers its samples, and the last number is known: the next one tells."""
        return isinstance(self.maker.block.trigger, Counter) and self._known.payload is not None

    def _seen_by(self, asked: Instant, read: Instant) -> Instant:
        """What the device did later, this read does not show.

        A sample may complete while the answer without it is on the wire. Where every read is a
        sample, its own time is all that counts.
        """
        return read if self.maker.block.trigger is None else asked

    def _most(self, seen: Instant | None, read: Instant) -> int | None:
        """Samples that the device can have completed since the last read; None = not known."""
        if self._cycle is None or not (seen or self._read_until):
            return None
        since = read.monotonic - seen.monotonic if seen else read.utc - self._read_until
        return max(0, since) * 100 // (self._cycle * _SHORTEST_PERCENT) + 1

    def _tell_missed(
        self, finding: Finding, seen: Instant | None, read: Instant, outbox: Outbox
    ) -> None:
        """What the number of a sample tells of those before it."""
        if finding.missed:
            since = self._since(seen, read) if seen is not None or self._read_until else read.utc
            reason = Reason.OVERWRITTEN if seen is not None else Reason.DOWNTIME
            gap = self.maker.gap(
                since, read.utc, finding.missed, reason, read.utc, possible=finding.possible
            )
            outbox.add(gap)

    def _tell_unread(
        self, seen: Instant | None, due: int, read: Instant, outbox: Outbox, *, is_told: bool
    ) -> None:
        """What was not read before this read. is_told: by the number of its sample, if any."""
        unread = self._reckon(due, read)
        is_lost, self._is_lost = self._is_lost, False
        is_first = seen is None and self._read_until > 0
        if is_first:
            unread = max(0, (read.utc - self._since(None, read)) // self._period - 1)
        if (unread > 0 or is_lost or is_first) and not is_told:
            outbox.add(self._unread(seen, unread, read))

    def _reckon(self, due: int, read: Instant) -> int:
        """Turns that brought no sample, each counted once, where every read is one.

        A turn that comes late brought it all the same; but those behind it that it leaves no time
        for are known by now. Elsewhere it matters how long nobody looked.
        """
        period, last, self._last = self._period, self._last, read
        if self.maker.block.trigger is not None:
            self._reckoned = due
            if last is None:
                return (read.monotonic - self._began) // period
            return (read.monotonic - last.monotonic + period // 2) // period - 1
        left_out = (due - self._reckoned) // period - 1
        to_come = max(0, (read.monotonic - due) // period - 1)  # as PolledDevice leaves them out
        self._reckoned = due + to_come * period
        return max(0, left_out) + to_come

    def _unread(self, seen: Instant | None, count: int, until: Instant) -> Entry:
        """Every read is a sample, or how many samples there were between two reads is not known.

        The first gap of a run reaches back to the last read of the run before.
        """
        since, reason = self._since(seen, until), Reason.UNREAD
        if seen is None and self._read_until:
            reason = Reason.DOWNTIME
        if self.maker.block.trigger is None:
            return self.maker.gap(since, until.utc, count, reason, until.utc)
        return self.maker.gap(since, until.utc, 0, reason, until.utc, possible=True)

    def _since(self, seen: Instant | None, until: Instant) -> int:
        """UTC ns from which on a sample may be missing before ``until``."""
        if seen is None and self._read_until:
            return min(self._read_until, until.utc)
        return until.utc - (until.monotonic - (seen.monotonic if seen else self._began))

    def _carry(self, seen: Instant, now: Instant) -> Mapping[str, object]:
        """``seen`` by the wall clock of ``now``: it may have been stepped in between."""
        read_at = now.utc - (now.monotonic - seen.monotonic)
        carry = {"epoch": self.maker.epoch.hex(), "seq": self.seq, "read_at": read_at}
        return carry if self.maker.block.trigger is None else {**carry, "raw": self._raw.hex()}

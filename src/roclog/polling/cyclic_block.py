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
        self._lost: int | None = None
        self._raw = raw
        self._told: Note | None = None

    @property
    def seq(self) -> int:
        """Number of the last sample."""
        return self._known.seq

    def take(self, octets: bytes, answer: Answer, asked: Instant, outbox: Outbox) -> Entry | None:
        """One read, and its sample if it is one.

        asked: of its first request, where several were needed.
        """
        last, seen = self._last, self._seen
        self._last, self._seen = answer.read, self._seen_by(asked, answer.read)
        words = self.maker.words(octets)
        most = self._most(seen, answer.read)
        self._known, finding = judge(
            self.maker.block, self._known, words, self.maker.order, most=most
        )
        self._tell_missed(finding, last, seen, answer.read, outbox)
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
        carry = self._carry(self._seen)
        entry = self.maker.message(reading, self.seq, finding.origin, carry)
        outbox.add(entry)
        return entry

    def skip(self, answer: Answer, outbox: Outbox) -> None:
        """A flag outside the block says in ``answer`` that there is nothing new in it."""
        last, seen = self._last, self._seen
        self._last, self._seen = answer.read, answer.asked
        self._tell_missed(Finding(), last, seen, answer.read, outbox)

    def lose(self, due: int) -> None:
        """The answer to a read that was due at ``due`` (monotonic ns) never came.

        Where a read lowers the flag it may have taken a sample with it.
        """
        if isinstance(self.maker.block.trigger, ClearOnRead) and self._lost is None:
            self._lost = due

    def close(self, outbox: Outbox) -> None:
        """Let the next run know until when this one has read."""
        if self._seen is not None:
            outbox.checkpoint(self.maker.topic, self._carry(self._seen))

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
        self,
        finding: Finding,
        last: Instant | None,
        seen: Instant | None,
        read: Instant,
        outbox: Outbox,
    ) -> None:
        """Before the sample. Where the device numbers its samples, it tells; else time does.

        last: when the read before this one had come; seen: up to when it showed the device.
        """
        since = read.utc - (read.monotonic - seen.monotonic) if seen is not None else 0
        counts = isinstance(self.maker.block.trigger, Counter)
        if finding.missed:
            start = since or self._read_until or read.utc
            gap = self.maker.gap(
                min(start, read.utc),
                read.utc,
                finding.missed,
                Reason.OVERWRITTEN if last is not None else Reason.DOWNTIME,
                read.utc,
                possible=finding.possible,
            )
            outbox.add(gap)
        lost, self._lost = self._lost, None
        if last is not None:
            apart = read.monotonic - last.monotonic
            unread = (apart + self._period // 2) // self._period - 1
            if (unread > 0 or lost is not None) and not counts:
                outbox.add(self._unread(since, read.utc, unread, Reason.UNREAD))
        elif self._read_until and not counts:
            since = min(self._read_until, read.utc)
            unread = (read.utc - since) // self._period
            outbox.add(self._unread(since, read.utc, unread, Reason.DOWNTIME))
        elif lost is not None:
            since = min(read.utc - (read.monotonic - lost), read.utc)
            outbox.add(self._unread(since, read.utc, 1, Reason.UNREAD))

    def _unread(self, since: int, until: int, count: int, reason: Reason) -> Entry:
        """Every read is a sample, or how many samples there were between two reads is not known."""
        if self.maker.block.trigger is None:
            return self.maker.gap(since, until, count, reason, until)
        return self.maker.gap(since, until, 0, reason, until, possible=True)

    def _carry(self, seen: Instant) -> Mapping[str, object]:
        carry = {"epoch": self.maker.epoch.hex(), "seq": self.seq, "read_at": seen.utc}
        return carry if self.maker.block.trigger is None else {**carry, "raw": self._raw.hex()}

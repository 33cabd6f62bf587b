"""From a judged reading to the messages that are recorded. Pure."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from roclog.decode import Decoded, Value, decode, named_values, word_order_doubts
from roclog.recording.entries import Entry, gap_entry
from roclog.schema import CLEAR, LINK, ClearResult, Origin, Reason, sample_type
from roclog.triggers import Known, judge
from roclog.word_types import block_octets, block_words

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roclog.bus.tally import Tally
    from roclog.clock import Instant
    from roclog.handshake import Memory, News
    from roclog.register_map import Block, WordOrder


class Reading(NamedTuple):
    """One block as it was read.

    asked, began, read: first octet of the request, first and last octet of the answer.
    previous: UTC ns at which the latest read that shows no newer state was asked for, 0 = none yet:
    a sample may complete while the answer without it is on the wire.
    """

    words: tuple[int, ...]
    asked: Instant
    began: Instant
    read: Instant
    previous: int

    @property
    def seen_until(self) -> int:
        """UTC ns; what the device did later, this read does not show."""
        return self.utc_of(self.asked)

    @property
    def known_until(self) -> int:
        """UTC ns from which on this may be the second of two samples, the first one unseen."""
        return self.previous or self.seen_until

    def utc_of(self, instant: Instant) -> int:
        """UTC ns by the wall clock at ``read`` and the monotonic time between the two.

        A step of the wall clock in the course of a read shifts nothing, and both clocks of every
        instant follow from what is recorded.
        """
        return self.read.utc - (self.read.monotonic - instant.monotonic)

    @property
    def raw(self) -> bytes:
        return struct.pack(f">{len(self.words)}H", *self.words)


class SampleMaker:
    """Makes the messages of one block; holds only what never changes in a run.

    size: octets of the block in an answer.
    """

    def __init__(
        self, device: str, profile: str, block: Block, order: WordOrder, epoch: bytes
    ) -> None:
        self.block = block
        self.epoch = epoch
        self.topic = f"/{device}/{block.name}"
        self.kind = sample_type(profile, block)
        self.size = block.octets
        self._can_miss = block.can_miss
        self._device = device
        self.order = order

    def decode(self, reading: Reading) -> Decoded:
        return decode(
            self.block,
            reading.words,
            self.order,
            read_at=reading.read.utc,
            changed_after=reading.previous or None,
        )

    def values(self, reading: Reading) -> dict[str, Value | None]:
        """The fields of the block by name; None where the measurement is missing."""
        return named_values(self.block, self.decode(reading))

    def doubts(self, reading: Reading) -> list[str]:
        """What speaks against the word order."""
        return word_order_doubts(self.block, reading.words, self.order)

    def words(self, octets: bytes) -> tuple[int, ...]:
        """The words of the block from its octets as on the wire."""
        return block_words(self.block, octets)

    def known(self, seq: int, raw: bytes) -> Known:
        """What the trigger knows after sample ``seq``; raw: its octets, empty where not kept."""
        if self.block.trigger is None or len(raw) != self.size:
            return Known(seq)
        known, _ = judge(self.block, Known(), self.words(raw), self.order)
        return replace(known, seq=seq)

    def sample(self, news: News, reading: Reading, memory: Memory) -> Entry:
        """The message of a flagged sample. ``memory`` is what holds once it is on disk."""
        carry = self.carry(memory, reading.known_until, reading.read.utc)
        return self.message(reading, news.seq, news.origin, carry, redelivered=news.redelivered)

    def message(
        self,
        reading: Reading,
        seq: int,
        origin: Origin,
        carry: Mapping[str, object],
        *,
        redelivered: bool = False,
    ) -> Entry:
        """The message of a sample. ``carry`` is what the next run must know once it is on disk."""
        decoded = self.decode(reading)
        values = (
            seq,
            self.epoch,
            origin,
            redelivered,
            reading.utc_of(reading.asked),
            reading.read.utc,
            reading.read.monotonic,
            reading.previous,
            decoded.device_time,
            decoded.time_flags,
            decoded.doubtful,
            block_octets(self.block, reading.words),
            *((decoded.missing,) if self._can_miss else ()),
            reading.utc_of(reading.began),
            *decoded.values,
        )
        return Entry(
            topic=self.topic,
            log_time=reading.read.utc,
            publish_time=decoded.device_time or reading.read.utc,
            sequence=seq,
            data=self.kind.pack(iter(values)),
            carry=carry,
        )

    def carry(self, memory: Memory, read_at: int, sampled_at: int) -> dict[str, object]:
        """What the next run inherits; what was missed before ``read_at`` ns UTC is recorded.

        sampled_at: UTC ns, when the last sample was read.
        """
        return {
            "epoch": self.epoch.hex(),
            "seq": memory.seq,
            "payload": None if memory.payload is None else memory.payload.hex(),
            "cleared": memory.cleared,
            "read_at": read_at,
            "sampled_at": sampled_at,
        }

    def gap(
        self,
        after: int,
        before: int,
        expected: int,
        reason: Reason,
        now: int,
        *,
        possible: bool = False,
    ) -> Entry:
        """``after`` and ``before`` in ns UTC; ``possible``: nobody can tell if any is missing."""
        return gap_entry(
            self._device,
            after,
            before,
            expected,
            reason,
            block=self.block.name,
            now=now,
            possible=possible,
        )

    def clear(
        self,
        memory: Memory,
        asked: int,
        ended: int,
        result: ClearResult,
        code: int,
        *,
        guarded: bool,
        read_at: int,
        sampled_at: int,
    ) -> Entry:
        """``asked`` and ``ended`` in ns UTC; ``memory`` as it is after the clear.

        read_at, sampled_at: as of ``carry``; a clear shows nothing of the block.
        """
        values = (memory.seq, self.epoch, asked, ended, result, code, guarded)
        data = CLEAR.pack(iter(values))
        return Entry(
            topic=f"/{self._device}/clear",
            log_time=ended,
            publish_time=ended,
            sequence=memory.seq & 0xFFFFFFFF,
            data=data,
            carry=self.carry(memory, read_at, sampled_at),
            carry_topic=self.topic,
        )


def replaced_entry(device: str, since: int, now: int) -> Entry:
    """A gap, both ns UTC: what two devices at one address completed between their last reads."""
    return gap_entry(device, since, now, 0, Reason.REPLACED, block="", now=now, possible=True)


def link_entry(device: str, since: Instant, now: Instant, tally: Tally) -> Entry:
    """Counts between two instants; the bus load is the part of the time the line was taken."""
    elapsed = max(1, now.monotonic - since.monotonic)
    mean = tally.round_trip_sum / tally.answers / 1e9 if tally.answers else float("nan")
    known = [field.name for field in LINK.fields if field.name.startswith("exception_")][:-1]
    by_code = [tally.exceptions.get(int(name.rpartition("_")[2]), 0) for name in known]
    values = (
        since.utc,
        now.utc,
        tally.requests,
        tally.answers,
        tally.timeouts,
        tally.late_answers,
        tally.crc_errors,
        tally.wrong_answers,
        tally.discarded_octets,
        tally.link_losses,
        mean,
        tally.round_trip_max / 1e9,
        tally.busy / elapsed,
        *by_code,
        sum(tally.exceptions.values()) - sum(by_code),
        tally.polls,
        tally.skipped,
        tally.frame_errors,
        tally.parity_errors,
        tally.overruns,
        tally.breaks,
    )
    return Entry(f"/{device}/link", now.utc, now.utc, 0, LINK.pack(iter(values)))

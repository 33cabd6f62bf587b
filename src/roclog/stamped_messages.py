"""From a judged change of a stamped input to the message that is recorded. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from roclog.changes import ChangeKind
from roclog.recording.entries import Entry, gap_entry
from roclog.schema import InputChange, Origin, Reason, stamped_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roclog.bus.bus import Answer
    from roclog.changes import Change, ChangeMemory
    from roclog.register_map import Table

_CHANGES: Final = {kind: InputChange[kind.name] for kind in ChangeKind}


class StampedMaker:
    """Makes the messages of one table, numbered. seq: of the last one of an earlier run.

    block: the name of the table.
    """

    def __init__(self, device: str, profile: str, table: Table, epoch: bytes, seq: int) -> None:
        self.topic = f"/{device}/{table}"
        self.epoch = epoch
        self.seq = seq
        self._device = device
        self.block = str(table)
        self._is_discrete = table.has_bits
        self._kinds = {size: stamped_type(profile, table, size) for size in (7, 4)}
        self._carry: dict[str, Any] = {"epoch": epoch.hex()}

    def message(self, change: Change, answer: Answer, previous: int) -> Entry:
        """previous: UTC ns, when the last answer with the state before was asked for, 0 = none."""
        self.seq += 1
        state, read = change.state, answer.read
        value = bytes([state.value]) if self._is_discrete else state.value.to_bytes(2)
        values = (
            self.seq,
            self.epoch,
            Origin.CHANGED,
            False,
            read.utc - (read.monotonic - answer.asked.monotonic),
            read.utc,
            read.monotonic,
            previous,
            state.device_time,
            state.time_flags,
            0,
            value + state.stamp,
            read.utc - (read.monotonic - answer.began.monotonic),
            change.address,
            state.value,
            _CHANGES[change.kind],
            change.hidden(discrete=self._is_discrete),
            state.stamp,
        )
        return Entry(
            topic=self.topic,
            log_time=read.utc,
            publish_time=state.device_time or read.utc,
            sequence=self.seq,
            data=self._kinds[len(state.stamp)].pack(iter(values)),
            carry=self._carry,
        )

    def update(self, memory: ChangeMemory, read_at: int) -> None:
        """What the messages that are committed next leave to a later run; read_at as of carry."""
        self._carry.update(self.carry(memory, read_at))

    def carry(self, memory: ChangeMemory, read_at: int) -> Mapping[str, object]:
        """What a later run must know. read_at: UTC ns up to which every input was seen."""
        return {
            "epoch": self.epoch.hex(),
            "seq": self.seq,
            "read_at": read_at,
            "states": memory.text(),
        }

    def gap(self, after: int, before: int, reason: Reason) -> Entry:
        """What changed more than once between two instants in ns UTC, if anything, is missing."""
        return gap_entry(
            self._device, after, before, 0, reason, block=self.block, now=before, possible=True
        )

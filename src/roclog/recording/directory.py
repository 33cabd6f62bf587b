"""A recording directory: its lock, its segments by number, and the small state file.

Segment numbers only grow over the life of the directory. They are read from the files, not from
their names, so that renamed or copied files do not confuse a restart.
"""

from __future__ import annotations

import fcntl
import json
import os
import uuid
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from mcap.records import Channel, Message, Metadata

from roclog.changes import ChangeMemory, State
from roclog.errors import DamagedFile, StorageError
from roclog.recording.entries import intact, protected
from roclog.recording.scan import Scan
from roclog.recording.seal import SEGMENT_METADATA
from roclog.recording.segment import sync_directory
from roclog.register_map import Table
from roclog.schema import CLEAR, ClearResult, Origin, read_signature, stamped_type

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

Carry = dict[str, dict[str, Any]]
"""Topic to what the next run must know: epoch, seq, payload (hex or null), cleared, read_at."""
_STAMPED: Final = {
    (2 - table.has_bits) + stamp: stamped_type("", table, stamp)
    for table in (Table.DISCRETE_INPUTS, Table.INPUT_REGISTERS)
    for stamp in (7, 4)
}
"""Message types of the states of inputs, by the octets of ``raw``; the profile is only a name."""


@dataclass
class Inheritance:
    """What earlier runs leave to this one.

    logger: identity of the directory's life. number: of the newest segment.
    """

    logger: str
    number: int = 0
    carry: Carry = field(default_factory=dict)


_SEALING: Final = "[0-9][0-9][0-9][0-9]/[0-9][0-9]/[0-9][0-9]/*.sealing-[0-9]*"


class Directory:
    """Exclusive use of a recording directory."""

    def __init__(self, root: Path) -> None:
        """Raises StorageError: it cannot be made or written, or another process records there."""
        self.root = root
        self.hot = root / "hot"
        try:
            _make_durably(self.hot)
            self._lock = os.open(root / ".lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o640)
        except OSError as error:
            raise StorageError(root, error.strerror or str(error)) from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._lock)
            raise StorageError(root, "another roclog is recording into this directory") from error
        for leftover in (*root.glob(_SEALING), *root.glob(".state-[0-9]*")):
            with suppress(OSError):
                leftover.unlink()

    def restore(self) -> None:
        """Make the folders again, should somebody have deleted them. Raises OSError."""
        _make_durably(self.hot)

    def release(self) -> None:
        os.close(self._lock)

    def hot_segments(self) -> list[Path]:
        return sorted(self.hot.glob("*.mcap"))

    def sealed_segments(self) -> list[Path]:
        """In order of their names, which is the order of their opening dates."""
        return sorted(self.root.glob("[0-9]*/[0-9]*/[0-9]*/*.mcap"))

    def inherit(self) -> Inheritance:
        """Newest state there is: the state file, or the newest segment's head and its messages."""
        state = self._read_state_file()
        heads = [(head, path) for path in self._all() if (head := _head(path)) is not None]
        newest = max(heads, key=lambda pair: int(pair[0]["number"]), default=None)
        if newest is None:
            return state or Inheritance(uuid.uuid4().hex)
        number = int(newest[0]["number"])
        found = Inheritance(newest[0]["logger"], number)
        with suppress(DamagedFile, OSError):  # an old file never keeps a recorder from starting
            _apply(newest[1], found)
        if state is not None and state.number >= number:
            found.number, found.logger = state.number, state.logger
            found.carry = _merged(found.carry, state.carry)
        return found

    def write_state_file(self, inheritance: Inheritance) -> None:
        """Replace the state file atomically. Raises OSError."""
        values = {
            "logger": inheritance.logger,
            "number": str(inheritance.number),
            "carry": json.dumps(inheritance.carry),
        }
        temporary = self.root / f".state-{os.getpid()}"
        with temporary.open("w") as file:
            json.dump(protected(values), file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self.root / "state.json")
        sync_directory(self.root)

    def _read_state_file(self) -> Inheritance | None:
        try:
            values = json.loads((self.root / "state.json").read_text())
            if not isinstance(values, dict) or not intact(values):
                return None
            carry = json.loads(values["carry"])
            return Inheritance(values["logger"], int(values["number"]), carry)
        except (OSError, ValueError, KeyError):
            return None

    def _all(self) -> Iterator[Path]:
        yield from self.hot_segments()
        yield from self.sealed_segments()


def _make_durably(folder: Path) -> None:
    """Create a folder and its parents so that a power cut cannot take them away again."""
    if folder.is_dir():
        return
    _make_durably(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_directory(folder.parent)


def _merged(found: Carry, state: Carry) -> Carry:
    """Of each topic what is farther; the segment where it is as far as the state file."""
    merged = {**state}
    for topic, carry in found.items():
        known = state.get(topic)
        if known is None or carry["seq"] >= known["seq"]:
            read_at = max(c.get("read_at", 0) for c in (carry, known or carry))
            merged[topic] = {**carry, "read_at": read_at}
    return merged


def _head(path: Path) -> Mapping[str, str] | None:
    """Segment metadata of a file of ours; None for foreign and unreadable ones."""
    try:
        for found in Scan(path):
            record = found.record
            if isinstance(record, Metadata) and record.name == SEGMENT_METADATA:
                return record.metadata if intact(record.metadata) else None
            if isinstance(record, Message):
                return None
    except (DamagedFile, OSError):
        return None
    return None


def _apply(path: Path, state: Inheritance) -> None:
    """Opening state of a segment, then its messages on top, as far as it can be read."""
    channels: dict[int, Channel] = {}
    inputs: dict[str, _Inputs] = {}
    try:
        for found in Scan(path):
            match found.record:
                case Metadata(name="roclog.state", metadata=values) if intact(values):
                    state.carry = json.loads(values["state"])
                case Channel() as channel:
                    channels[channel.id] = channel
                case Message() as message:
                    channel_of = channels.get(message.channel_id)
                    if channel_of is None:
                        continue
                    if "states" in channel_of.metadata:
                        topic = channel_of.topic
                        if topic not in inputs:
                            inputs[topic] = _Inputs(state.carry.get(topic))
                        inputs[topic].take(message.data)
                    else:
                        _apply_message(channel_of, message.data, state.carry)
    finally:
        for topic, restored in inputs.items():
            if restored.carry is not None:
                state.carry[topic] = restored.carry


class _Inputs:
    """The states of a channel's inputs: what a segment begins with, then its messages.

    read_at: every input was seen up to then. A message says so of the instant at which the answer
    before its own was asked for; the first ones of a run say nothing new.
    """

    def __init__(self, carry: Mapping[str, Any] | None) -> None:
        self._carry = carry
        self._seen_until = int((carry or {}).get("read_at", 0))
        self._last: dict[str, Any] = {}
        self._memory: ChangeMemory | None = None

    def take(self, data: bytes) -> None:
        sample = read_signature(data)
        kind = None if sample is None else _STAMPED.get(len(sample["raw"]))
        values = None if kind is None else kind.unpack(data)
        if values is None:
            return
        epoch = values["epoch"].hex()
        if self._memory is None or epoch != self._last["epoch"]:
            self._memory = self._carried(epoch)
        if self._memory is None:
            return
        stamp, time = values["time_octets"], values["device_time"]
        state = State(values["value"], stamp, time, values["time_flags"])
        self._memory.restore(values["address"], state)
        until = values["previous_read_at"] or self._last.get("read_at") or self._seen_until
        self._last = {"epoch": epoch, "seq": values["seq"], "read_at": until or values["asked_at"]}

    @property
    def carry(self) -> dict[str, Any] | None:
        """None where no message was of use."""
        return {**self._last, "states": self._memory.text()} if self._memory is not None else None

    def _carried(self, epoch: str) -> ChangeMemory | None:
        """An epoch begins with no input known; nothing of another one is of use to it.

        None where the carried text is damaged: the run that takes it up says so, and begins anew.
        """
        if self._last or self._carry is None or self._carry.get("epoch") != epoch:
            return ChangeMemory()
        try:
            return ChangeMemory(self._carry["states"])
        except (KeyError, ValueError):
            return None


def _apply_message(channel: Channel, data: bytes, carry: Carry) -> None:
    cleared = channel.metadata.get("clears")
    if cleared is not None:
        clear = CLEAR.unpack(data)
        entry = carry.get(cleared)
        if clear is not None and entry is not None and clear["result"] == ClearResult.DONE:
            entry["cleared"] = entry["cleared"] or clear["seq"] == entry["seq"]
        return
    sample = read_signature(data)
    if sample is None:
        return
    raw = sample["raw"]
    entry = {"epoch": sample["epoch"].hex(), "seq": sample["seq"], "read_at": sample["read_at"]}
    payload_words = channel.metadata.get("payload")
    if payload_words is not None:
        ranges = json.loads(payload_words)
        entry["payload"] = b"".join(raw[2 * a : 2 * (a + n)] for a, n in ranges).hex()
        entry["cleared"] = sample["origin"] != Origin.FLAG
        entry["read_at"] = sample["previous_read_at"] or sample["asked_at"]
        entry["sampled_at"] = sample["read_at"]
    elif "trigger" in channel.metadata:
        entry["raw"] = raw.hex()
        entry["read_at"] = sample["asked_at"]
    carry[channel.topic] = entry

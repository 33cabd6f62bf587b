"""One file to decoded records: its definitions, its metadata, and what is wrong with it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from mcap.records import Channel as ChannelRecord
from mcap.records import Message, Metadata
from mcap.records import Schema as SchemaRecord

from roclog.errors import DamagedFile
from roclog.recording.decoding import ChannelDecoder
from roclog.recording.entries import intact
from roclog.recording.listing import HOT
from roclog.recording.protobuf import UndecodableError
from roclog.recording.scan import Scan
from roclog.recording.seal import SEALED_METADATA
from roclog.recording.summary import read_summary

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Mapping

    from roclog.recording.protobuf import Readers
    from roclog.recording.records import Channel, Record, Segment

_Definition = TypeVar("_Definition", SchemaRecord, ChannelRecord)
PATIENCE: Final = 0.1
"""Seconds until the end of a file that somebody is writing has moved on."""
_FRESH: Final = 5.0
_OURS: Final = "roclog."


class Decoded(NamedTuple):
    """A record with the message that it was."""

    decoder: ChannelDecoder
    message: Message
    record: Record


class SegmentReader:
    """Iterate once over the records of one file.

    listed: topics that the recording knows; others are damage. damage: filled while iterating.
    metadata: the intact ``roclog.`` metadata, latest of each name.

    Raises (while iterating):
        FileNotFoundError: the file has gone; nothing was given yet.
    """

    def __init__(
        self,
        segment: Segment,
        readers: Readers,
        listed: Container[str],
        choose: Callable[[Channel], bool],
        *,
        start: int | None = None,
        end: int | None = None,
    ) -> None:
        self.damage: list[DamagedFile] = []
        self.metadata: dict[str, Mapping[str, str]] = {}
        self._path = segment.path
        self._hot = segment.state == HOT
        self._readers = readers
        self._listed = listed
        self._choose = choose
        self._scan = Scan(segment.path, start=start, end=end)
        self._schemas: dict[int, SchemaRecord] = {}
        self._channels: dict[int, ChannelRecord] = {}
        self._decoders: dict[int, ChannelDecoder | None] = {}
        self._spoiled: set[int] = set()

    def __iter__(self) -> Iterator[Decoded]:
        try:
            for found in self._scan:
                match found.record:
                    case Message() as message:
                        yield from self._message(found.offset, message)
                    case SchemaRecord() as schema:
                        self._define(found.offset, self._schemas, schema)
                    case ChannelRecord() as channel:
                        self._define(found.offset, self._channels, channel)
                    case Metadata() as metadata if metadata.name.startswith(_OURS):
                        self._keep(found.offset, metadata)
            self._check_end()
        except FileNotFoundError:
            raise
        except DamagedFile as problem:
            if not self._is_growing():
                self.damage.append(problem)
        except OSError as error:
            self._note(self._scan.octets, f"cannot be read further ({error.strerror or error})")
        finally:
            self._take_damage()

    def _check_end(self) -> None:
        """Only a hot segment may end anywhere."""
        scan = self._scan
        told = bool(scan.damage) and scan.damage[-1].offset == scan.octets
        if not (scan.finished or self._hot or told):
            self._note(scan.octets, "the end of the file is missing")

    def _message(self, offset: int, message: Message) -> Iterator[Decoded]:
        number = message.channel_id
        if number not in self._decoders:
            self._decoders[number] = self._decoder(offset, number)
        decoder = self._decoders[number]
        if decoder is None:
            return
        try:
            record = decoder.decode(message)
        except UndecodableError as problem:
            if number not in self._spoiled:
                self._spoiled.add(number)
                self._note(offset, f"{decoder.channel.topic}: {problem}")
            return
        if record is not None:
            yield Decoded(decoder, message, record)

    def _decoder(self, offset: int, number: int) -> ChannelDecoder | None:
        """None where the channel was not chosen or cannot be decoded."""
        if number not in self._channels:
            self._take_summary()
        channel = self._channels.get(number)
        if channel is None:
            self._note(offset, f"messages of channel {number}, which nothing intact declares")
            return None
        if channel.schema_id and channel.schema_id not in self._schemas:
            self._take_summary()
        schema = self._schemas.get(channel.schema_id)
        decoder = ChannelDecoder(channel, schema, self._readers)
        if channel.topic not in self._listed:
            self._note(offset, f"channel {channel.topic!r} is declared behind the first messages")
            return None
        if not self._choose(decoder.channel):
            return None
        if decoder.damaged or (channel.schema_id and schema is None):
            self._note(offset, f"{channel.topic}: {decoder.channel.problem}")
        return decoder

    def _take_summary(self) -> None:
        """The definitions stood in a chunk that is damaged; a finished file repeats them."""
        summary = read_summary(self._path)
        if summary is not None:
            self._schemas = summary.schemas | self._schemas
            self._channels = summary.channels | self._channels

    def _define(self, offset: int, known: dict[int, _Definition], record: _Definition) -> None:
        if known.setdefault(record.id, record) != record:
            kind = type(record).__name__.lower()
            self._note(offset, f"{kind} {record.id} is defined twice and differently")

    def _keep(self, offset: int, record: Metadata) -> None:
        if intact(record.metadata):
            self.metadata[record.name] = record.metadata
        else:
            self._note(offset, f"metadata {record.name[:64]!r} whose checksum is wrong")

    def _take_damage(self) -> None:
        damage = self._scan.damage
        if damage and self._is_growing():
            del damage[-1]
        self.damage += damage
        sealed = self.metadata.get(SEALED_METADATA)
        if sealed is not None:
            octets, reason = sealed.get("dropped_octets"), sealed.get("reason")
            self._note(0, f"sealed without {octets} octets of the hot segment ({reason})")

    def _is_growing(self) -> bool:
        """Whether a record cut off at the end of a hot segment is only being written."""
        torn_at = self._scan.torn_at
        if not self._hot or torn_at is None:
            return False
        try:
            for wait in (0.0, PATIENCE):
                time.sleep(wait)
                facts = self._path.stat()
                if facts.st_size > torn_at:
                    return True
                if abs(time.time() - facts.st_mtime) > _FRESH:
                    return False
        except OSError:
            return True
        return False

    def _note(self, offset: int, reason: str) -> None:
        self.damage.append(DamagedFile(self._path, offset, reason))

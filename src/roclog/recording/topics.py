"""The channels of a recording, merged over its files, and the choice among them."""

from __future__ import annotations

import fnmatch
from dataclasses import replace
from typing import TYPE_CHECKING

from roclog.recording.decoding import ChannelDecoder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mcap.records import Channel as ChannelRecord
    from mcap.records import Schema as SchemaRecord

    from roclog.recording.protobuf import Readers
    from roclog.recording.records import Channel


class Topics:
    """channels: by topic; where files differ, the later definition with the fields of all."""

    def __init__(self, readers: Readers) -> None:
        self.channels: dict[str, Channel] = {}
        self._readers = readers
        self._known: set[tuple[object, ...]] = set()

    def define(self, record: ChannelRecord, schema: SchemaRecord | None) -> None:
        """Take in the definition that one file gives."""
        described = (schema.name, schema.encoding, schema.data) if schema is not None else ()
        metadata = tuple(record.metadata.items())
        key = (record.topic, record.message_encoding, metadata, described)
        if key in self._known:
            return
        self._known.add(key)
        new = ChannelDecoder(record, schema, self._readers).channel
        old = self.channels.get(new.topic)
        self.channels[new.topic] = new if old is None else _merged(old, new)

    def selection(
        self, patterns: str | Iterable[str] | None, device: str | None, kinds: Iterable[str] | None
    ) -> Callable[[Channel], bool]:
        """What a channel has to satisfy.

        Raises:
            ValueError: a pattern that no topic matches, or a device that is not there.
        """
        wanted = [patterns] if isinstance(patterns, str) else patterns
        topics = None if wanted is None else {t for p in wanted for t in self._matching(p)}
        devices = sorted({channel.device for channel in self.channels.values()} - {""})
        if device is not None and device not in devices:
            raise ValueError(f"no device {device!r}; there are: {_listed(devices)}")
        chosen = None if kinds is None else frozenset(kinds)

        def choose(channel: Channel) -> bool:
            return (
                (topics is None or channel.topic in topics)
                and (device is None or channel.device == device)
                and (chosen is None or channel.kind in chosen)
            )

        return choose

    def _matching(self, pattern: str) -> list[str]:
        found = [topic for topic in self.channels if fnmatch.fnmatchcase(topic, pattern)]
        if not found:
            there = _listed(sorted(self.channels))
            raise ValueError(f"no channel matches {pattern!r}; there are: {there}")
        return found


def _merged(old: Channel, new: Channel) -> Channel:
    if new.problem and not old.problem:
        return old
    fields = (*old.fields, *(name for name in new.fields if name not in old.fields))
    schemas = tuple(dict.fromkeys(old.schemas + new.schemas))
    return replace(new, fields=fields, units={**old.units, **new.units}, schemas=schemas)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if names else "none"

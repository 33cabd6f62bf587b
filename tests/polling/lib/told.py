"""What a device is said to have missed, read by protobuf and not by what packed it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from roclog.schema import GAP, Reason

if TYPE_CHECKING:
    from collections.abc import Iterable

    from roclog.recording.entries import Entry


class Told(NamedTuple):
    """A gap. since, until: UTC ns."""

    since: int
    until: int
    expected: int
    reason: Reason
    possible: bool
    block: str


def _gap_class() -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(GAP.descriptor_set).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(GAP.name))


_GAP = _gap_class()


def gaps(entries: Iterable[Entry]) -> list[Told]:
    """In the order in which they were recorded."""
    found = [_GAP.FromString(e.data) for e in entries if e.topic.endswith("/gap")]
    return [
        Told(getattr(g, "from"), g.to, g.expected, Reason(g.reason), g.possible, g.block)
        for g in found
    ]

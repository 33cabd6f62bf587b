"""Copies of samples, recognised without keeping the samples.

A key is (topic, epoch, seq). Sequence numbers are dense, so each page of consecutive ones is an
array with one 8-octet digest for each; 0 stands for a number not seen.
"""

from __future__ import annotations

from array import array
from collections import deque
from enum import Enum, auto
from hashlib import blake2b
from itertools import groupby
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_PAGE: Final = 128
_EMPTY: Final = array("Q", bytes(8 * _PAGE))


class Finding(Enum):
    NEW = auto()
    COPY = auto()
    CONFLICT = auto()
    """Same key, other payload."""


def digest(*parts: bytes) -> int:
    """64 bits of the parts, never 0."""
    state = blake2b(digest_size=8)
    for part in parts:
        state.update(len(part).to_bytes(8, "little"))
        state.update(part)
    return int.from_bytes(state.digest(), "little") or 1


class SeenSamples:
    """Keys of samples with the digests of their payloads, whatever order they come in."""

    def __init__(self) -> None:
        self._pages: dict[tuple[str, bytes], dict[int, array[int]]] = {}
        self._more: dict[tuple[str, bytes, int], set[int]] = {}

    def add(self, topic: str, epoch: bytes, seq: int, payload: int) -> Finding:
        pages = self._pages.setdefault((topic, epoch), {})
        number, index = divmod(seq, _PAGE)
        page = pages.get(number)
        if page is None:
            page = pages[number] = _EMPTY[:]
        known = page[index]
        if known == 0:
            page[index] = payload
            return Finding.NEW
        if known == payload:
            return Finding.COPY
        others = self._more.setdefault((topic, epoch, seq), set())
        if payload in others:
            return Finding.COPY
        others.add(payload)
        return Finding.CONFLICT

    def __contains__(self, key: tuple[str, bytes, int]) -> bool:
        number, index = divmod(key[2], _PAGE)
        page = self._pages.get(key[:2], {}).get(number)
        return page is not None and page[index] != 0

    def holes(self) -> Iterator[tuple[str, bytes, int, int]]:
        """Topic, epoch, first and last of the numbers missing between those seen."""
        for (topic, epoch), pages in self._pages.items():
            previous: int | None = None
            for first, last in _runs(pages):
                if previous is not None and first > previous + 1:
                    yield topic, epoch, previous + 1, first - 1
                previous = last


def _runs(pages: dict[int, array[int]]) -> Iterator[tuple[int, int]]:
    """First and last of the consecutive numbers seen, page by page."""
    for number in sorted(pages):
        at = number * _PAGE
        for seen, group in groupby(pages[number], key=bool):
            length = sum(1 for _ in group)
            if seen:
                yield at, at + length - 1
            at += length


class SeenMessages:
    """Digests of the messages without a key (events, gaps), for the latest two segments.

    Copies of a segment follow each other in reading order, and what a failing disk made the
    recorder write again stands in the next segment.
    """

    def __init__(self) -> None:
        self._segments: deque[set[int]] = deque(maxlen=2)
        self._identity: object = None

    def begin(self, identity: object) -> None:
        """A file begins; files with one identity are copies. None: compare with nothing."""
        if identity is None or identity != self._identity:
            self._segments.append(set())
        self._identity = identity

    def is_copy(self, topic: str, data: bytes) -> bool:
        if self._identity is None:
            return False
        message = digest(topic.encode(), data)
        if any(message in segment for segment in self._segments):
            return True
        self._segments[-1].add(message)
        return False

"""Is this read of a block a sample? The rules of every trigger but the flag that a client clears.

That one has its own, in roclog.handshake. Here too the functions are pure: ``judge`` returns what a
read means and what will be known once its sample is on disk; the caller adopts that then.

no trigger      every read is a sample
clear on read   a read that shows the flag up is a sample; where the flag lies in another register,
                ``is_raised`` tells from its word whether the block is to be read at all
counter         another number is another sample, and tells how many were missed
change          another payload is another sample, also the first one ever seen
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from functools import lru_cache
from typing import TYPE_CHECKING

from roclog.register_map import Change, ClearOnRead, Counter, FlagAndClear, WordOrder
from roclog.schema import Origin
from roclog.word_types import block_octets, effective_order, number_reader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.register_map import Block


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of a block between two reads; what the next run inherits.

    seq: number of the last sample, 0 before the first.
    payload: of the last sample: with a counter its number in eight octets, with change the octets
    that are compared; None = none yet.
    """

    seq: int = 0
    payload: bytes | None = None


class Note(Enum):
    """What deserves an event."""

    COUNTER_RESET = auto()
    """The counter went back: how many samples were missed cannot be told."""
    COUNTER_OUTSIDE = auto()
    """The counter has a number that the map says it cannot have; the read is no sample."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a read means.

    origin: why it is a sample; None = it is none.
    missed: samples that the device completed before this one and after the last, and nobody read.
    possible: it cannot be told whether that many were missed, or any.
    """

    origin: Origin | None = None
    missed: int = 0
    possible: bool = False
    note: Note | None = None


_NOTHING = Finding()
_FAR = 10
"""A counter that went back to a small number has begun anew, or missed all up to its end. Where the
second takes so many times as many samples, and the time says nothing, it cannot be told which."""


def judge(
    block: Block,
    known: Known,
    words: Sequence[int],
    order: WordOrder = WordOrder.ABCD,
    *,
    most: int | None = None,
) -> tuple[Known, Finding]:
    """Apply the trigger of ``block`` to one read of it.

    Args:
        block: its trigger must be another than FlagAndClear.
        known: as of the last sample.
        words: of the block. With a flag in another register: read because ``is_raised`` said so.
        order: the device's.
        most: samples that the device can have completed since the last read, where the time between
            its samples is known; a counter that grew by more was reset.
    """
    trigger = block.trigger
    match trigger:
        case None:
            return Known(known.seq + 1), Finding(Origin.CYCLIC)
        case ClearOnRead():
            offset = trigger.offset_in(block)
            if offset is None or is_raised(trigger, words[offset]):
                return Known(known.seq + 1), Finding(Origin.FLAG)
            return known, _NOTHING
        case Counter():
            number = _counter(block, trigger, words, order)
            return _by_counter(counter_range(block, trigger), known, number, most)
        case Change():
            return _by_change(block, trigger, known, words)
        case FlagAndClear():
            raise ValueError(f"block {block.name} has a flag to clear: roclog.handshake judges it")


def is_raised(trigger: ClearOnRead, word: int) -> bool:
    """Whether the flag's word says that there is a sample to read."""
    return word & trigger.mask == trigger.new


def counter_range(block: Block, trigger: Counter) -> range:
    """The numbers that the counter goes through before it begins again."""
    point = next(point for point in block.points if point.name == trigger.point)
    last = (1 << 16 * point.type.words) - 1 if trigger.last is None else trigger.last
    return range(trigger.first, last + 1)


def _by_counter(
    numbers: range, known: Known, number: int, most: int | None
) -> tuple[Known, Finding]:
    if number not in numbers:
        return known, Finding(note=Note.COUNTER_OUTSIDE)
    after = Known(known.seq + 1, number.to_bytes(8))
    if known.payload is None:
        return after, Finding(Origin.FLAG)
    last = int.from_bytes(known.payload)
    step = (number - last) % len(numbers)
    if not step:
        return known, _NOTHING
    limit = len(numbers) // 2 if most is None else most
    since_reset = number - numbers.start
    if step > max(1, limit):
        missed = max(1, since_reset)
        return after, Finding(Origin.FLAG, missed, possible=True, note=Note.COUNTER_RESET)
    if most is None and number < last and step > _FAR * (since_reset + 1):
        return after, Finding(Origin.FLAG, step - 1, possible=True, note=Note.COUNTER_RESET)
    return after, Finding(Origin.FLAG, missed=step - 1)


def _counter(block: Block, trigger: Counter, words: Sequence[int], order: WordOrder) -> int:
    point = next(point for point in block.points if point.name == trigger.point)
    own = (point.word_order or order) if block.packed else effective_order(point, order)
    read = _number_reader(point.type, point.offset, own, packed=block.packed)
    return int(read(words))


_number_reader = lru_cache(256)(number_reader)


def _by_change(
    block: Block, trigger: Change, known: Known, words: Sequence[int]
) -> tuple[Known, Finding]:
    if trigger.payload and not (block.table.has_bits or block.packed):
        octets = block_octets(block, words)
        payload = b"".join(octets[2 * first : 2 * (first + n)] for first, n in trigger.payload)
    elif trigger.payload:
        payload = bytes(one for first, n in trigger.payload for one in words[first : first + n])
    else:
        payload = block_octets(block, words)
    if payload == known.payload:
        return known, _NOTHING
    return Known(known.seq + 1, payload), Finding(Origin.CHANGED)

"""When a read of a block is a sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roclog.register_map import Block
    from roclog.register_map.kinds import Table


@dataclass(frozen=True, slots=True, kw_only=True)
class FlagAndClear:
    """New-data handshake: the device raises a flag, the client writes ``clear`` to it.

    payload: (first offset, words) ranges whose change means another sample. Words that move
    without a new sample (live alarms, temperature) are left out.
    is_assumed: nobody has said which words those are, so that it is all that have a name.
    """

    flag: int
    new: int = 1
    clear: int = 0
    payload: tuple[tuple[int, int], ...]
    is_assumed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearOnRead:
    """The device lowers its own flag when the block is read: each sample can be read only once.

    A read that goes unanswered may have taken a sample with it, and there is no second read that
    could confirm the first.

    table, address: the word with the flag. In the block itself it is judged from the block's read;
    elsewhere it is read first, and the block only where there is something new.
    mask, new: the flag is up where word AND ``mask`` is ``new``.
    """

    table: Table
    address: int
    mask: int = 0xFFFF
    new: int = 1

    def offset_in(self, block: Block) -> int | None:
        """Where the flag lies in the block; None = elsewhere."""
        inside = self.table is block.table and 0 <= self.address - block.address < block.count
        return self.address - block.address if inside else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Counter:
    """A point that grows by one for each sample: another number is another sample.

    point: an unscaled unsigned integer.
    first: what follows ``last``. last: the largest number; None = all bits of the point set.
    """

    point: str
    first: int = 0
    last: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """Another payload is another sample. payload: (first offset, words); empty = the whole block.

    Two equal samples in a row cannot be told apart.
    """

    payload: tuple[tuple[int, int], ...] = ()


Trigger = FlagAndClear | ClearOnRead | Counter | Change
"""When a read of a block is a sample; None, where it stands for a trigger: every read is one."""

"""Blocks to requests: neighbours joined, large blocks split, atomic ones left alone.

Where a register is a function each block is one call of it, whole and alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Final

from roclog.modbus.bits import ReadBits
from roclog.modbus.dialect import STANDARD
from roclog.modbus.functions import ReadFunction
from roclog.modbus.request import ReadRegisters
from roclog.modbus.stamped import split
from roclog.register_map import MAX_READ_BITS, MAX_READ_REGISTERS, ClearOnRead
from roclog.register_map.times import places

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from roclog.modbus.dialect import Dialect
    from roclog.modbus.request import Request
    from roclog.register_map import Block, RegisterMap

_HEADER: Final = 2
"""Octets of an answer before its data: function and byte count."""


@dataclass(frozen=True, slots=True)
class Part:
    """Where an answer holds octets of a block: ``start`` to ``stop`` of the answer's PDU."""

    block: int
    start: int
    stop: int


@dataclass(frozen=True, slots=True)
class Fetch:
    """One request, and which octets of its answer belong to which block (by its index).

    gate: a flag outside the block that says whether it is to be read at all.
    """

    request: Request
    parts: tuple[Part, ...]
    gate: ClearOnRead | None = None


def read_request(block: Block, dialect: Dialect = STANDARD) -> Request:
    """One request for a whole block; its data follow the head of the answer."""
    if dialect.has_functions:
        odd = block.octets if block.octets % 2 else None
        return ReadFunction(block.address, block.octets // 2, odd, dialect)
    kind = ReadBits if block.table.has_bits else ReadRegisters
    return kind(block.table.read_function, block.address, block.count)


def flag_request(flag: ClearOnRead) -> Request:
    """Asks for a flag that lies outside its block."""
    kind = ReadBits if flag.table.has_bits else ReadRegisters
    return kind(flag.table.read_function, flag.address, 1)


def place_of(block: Block, dialect: Dialect) -> str:
    """For people: what a read of ``block`` asks for, and where."""
    if dialect.has_functions:
        return f"function {block.address} ({block.name})"
    end = f" to {block.address + block.count - 1}" if block.count > 1 else ""
    return f"{block.table.replace('_', ' ')} {block.address}{end} ({block.name})"


def plan_requests(blocks: Sequence[Block], dialect: Dialect = STANDARD) -> tuple[Fetch, ...]:
    """The fewest requests that read all blocks once, each block's octets in order.

    Only blocks that are not atomic share a request, and only those that touch: registers that no
    block names are never read.
    """
    numbered = list(enumerate(blocks))
    if dialect.has_functions:
        return tuple(_called(index, block, dialect) for index, block in numbered)
    fetches = [fetch for pair in numbered if _is_whole(pair[1]) for fetch in _whole(*pair)]
    loose = sorted(
        (pair for pair in numbered if not _is_whole(pair[1])),
        key=lambda pair: (pair[1].table, pair[1].address),
    )
    for _, same_table in groupby(loose, key=lambda pair: pair[1].table):
        for run in _runs(same_table):
            fetches += _split(run)
    return tuple(fetches)


def _called(index: int, block: Block, dialect: Dialect) -> Fetch:
    request = read_request(block, dialect)
    return Fetch(request, (Part(index, len(request.head), request.answer_size),))


def _is_whole(block: Block) -> bool:
    """Bits share octets, and so no request; a read that clears is asked for by name."""
    return block.atomic or block.table.has_bits or isinstance(block.trigger, ClearOnRead)


def requests_by_period(profile: RegisterMap, poll: int) -> dict[int, list[Request]]:
    """Everything that is read on schedule, by the nanoseconds from turn to turn.

    poll: period of what has none of its own. A flag outside its block counts as if it were up.
    """
    blocks: dict[int, list[Block]] = {}
    for block in profile.samples:
        blocks.setdefault(block.period or poll, []).append(block)
    found: dict[int, list[Request]] = {}
    for period, group in blocks.items():
        requests = found.setdefault(period, [])
        for fetch in plan_requests(group, profile.dialect):
            if fetch.gate is not None:
                requests.append(flag_request(fetch.gate))
            requests.append(fetch.request)
    for inputs in profile.stamped:
        found.setdefault(poll, []).extend(split(inputs.mei, inputs.address, inputs.count))
    return found


def _whole(index: int, block: Block) -> list[Fetch]:
    """One request, but for more bits than an answer has: those fill the octets of all but one."""
    if block.table.has_bits and block.count > MAX_READ_BITS:
        function, end = block.table.read_function, block.address + block.count
        starts = range(block.address, end, MAX_READ_BITS)
        pieces = (ReadBits(function, at, min(MAX_READ_BITS, end - at)) for at in starts)
        return [Fetch(piece, (Part(index, _HEADER, piece.answer_size),)) for piece in pieces]
    gate = block.trigger if isinstance(block.trigger, ClearOnRead) else None
    if gate is not None and gate.offset_in(block) is not None:
        gate = None
    return [Fetch(read_request(block), (Part(index, _HEADER, _HEADER + block.octets),), gate)]


def _runs(pairs: Iterable[tuple[int, Block]]) -> list[list[tuple[int, Block]]]:
    """Blocks of one table, in order of address, cut where one does not touch the next."""
    runs: list[list[tuple[int, Block]]] = []
    end = -1
    for index, block in pairs:
        if block.address != end:
            runs.append([])
        runs[-1].append((index, block))
        end = block.address + block.count
    return runs


def _split(run: list[tuple[int, Block]]) -> list[Fetch]:
    """Requests of at most the size of a PDU; a block is cut only where it does not fit into one.

    It is never cut within a value, whose halves would be of two moments.
    """
    fetches: list[Fetch] = []
    pieces: list[tuple[int, Block, int, int]] = []
    room = MAX_READ_REGISTERS
    for index, block in run:
        first, values = 0, _values(block)
        while first < block.count:
            count = _piece(block, first, room, values)
            if count:
                pieces.append((index, block, first, count))
                first += count
                room -= count
            elif not pieces:
                raise ValueError(f"block {block.name}: a value at {first} is longer than an answer")
            if room == 0 or first < block.count:
                fetches.append(_joined(pieces))
                pieces, room = [], MAX_READ_REGISTERS
    return [*fetches, _joined(pieces)] if pieces else fetches


def _piece(block: Block, first: int, room: int, values: list[tuple[int, int]]) -> int:
    """Most registers from offset ``first`` that fit ``room`` and end where no value is cut."""
    if block.count - first <= room:
        return block.count - first
    if block.count <= MAX_READ_REGISTERS:
        return 0
    end = first + room
    for start, stop in values:
        if start < end < stop:
            end = start
    return max(0, end - first)


def _values(block: Block) -> list[tuple[int, int]]:
    """Where each value of a block lies, its time too: from one offset to another, last first."""
    spans = [(p.offset, p.offset + block.size_of(p)) for p in block.points]
    if block.time is not None:
        words = places(block.time, packed=block.packed)
        spans.append((min(words), max(words) + 1))
    return sorted(spans, reverse=True)


def _joined(pieces: list[tuple[int, Block, int, int]]) -> Fetch:
    _, block, offset, _ = pieces[0]
    total = sum(count for *_, count in pieces)
    request = ReadRegisters(block.table.read_function, block.address + offset, total)
    parts: list[Part] = []
    at = _HEADER
    for index, _, _, count in pieces:
        parts.append(Part(index, at, at + 2 * count))
        at += 2 * count
    return Fetch(request, tuple(parts))

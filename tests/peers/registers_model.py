"""A device of any registers without a line: its tables, its samples, and what is true about them.

The memory file has `unit`, `groups`, and optionally `more` ([area, first, last] of registers that
exist beside the cells, zero) and `refuse` (area, first, last, code, times: exceptions for reads).

A group is a set of `cells` that change together. Without `every` they stand from the start;
otherwise a sample completes after so many seconds, `samples` in all, from the first request on
(`at_once`: the first one stands there before). `tells` says how it announces a sample: `how`
"client" (a flag that the client has to put `down`) or "read" (a flag that falls when anything of
`reads` is read), `area`, `at`, `mask`, `up`, `down`. `lose`: samples whose first answer is never
sent. `restart_after`: the power fails after that sample; the memory is zero then, and counters
begin again.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registers_cells import BIT_AREAS, Cell, contents, given
from roc_options import rng
from wire import (
    ILLEGAL_ADDRESS,
    ILLEGAL_FUNCTION,
    ILLEGAL_VALUE,
    WRITE_MANY,
    WRITE_ONE,
    PduError,
    exception_pdu,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from registers_options import Options
    from roc_truth import Truth

_AREA_OF_READ = {1: 0, 2: 1, 3: 4, 4: 3}
_HOLDING = 4
_MOST_BITS = 2000
_MOST_WORDS = 125
_FORM = 5
"""Octets of a request to read, or to write one register."""


@dataclass
class Group:
    """k: number of the sample that stands there; n: since the power came, 0 = none yet."""

    about: dict[str, Any]
    k: int = 0
    n: int = 0
    values: dict[str, Any] = field(default_factory=dict)
    lost: set[int] = field(default_factory=set)

    @property
    def name(self) -> str:
        return str(self.about["name"])

    @property
    def cells(self) -> list[Cell]:
        cells: list[Cell] = self.about["cells"]
        return cells

    @property
    def tells(self) -> dict[str, Any]:
        tells: dict[str, Any] = self.about.get("tells", {})
        return tells


@dataclass
class Reply:
    """`pdu` None: the device does not answer. A `fate` of its own stands above the link's."""

    pdu: bytes | None
    facts: dict[str, object] | None = None
    fate: str = ""


class Model:
    def __init__(self, options: Options, truth: Truth) -> None:
        about = json.loads(Path(options.memory).read_text(encoding="utf-8"))
        self.unit = int(about["unit"])
        self.groups = [Group(group) for group in about["groups"]]
        self.on_request: Callable[[], None] = lambda: None
        self._truth = truth
        self._more = about.get("more", [])
        self._refusals = [dict(refusal) for refusal in about.get("refuse", [])]
        self._short = options.short
        self._random = rng(options.seed, "short")
        self._disk: Any = None
        if options.check_disk:
            from roc_disk import Disk  # noqa: PLC0415 - the one module that needs the mcap package

            self._disk = Disk(options.check_disk)
        self._memory: dict[tuple[int, int], int] = {}
        self._owners: dict[tuple[int, int], set[str]] = {}

    def power_up(self) -> None:
        self._memory.clear()
        for area, first, last in self._more:
            self._memory |= {(area, at): 0 for at in range(first, last + 1)}
        for group in self.groups:
            group.n = 0
            for cell in group.cells:
                words = contents(cell, given(cell, 1, 1))
                places = [(cell["area"], cell["at"] + at) for at in range(len(words))]
                self._memory |= dict.fromkeys(places, 0)
                for place in places:
                    self._owners.setdefault(place, set()).add(group.name)
            if group.tells:
                self._memory[self._flag(group)] = group.tells.get("down", 0)
        for group in self.groups:
            if not group.about.get("every") or (group.about.get("at_once") and not group.k):
                self.complete(group)

    def complete(self, group: Group) -> None:
        """The next sample of the group is in the registers, all of it at once."""
        was_up = self._is_up(group)
        before = group.k
        group.k, group.n = group.k + 1, group.n + 1
        group.values = {c["name"]: given(c, group.k, group.n) for c in group.cells}
        for cell in group.cells:
            for at, word in enumerate(contents(cell, group.values[cell["name"]])):
                self._memory[cell["area"], cell["at"] + at] = word
        if group.tells:
            place, mask = self._flag(group), group.tells.get("mask", 0xFFFF)
            self._memory[place] = self._memory[place] & ~mask | group.tells.get("up", mask & 1)
        if was_up:
            self._truth.log("overwritten", group=group.name, k=before)
        self._truth.log("made", group=group.name, k=group.k, values=group.values)

    def execute(self, pdu: bytes, fate: str, origin: dict[str, object]) -> Reply:
        """`fate` is what the link will do to the answer; `origin` goes into the truth log."""
        self.on_request()
        try:
            return self._answer(pdu, origin)
        except PduError as error:
            facts = {"request": pdu.hex(), "code": error.code, "fate": fate, **origin}
            self._truth.log("exception", **facts)
            return Reply(exception_pdu(pdu[0], error.code))

    def settled(self, reply: Reply, fate: str, **extra: object) -> None:
        """The answer has gone its way: `fate` is what became of it in the end."""
        if reply.facts is not None:
            self._truth.log("read", fate=reply.fate or fate, **reply.facts, **extra)

    def _answer(self, pdu: bytes, origin: dict[str, object]) -> Reply:
        function = pdu[0]
        if function in (WRITE_ONE, WRITE_MANY):
            return self._write(pdu, origin)
        if function not in _AREA_OF_READ:
            raise PduError(ILLEGAL_FUNCTION)
        if len(pdu) != _FORM:
            raise PduError(ILLEGAL_VALUE)
        area = _AREA_OF_READ[function]
        at, count = struct.unpack(">HH", pdu[1:])
        if not 1 <= count <= (_MOST_BITS if area in BIT_AREAS else _MOST_WORDS):
            raise PduError(ILLEGAL_VALUE)
        places = [(area, at + offset) for offset in range(count)]
        if not all(place in self._memory for place in places):
            raise PduError(ILLEGAL_ADDRESS)
        self._refuse(area, range(at, at + count))
        body = _packed(area, [self._memory[place] for place in places])
        names = set().union(*(self._owners.get(place, set()) for place in places))
        told = {group.name: group.k if group.n else 0 for group in self.groups}
        told = {name: k for name, k in told.items() if name in names}
        facts = {"area": area, "at": at, "count": count, "told": told, "data": body.hex()}
        facts["took"] = self._lower(area, places)
        reply = Reply(bytes([function, len(body)]) + body, {**facts, **origin})
        return self._spoilt(reply, told)

    def _spoilt(self, reply: Reply, told: dict[str, int]) -> Reply:
        for group in self.groups:
            k = told.get(group.name, 0)
            if k in group.about.get("lose", ()) and k not in group.lost:
                group.lost.add(k)
                self._truth.log("read", fate="lost", **(reply.facts or {}))
                return Reply(None)
        if reply.pdu is not None and self._random.random() < self._short:
            size = max(0, reply.pdu[1] - 2)
            return Reply(reply.pdu[:1] + bytes([size]) + reply.pdu[2:-2], reply.facts, "short")
        return reply

    def _lower(self, area: int, places: list[tuple[int, int]]) -> dict[str, int]:
        """Flags that fall by being read, and the sample of each."""
        took = {}
        for group in self.groups:
            if group.tells.get("how") != "read" or not self._is_up(group):
                continue
            where, first, last = group.tells["reads"]
            if where == area and any(first <= at <= last for _, at in places):
                self._put_down(group)
                took[group.name] = group.k
        return took

    def _write(self, pdu: bytes, origin: dict[str, object]) -> Reply:
        at, value = struct.unpack(">HH", pdu[1:5])
        flagged = [
            group
            for group in self.groups
            if group.tells.get("how") == "client" and self._flag(group) == (_HOLDING, at)
        ]
        if pdu[0] != WRITE_ONE or not flagged or value != flagged[0].tells.get("down", 0):
            self._truth.log("write", pdu=pdu.hex(), **origin)
            raise PduError(ILLEGAL_ADDRESS)
        group = flagged[0]
        facts: dict[str, object] = {"group": group.name, "k": group.k, "was_up": self._is_up(group)}
        if self._disk is not None:
            facts["on_disk"], facts["errors"] = self._look(group)
        self._truth.log("clear", **facts, **origin)
        self._put_down(group)
        return Reply(pdu)

    def _look(self, group: Group) -> tuple[bool, list[str]]:
        """Whether the first cell's octets lie in one message with those of all others."""
        words = (contents(cell, group.values[cell["name"]]) for cell in group.cells)
        needle = b"".join(struct.pack(f">{len(part)}H", *part) for part in words)
        mark, errors = self._disk.find([(needle, "here")])
        return mark is not None, errors

    def _refuse(self, area: int, span: range) -> None:
        for refusal in self._refusals:
            inside = refusal["first"] <= span[-1] and span[0] <= refusal["last"]
            if refusal["area"] == area and inside and refusal["times"]:
                refusal["times"] -= 1
                raise PduError(refusal["code"])

    def _flag(self, group: Group) -> tuple[int, int]:
        return group.tells["area"], group.tells["at"]

    def _is_up(self, group: Group) -> bool:
        if not group.tells:
            return False
        mask = group.tells.get("mask", 0xFFFF)
        return bool(self._memory[self._flag(group)] & mask == group.tells.get("up", mask & 1))

    def _put_down(self, group: Group) -> None:
        mask = group.tells.get("mask", 0xFFFF)
        word = self._memory[self._flag(group)]
        self._memory[self._flag(group)] = word & ~mask | group.tells.get("down", 0)


def _packed(area: int, words: list[int]) -> bytes:
    if area not in BIT_AREAS:
        return struct.pack(f">{len(words)}H", *words)
    octets = bytearray((len(words) + 7) // 8)
    for number, bit in enumerate(words):
        octets[number // 8] |= bit << number % 8
    return bytes(octets)

"""A device of any registers as a process of its own, and its truth beside what was recorded of it.

A map is written once, as blocks of cells, and told to both sides in their own words: to the device
what octets it has, to the recorder what they are said to mean. What they must be recorded as stands
beside them.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from bench.process import Child
from bench.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from bench.truth import Line

_PEER: Final = Path(__file__).parents[3] / "peers/registers.py"
COILS, DISCRETE, INPUT, HOLDING = 0, 1, 3, 4
TABLES: Final = {
    COILS: "coils",
    DISCRETE: "discrete_inputs",
    INPUT: "input_registers",
    HOLDING: "holding_registers",
}
OCTETS: Final = {
    "ABCD": {4: "1234", 8: "12345678"},
    "CDAB": {4: "3412", 8: "78563412"},
    "BADC": {4: "2143", 8: "21436587"},
    "DCBA": {4: "4321", 8: "87654321"},
    "AB": {2: "12"},
    "BA": {2: "21"},
}
"""Which octet of a value lies where, by the configuration's word for it and octets of the value."""
_WORDS: Final = {
    **dict.fromkeys(("u16", "i16", "d4", "pair"), 1),
    **dict.fromkeys(("u32", "i32", "f32", "d8", "cp32"), 2),
    **dict.fromkeys(("u64", "i64", "f64", "d16", "cp56"), 4),
}


class Doubtful(NamedTuple):
    """A value that is kept and named as doubtful."""

    value: Any


@dataclass(frozen=True)
class Cell:
    """One value, on both sides.

    kind, order: of tests/peers/registers_cells.py. gives: what the device has, by sample.
    toml: the keys of the point but name and offset; empty = no point, but a stamp or a flag.
    means: what is recorded, by sample; empty = what the device has. None = missing.
    more: of bits and parts, by name. counts: as of the device.
    """

    name: str
    kind: str
    gives: tuple[Any, ...] = ()
    toml: str = ""
    means: tuple[Any, ...] = ()
    order: str = ""
    more: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    counts: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        if self.kind.startswith("chars:"):
            return int(self.kind.partition(":")[2]) // 2
        if self.kind == "words":
            return len(self.gives[0])
        return _WORDS.get(self.kind, 1)

    def meant(self, sample: Line) -> Iterator[tuple[str, Any]]:
        """(field, value) of what must be recorded of that sample."""
        at = sample["k"] - 1
        value = self.means[at % len(self.means)] if self.means else sample["values"][self.name]
        yield self.name, value
        for name, values in self.more.items():
            yield name, values[at % len(values)]


@dataclass(frozen=True)
class Block:
    """Cells that follow each other, or lie where ``at_of`` says, and change together.

    toml: further keys of the block. group: further keys of the device's group.
    times: the device's time that is recorded, by sample, ns UTC; empty = no time.
    """

    name: str
    area: int
    at: int
    cells: tuple[Cell, ...]
    toml: str = ""
    group: Mapping[str, Any] = field(default_factory=dict)
    times: tuple[int, ...] = ()
    at_of: Mapping[str, int] = field(default_factory=dict)
    count: int = 0

    @property
    def places(self) -> list[tuple[Cell, int]]:
        """Cells and their offsets."""
        found, at = [], 0
        for cell in self.cells:
            at = self.at_of.get(cell.name, at)
            found.append((cell, at))
            at += cell.size
        return found

    @property
    def points(self) -> list[tuple[Cell, int]]:
        return [(cell, at) for cell, at in self.places if cell.toml]

    @property
    def size(self) -> int:
        return self.count or max(at + cell.size for cell, at in self.places)

    @property
    def is_once(self) -> bool:
        return 'read = "once"' in self.toml

    @property
    def is_atomic(self) -> bool:
        return "atomic = false" not in self.toml

    def described(self, device: str) -> str:
        """In the words of the configuration."""
        points = "".join(
            f'  {{ name = "{cell.name}", offset = {at}, {cell.toml} }},\n'
            for cell, at in self.points
        )
        return (
            f'[[devices.{device}.blocks]]\nname = "{self.name}"\ntable = "{TABLES[self.area]}"\n'
            f"address = {self.at}\ncount = {self.size}\n{self.toml}\npoints = [\n{points}]\n"
        )

    def memory(self) -> dict[str, Any]:
        """In the words of the device."""
        cells = []
        for cell, at in self.places:
            made: dict[str, Any] = {"name": cell.name, "area": self.area, "at": self.at + at}
            made |= {"as": cell.kind, "order": cell.order}
            what = {"counts": cell.counts[:2], "start": cell.counts[2]} if cell.counts else {}
            cells.append(made | (what or {"give": cell.gives}))
        return {"name": self.name, "cells": cells, **self.group}


class Device:
    """tests/peers/registers.py as a process; the options are its own.

    more: registers beside the blocks. refuse: of the device's memory file.
    """

    def __init__(
        self,
        folder: Path,
        *blocks: Block,
        name: str = "dev",
        line: str = "tcp",
        unit: int = 9,
        more: Sequence[tuple[int, int, int]] = (),
        refuse: Sequence[dict[str, int]] = (),
        **options: Any,
    ) -> None:
        self.name, self.line, self.blocks = name, line, blocks
        self._log = folder / f"{name}.truth.jsonl"
        memory = folder / f"{name}.json"
        padding = [(b.area, b.at, b.at + b.size - 1) for b in blocks]
        groups = [block.memory() for block in blocks]
        about = {"unit": unit, "groups": groups, "more": [*padding, *more], "refuse": refuse}
        memory.write_text(json.dumps(about))
        where = str(folder / name) if line == "pty" else "127.0.0.1:0"
        command = [sys.executable, str(_PEER), f"--{line}", where, "--memory", str(memory)]
        command += ["--truth", str(self._log)]
        for key, value in options.items():
            command += ["--" + key.replace("_", "-"), str(value)]
        self.child = Child(command, folder / f"{name}.peer")
        try:
            self.child.while_it_runs(lambda: self.child.said().endswith("\n"), "it to listen")
        except BaseException:
            self.child.kill()
            raise
        self.address = self.child.said().split()[1]

    @property
    def truth(self) -> Truth:
        return Truth(self._log)

    def read(self, block: str) -> int:
        """Number of the last sample that a client was sent."""
        told = [line["told"].get(block, 0) for line in self.truth.of("read")]
        return max(told, default=0)

    def end(self) -> Truth:
        self.child.stop()
        return self.truth

    def toml(self, device: str, *, connection: str = "") -> str:
        """device: its keys beside the blocks; connection: further lines."""
        where = f'transport = "{self.line}"\nhost = "127.0.0.1"\nport = {self.address}'
        if self.line == "pty":
            where = f'transport = "rtu"\nport = "{self.address}"\nbaudrate = 115200'
            where += '\nsilence = "2ms"'
        return (
            f"[connections.{self.name}]\n{where}\n{connection}\n"
            f'[devices.{self.name}]\nprofile = "registers"\nconnection = "{self.name}"\n'
            f"unit = 9\n{device}\n" + "".join(b.described(self.name) for b in self.blocks)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()

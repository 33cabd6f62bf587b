"""What was recorded of a device of any registers, beside what the device says it had."""

from __future__ import annotations

import json
import math
import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from bench.recording import events, export, gaps, items, nanoseconds, read_csv
from bench.registers import COILS, DISCRETE, Doubtful

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from bench.recording import Gap, Item, Row
    from bench.registers import Block, Cell, Device
    from bench.truth import Line, Truth

_READ: Final = ("ok", "late", "garbage")
"""What may have become of an answer that the recorder took."""


@dataclass
class Found:
    """samples: numbers of the device's, in the order of the recording. wrong: what is not so."""

    samples: list[int] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    messages: list[Item] = field(default_factory=list)

    @property
    def twice(self) -> list[int]:
        return sorted(k for k, count in Counter(self.samples).items() if count > 1)


class Judge:
    """Every message, every CSV cell and every value of NDJSON against what the device had."""

    def __init__(self, directory: Path, out: Path, device: Device) -> None:
        self.truth = device.truth
        self.directory = directory
        self._device = device.name
        self._out = out
        if not out.exists():
            export(directory, out)
        self._reads = [line for line in self.truth.of("read") if line["fate"] in _READ]
        self._made = {(line["group"], line["k"]): line for line in self.truth.of("made")}

    def block(self, block: Block) -> Found:
        found = Found(messages=items(self.directory, f"/{self._device}/{block.name}"))
        rows = read_csv(self._out / f"{self._device}.{block.name}.csv")
        fresh = found.messages
        if len(rows) != len(fresh):
            found.wrong.append(f"{len(rows)} rows of {len(fresh)} messages")
        if [m.values.seq for m in fresh] != list(range(1, len(fresh) + 1)):
            found.wrong.append(f"sequence: {[m.values.seq for m in fresh]}")
        for message, row in zip(fresh, rows, strict=False):
            k = self._sample_of(block, message, found)
            if k is None:
                continue
            found.samples.append(k)
            if message.publish_time != (message.values.device_time or message.values.read_at):
                found.wrong.append(f"publish_time of seq {message.values.seq}")
            if k:
                compared = _Comparison(block, self._made[block.name, k], message.values, row)
                found.wrong += compared.wrong
        return found

    def gaps(self) -> list[Gap]:
        return gaps(self.directory, self._device)

    def events(self, name: str) -> list[str]:
        return events(self.directory, f"{self._device}.{name}")

    def _sample_of(self, block: Block, message: Item, found: Found) -> int | None:
        """The sample that was told in answer to the requests of that very message; 0 = zeros."""
        values = message.values
        reads = [r for r in self._reads if values.asked_at <= r["wall_ns"] <= values.read_at]
        own = [r for r in reads if _overlaps(r, block)]
        told = {r["told"][block.name] for r in own if block.name in r["told"]}
        if len(told) != 1:
            found.wrong.append(f"{len(own)} reads tell {told} for seq {values.seq}")
            return None
        if values.raw != _raw(block, own):
            found.wrong.append(f"raw of seq {values.seq} is not what was answered")
        return int(told.pop())


def check_requests(
    truth: Truth, blocks: Iterable[Block], gates: Iterable[tuple[int, int]] = ()
) -> list[str]:
    """Requests that split an atomic block, or read what nobody named; writes beside clears."""
    blocks = list(blocks)
    allowed = {(b.area, at) for b in blocks for at in range(b.at, b.at + b.size)}
    wrong = [f"written: {line['pdu']}" for line in truth.of("write")]
    wrong += [f"refused: {line['request']}" for line in truth.of("exception") if line["code"] < 4]
    for read in truth.of("read"):
        place = read["area"], read["at"], read["count"]
        if read["count"] == 1 and place[:2] in gates:
            continue
        hit = [b for b in blocks if _overlaps(read, b)]
        span = {(read["area"], read["at"] + n) for n in range(read["count"])}
        if not span <= allowed:
            wrong.append(f"nobody named all of {place}")
        if any(b.is_atomic and place != (b.area, b.at, b.size) for b in hit):
            wrong.append(f"{place} is not all of {[b.name for b in hit]}")
    return wrong


def facts(metadata: Mapping[str, str], block: Block) -> dict[str, Any]:
    """Facts as the recording has them: JSON of any other program's reading."""
    found: dict[str, Any] = json.loads(metadata[block.name], parse_constant=_refused)
    return found


def _refused(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")


def _overlaps(read: Line, block: Block) -> bool:
    starts_inside = read["at"] < block.at + block.size
    return bool(
        read["area"] == block.area and starts_inside and block.at < read["at"] + read["count"]
    )


def _raw(block: Block, reads: list[Line]) -> bytes:
    """The octets of the block out of the answers, each asked for where it lies."""
    if block.area in (COILS, DISCRETE):
        return bytes.fromhex(reads[0]["data"])
    words: dict[int, bytes] = {}
    for read in reads:
        data = bytes.fromhex(read["data"])
        words |= {read["at"] + n: data[2 * n : 2 * n + 2] for n in range(read["count"])}
    return b"".join(words.get(at, b"") for at in range(block.at, block.at + block.size))


class _Comparison:
    """One message and its row."""

    def __init__(self, block: Block, sample: Line, message: Any, row: Row) -> None:
        self.wrong: list[str] = []
        self._where = f"{block.name}, sample {sample['k']}"
        missing, doubtful = 0, []
        for index, (cell, _) in enumerate(block.points):
            for name, meant in cell.meant(sample):
                value = meant.value if isinstance(meant, Doubtful) else meant
                if name == cell.name:
                    missing |= (value is None) << index
                    doubtful += [name] if isinstance(meant, Doubtful) else []
                self._value(cell, name, value, getattr(message, name))
                self._cell(cell, name, value, row[name])
        self._is("missing", getattr(message, "missing", 0), missing)
        names = [cell.name for cell, _ in block.points]
        bits = [name for n, name in enumerate(names) if message.doubtful >> n & 1]
        self._is("doubtful", bits, doubtful)
        self._is("doubtful in CSV", row["doubtful"].split(), doubtful)
        time = block.times[(sample["k"] - 1) % len(block.times)] if block.times else 0
        self._is("device_time", message.device_time, time)
        self._is(
            "device_time in CSV", row["device_time"] and nanoseconds(row["device_time"]), time or ""
        )

    def _is(self, what: str, found: object, meant: object) -> None:
        if found != meant:
            self.wrong.append(f"{self._where}: {what} is {found!r}, not {meant!r}")

    def _value(self, cell: Cell, name: str, meant: Any, found: Any) -> None:
        """A missing integer says nothing, a missing float is NaN."""
        if meant is None:
            if isinstance(found, float) and not math.isnan(found):
                self._is(name, found, "NaN")
        elif type(found) is not type(meant) or not _same(cell, meant, found):
            self._is(name, found, meant)

    def _cell(self, cell: Cell, name: str, meant: Any, text: str) -> None:
        if meant is None or isinstance(meant, bool | int):
            self._is(f"{name} in CSV", text, "" if meant is None else str(meant).lower())
        elif isinstance(meant, str):  # what a spreadsheet would run is defused
            self._is(f"{name} in CSV", text, f"'{meant}" if meant.startswith("=") else meant)
        elif not _same(cell, meant, float(text or "nan")):
            self._is(f"{name} in CSV", text, meant)


def _same(cell: Cell, meant: Any, found: Any) -> bool:
    if isinstance(meant, float):
        code = ">f" if cell.kind == "f32" and "scale" not in cell.toml else ">d"
        if math.isnan(meant):
            return math.isnan(found)
        return struct.pack(code, meant) == struct.pack(code, found)
    return bool(meant == found)

"""What lies in registers and bits: numbers, digits, text and stamps to octets, by struct alone.

A cell has a name, an `area` by the first digit of its old reference number (0 coils, 1 discrete
inputs, 3 input registers, 4 holding registers), `at` (counted from 0), `as`, and what sample k has:
`give`, taken in turn, or `counts` [first, last] for a number that grows by one with each sample and
begins again. `order` names the octets of the value, the most significant being 1, as they lie in
the registers: "3412" has the low word first. Longer values repeat it.
"""

from __future__ import annotations

import struct
from typing import Any

Cell = dict[str, Any]

_NUMBERS = {
    "u16": ">H",
    "i16": ">h",
    "u32": ">I",
    "i32": ">i",
    "u64": ">Q",
    "i64": ">q",
    "f32": ">f",
    "f64": ">d",
}
_DIGITS = {"d4": 4, "d8": 8, "d16": 16}
BIT_AREAS = (0, 1)


def given(cell: Cell, k: int, n: int) -> Any:
    """What sample k has, the n-th since the power came."""
    if "counts" in cell:
        first, last = cell["counts"]
        return first + (cell.get("start", first) - first + n - 1) % (last - first + 1)
    return cell["give"][(k - 1) % len(cell["give"])]


def contents(cell: Cell, value: Any) -> list[int]:
    """Bits, or words, from `at` on."""
    if cell["area"] in BIT_AREAS:
        bits = [value] if isinstance(value, bool | int) else list(value)
        return [int(bit) for bit in bits]
    octets = _ordered(_octets(cell["as"], value), cell.get("order", ""))
    return list(struct.unpack(f">{len(octets) // 2}H", octets))


def _octets(kind: str, value: Any) -> bytes:
    if kind in _NUMBERS:
        return struct.pack(_NUMBERS[kind], float(value) if kind[0] == "f" else value)
    if kind in _DIGITS:  # as hexadecimal where the digits are none
        digits = value if isinstance(value, str) else str(value)
        return bytes.fromhex(digits.zfill(_DIGITS[kind]))
    if kind == "pair":
        return bytes(value)
    if kind.startswith("chars:"):
        return bytes(value, "latin-1").ljust(int(kind.partition(":")[2]), b"\0")
    if kind in ("cp56", "cp32"):
        return _stamp(kind, value)
    if kind == "words":
        return struct.pack(f">{len(value)}H", *value)
    raise ValueError(f"{kind!r} is no kind of cell")


def _stamp(kind: str, shown: list[int] | None) -> bytes:
    """IEC 60870-5-4, 6.8, from year, month, day, hour, minute, milliseconds, summer time."""
    if shown is None:
        return bytes(8 if kind == "cp56" else 4)
    year, month, day, hour, minute, milliseconds, summer = shown
    short = struct.pack("<HBB", milliseconds, minute, hour | summer << 7)
    return short if kind == "cp32" else short + bytes([day, month, year % 100, 0])


def _ordered(octets: bytes, order: str) -> bytes:
    size = len(order) or 1
    parts = (octets[at : at + size] for at in range(0, len(octets), size))
    places = [int(digit) - 1 for digit in order] or [0]
    return b"".join(bytes(part[place] for place in places) for part in parts)

"""Functions 1 and 2: coils and discrete inputs, V1.1b3 sections 6.1 and 6.2."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True)
class ReadBits:
    """Reads coils (function 1) or discrete inputs (function 2).

    Raises:
        ValueError: another function, not 1 to 2000 bits, or bits that do not exist.
    """

    function: int
    address: int
    count: int

    def __post_init__(self) -> None:
        if self.function not in (1, 2):
            raise ValueError(f"function {self.function} does not read bits")
        if not 1 <= self.count <= 2000:
            raise ValueError(f"{self.count} is not 1 to 2000 bits")
        if not 0 <= self.address <= 0x10000 - self.count:
            raise ValueError(f"{self.count} bits from {self.address} on do not exist")

    @cached_property
    def pdu(self) -> bytes:
        return struct.pack(">BHH", self.function, self.address, self.count)

    @cached_property
    def head(self) -> bytes:
        return bytes([self.function, (self.count + 7) // 8])

    @property
    def answer_size(self) -> int:
        return 2 + (self.count + 7) // 8


def unpack_bits(octets: bytes, count: int) -> tuple[int, ...]:
    """The first ``count`` bits, each 0 or 1; the first is the lowest bit of the first octet.

    Spare bits behind them should be 0; what a device writes there says nothing.

    Raises:
        ValueError: fewer octets than the bits need, or more.
    """
    if len(octets) != (count + 7) // 8:
        raise ValueError(f"{count} bits are not in {len(octets)} octets")
    text = f"{int.from_bytes(octets, 'little'):0{8 * len(octets)}b}"
    return tuple(map(int, text[: -count - 1 : -1]))


def pack_bits(bits: Sequence[int]) -> bytes:
    """As on the wire, spare bits 0."""
    packed = sum(1 << index for index, bit in enumerate(bits) if bit)
    return packed.to_bytes((len(bits) + 7) // 8, "little")

"""Where words lie and what they can be: the tables of Modbus, types of values, orders of octets."""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class Table(StrEnum):
    """The tables of V1.1b3 section 4.3."""

    COILS = "coils"
    DISCRETE_INPUTS = "discrete_inputs"
    INPUT_REGISTERS = "input_registers"
    HOLDING_REGISTERS = "holding_registers"

    @property
    def read_function(self) -> int:
        return _READ_FUNCTIONS[self.value]

    @property
    def has_bits(self) -> bool:
        """Whether it holds single bits, not words."""
        return self in _BITS


_BITS: Final = ("coils", "discrete_inputs")
_READ_FUNCTIONS: Final = {
    "coils": 1,
    "discrete_inputs": 2,
    "holding_registers": 3,
    "input_registers": 4,
}


class WordType(StrEnum):
    """How words become a value."""

    U16 = "uint16"
    S16 = "int16"
    U32 = "uint32"
    S32 = "int32"
    U64 = "uint64"
    S64 = "int64"
    F32 = "float32"
    """IEEE 754 binary32."""
    F64 = "float64"
    """IEEE 754 binary64."""
    BCD16 = "bcd16"
    """Four decimal digits, the most significant in the uppermost four bits."""
    BCD32 = "bcd32"
    BCD64 = "bcd64"
    MINUTES_SECONDS = "minutes_seconds"
    """One word, minutes in the upper octet, seconds in the lower; the value is in seconds."""
    MONTH_DAY = "month_day"
    """One word, month in the upper octet, day in the lower; the value is month * 100 + day."""
    TEXT = "text"
    """Two characters in a word, upper octet first; the first 0x00 ends it."""
    OCTETS = "bytes"
    """Octets as on the wire."""
    BIT = "bit"
    """One coil or discrete input."""

    @property
    def words(self) -> int:
        """Registers of a value; of text and octets the point says it."""
        return {"32": 2, "64": 4}.get(self.value[-2:], 1)

    @property
    def has_length(self) -> bool:
        """Whether the point says how long it is."""
        return self in (WordType.TEXT, WordType.OCTETS)

    @property
    def is_float(self) -> bool:
        return self in (WordType.F32, WordType.F64)

    @property
    def is_integer(self) -> bool:
        """Whether the value is a binary integer, signed or not."""
        return self.value.removeprefix("u").startswith("int")

    @property
    def is_bcd(self) -> bool:
        return self.value.startswith("bcd")


class WordOrder(StrEnum):
    """Order of the octets of a value, named by example: where 0x41424344 is found as what.

    The first and third letter name upper octets of registers. The same pattern holds for 64 bits:
    ABCD is most significant first, CDAB has the four words reversed, BADC the octets of each word,
    DCBA both. In one register, and in text, only the octets can be swapped: BADC and DCBA do.
    """

    ABCD = "ABCD"
    CDAB = "CDAB"
    BADC = "BADC"
    DCBA = "DCBA"

    @property
    def words_reversed(self) -> bool:
        return self in (WordOrder.CDAB, WordOrder.DCBA)

    @property
    def octets_swapped(self) -> bool:
        return self in (WordOrder.BADC, WordOrder.DCBA)

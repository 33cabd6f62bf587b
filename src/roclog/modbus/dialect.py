"""Where the octets of a device differ from the standard's. Data; streams and requests obey it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from roclog.errors import WrongAnswer

ByteOrder = Literal["big", "little"]

_COUNTED_ANSWERS: Final = frozenset({3, 23})
"""Functions whose answer is a byte count and as many octets."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """The default is the standard: Messaging on TCP/IP V1.0b and Application Protocol V1.1b3.

    order: of the MBAP header and of every field of 16 or 32 bits in a PDU. Arrays of octets (text,
    keys) are the same in both, so a payload is never swapped as a whole: whoever decodes a field
    applies the order to it.
    wide_below: byte counts of functions 3, 16 and 23 have 16 bits where the register is below this.
    units: that the device answers to. max_pdu: octets.
    has_functions: a register is a function, and to read it is to call it.
    """

    order: ByteOrder = "big"
    wide_below: int = 0
    units: range = range(256)
    max_pdu: int = 253
    has_functions: bool = False

    def count_size(self, register: int) -> int:
        """Octets of the byte count that goes with this register."""
        return 2 if register < self.wide_below else 1

    def word(self, value: int) -> bytes:
        """A field of 16 bits."""
        return value.to_bytes(2, self.order)

    def count(self, register: int, octets: int) -> bytes:
        """The byte count of so many octets."""
        return octets.to_bytes(self.count_size(register), self.order)

    def check_count_size(self, request: bytes, answer: bytes) -> None:
        """Tell an answer of the other count size; the length of the answer shows which it has.

        Both are PDUs. Taken for 8 bits, a count of 16 bits reads as zero registers.

        Raises:
            WrongAnswer: it is an answer, of the other size.
        """
        if len(answer) < 3 or answer[0] not in _COUNTED_ANSWERS or answer[0] != request[0]:
            return
        register = int.from_bytes(request[1:3], self.order)
        size = self.count_size(register)
        other = 3 - size
        if int.from_bytes(answer[1 : 1 + other], self.order) == len(answer) - 1 - other:
            sizes = f"{8 * other} bits, register {register} of this device has {8 * size}"
            raise WrongAnswer(f"the byte count of the answer has {sizes}", answer)


STANDARD: Final = Dialect()

MSX_E: Final = Dialect(wide_below=1000, units=range(2), max_pdu=258, has_functions=True)
"""ADDI-DATA MSX-E. A register is a function of the module; those below 1000 are kept for old
clients. The vendor's client reads byte counts of at most 255, so 258 octets are the longest PDU."""

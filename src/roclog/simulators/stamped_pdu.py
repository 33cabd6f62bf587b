"""Answers of a device with time-stamped inputs, right ones and the ones its document misprints.

Written from the document alone and sharing no code with the logger's side: "A technique for
implementation of Time Stamping of Data using the MODBUS Encapsulated Interface Transport".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

FUNCTION: Final = 0x2B
DISCRETE: Final = frozenset({0x82, 0x92})
REGISTERS: Final = frozenset({0x84, 0x94})
ILLEGAL_FUNCTION: Final = 1
ILLEGAL_ADDRESS: Final = 2
ILLEGAL_VALUE: Final = 3
LARGEST_PDU: Final = 253
"""Octets; Application Protocol V1.1b3, section 4.1."""
PRINTED_BYTE_COUNT: Final = 0x98
PRINTED_STAMP_COUNT: Final = 0x94
PRINTED_MEI: Final = 0x82
"""What section 2.2 prints in its example of MEI type 0x92; right are 0x5D, 0x58 and 0x92."""

Input = tuple[int, bytes]
"""Value and stamp octets."""


@dataclass(frozen=True, slots=True)
class StampedRequest:
    """A request of one of the four MEI types, its form checked."""

    mei: int
    address: int
    count: int


class Refused(Exception):
    """The request gets the exception ``code``."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


def stamp_size(mei: int) -> int:
    """Octets of a stamp."""
    return 7 if mei < 0x90 else 4


def parse_request(pdu: bytes) -> StampedRequest:
    """Take a request of function 43 apart.

    Raises:
        Refused: with code 1 another MEI type, with code 3 a wrong length or a count whose answer
            does not fit a PDU, with code 2 inputs beyond the last address.
    """
    if len(pdu) < 2 or pdu[0] != FUNCTION or pdu[1] not in DISCRETE | REGISTERS:
        raise Refused(ILLEGAL_FUNCTION)
    if len(pdu) != 6:
        raise Refused(ILLEGAL_VALUE)
    mei, address, count = pdu[1], pdu[2] << 8 | pdu[3], pdu[4] << 8 | pdu[5]
    head = 5 + -(-count // 8) if mei in DISCRETE else 3 + 2 * count
    if count == 0 or head + count * stamp_size(mei) > LARGEST_PDU:
        raise Refused(ILLEGAL_VALUE)
    if address + count > 0x10000:
        raise Refused(ILLEGAL_ADDRESS)
    return StampedRequest(mei, address, count)


def discrete_answer(mei: int, inputs: Sequence[Input]) -> bytes:
    """MEI types 0x82 and 0x92: counted status bits, lowest first, then counted stamps."""
    status = bytearray(-(-len(inputs) // 8))
    for i, (value, _) in enumerate(inputs):
        if value:
            status[i // 8] |= 1 << i % 8
    stamps = b"".join(stamp for _, stamp in inputs)
    body = bytes((len(status), *status, len(stamps))) + stamps
    return bytes((FUNCTION, mei, len(body))) + body


def register_answer(mei: int, inputs: Sequence[Input], *, grouped: bool) -> bytes:
    """MEI types 0x84 and 0x94, as the table has it (grouped) or as the examples have it."""
    values = [value.to_bytes(2) for value, _ in inputs]
    stamps = [stamp for _, stamp in inputs]
    if grouped:
        body = b"".join(values + stamps)
    else:
        body = b"".join(value + stamp for value, stamp in zip(values, stamps, strict=True))
    return bytes((FUNCTION, mei, len(body))) + body


def exception_answer(mei: int, code: int, *, with_mei: bool) -> bytes:
    """As the document has it (with the MEI type), or as V1.1b3 section 7 has it."""
    return bytes((FUNCTION | 0x80, mei, code)) if with_mei else bytes((FUNCTION | 0x80, code))


def as_printed(answer: bytes, *, mei: bool = True, counts: bool = True) -> bytes:
    """A fault: an answer of type 0x92 with the MEI type, the byte counts, or both as misprinted."""
    bent = bytearray(answer)
    if mei:
        bent[1] = PRINTED_MEI
    if counts:
        bent[2] = PRINTED_BYTE_COUNT
        bent[4 + bent[3]] = PRINTED_STAMP_COUNT
    return bytes(bent)

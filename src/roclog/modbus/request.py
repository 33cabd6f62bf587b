"""Requests, each knowing exactly what its answer must look like."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Final, Protocol

from roclog.errors import ExceptionAnswer, WrongAnswer
from roclog.modbus.library import read_registers_pdu, write_register_pdu

EXCEPTION_BIT: Final = 0x80
ENCAPSULATED: Final = 0x2B
"""Function 43, V1.1b3 section 6.19; the octet behind it is the MEI type."""
REPORT_SERVER_ID: Final = 0x11
"""Function 17, V1.1b3 section 6.13; the request is this octet alone."""
DEVICE_IDENTIFICATION: Final = 0x0E
"""MEI type of function 43, V1.1b3 section 6.21; a read code of 1 to 4 and an object follow."""
_READS: Final = frozenset({1, 2, 3, 4})
_READ_CODES: Final = frozenset({1, 2, 3, 4})


class Request(Protocol):
    """What a bus needs to know of a request."""

    @property
    def pdu(self) -> bytes: ...

    @property
    def head(self) -> bytes:
        """First octets of every normal answer, function code included."""
        ...

    @property
    def answer_size(self) -> int:
        """Octets of the normal answer's PDU, known from the request alone."""
        ...


class SelfSized(ABC):
    """A request whose answer says itself how long it is; its ``answer_size`` is the least."""

    @abstractmethod
    def size_of(self, start: bytes) -> int:
        """Octets of the answer's PDU that begins so: as many as are known to belong to it."""


@dataclass(frozen=True)
class ReadRegisters:
    """Functions 3 and 4, V1.1b3 sections 6.3 and 6.4.

    Raises:
        ValueError: another function, not 1 to 125 registers, or registers that do not exist.
    """

    function: int
    address: int
    count: int

    def __post_init__(self) -> None:
        if self.function not in (3, 4):
            raise ValueError(f"function {self.function} does not read registers")
        if not 1 <= self.count <= 125:
            raise ValueError(f"{self.count} is not 1 to 125 registers")
        if not 0 <= self.address <= 0x10000 - self.count:
            raise ValueError(f"{self.count} registers from {self.address} on do not exist")

    @cached_property
    def pdu(self) -> bytes:
        return read_registers_pdu(self.function, self.address, self.count)

    @cached_property
    def head(self) -> bytes:
        return bytes([self.function, 2 * self.count])

    @property
    def answer_size(self) -> int:
        return 2 + 2 * self.count


@dataclass(frozen=True)
class WriteRegister:
    """Function 6, V1.1b3 section 6.6; the answer echoes the request.

    Raises:
        ValueError: address or value do not fit 16 bits.
    """

    address: int
    value: int

    def __post_init__(self) -> None:
        if not (0 <= self.address <= 0xFFFF and 0 <= self.value <= 0xFFFF):
            raise ValueError(f"register {self.address} cannot be set to {self.value}")

    @cached_property
    def pdu(self) -> bytes:
        return write_register_pdu(self.address, self.value)

    @property
    def head(self) -> bytes:
        return self.pdu

    @property
    def answer_size(self) -> int:
        return 5


class Mei(IntEnum):
    """The private MEI types that read inputs with their time stamps."""

    DISCRETE_7 = 0x82
    REGISTERS_7 = 0x84
    DISCRETE_4 = 0x92
    REGISTERS_4 = 0x94

    @property
    def is_discrete(self) -> bool:
        return self in (Mei.DISCRETE_7, Mei.DISCRETE_4)

    @property
    def stamp_size(self) -> int:
        """Octets of one time stamp."""
        return 4 if self in (Mei.DISCRETE_4, Mei.REGISTERS_4) else 7

    @property
    def most(self) -> int:
        """Inputs whose answer still fits 253 octets."""
        return _MOST[self]


_MOST: Final = {
    Mei.DISCRETE_7: 34,
    Mei.REGISTERS_7: 27,
    Mei.DISCRETE_4: 60,
    Mei.REGISTERS_4: 41,
}


@dataclass(frozen=True)
class ReadStamped:
    """Inputs and the stamp of each, function 43 with a private MEI type.

    Raises:
        ValueError: not 1 to ``mei.most`` inputs, or inputs that do not exist.
    """

    mei: Mei
    address: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.count <= self.mei.most:
            raise ValueError(f"{self.count} is not 1 to {self.mei.most} inputs")
        if not 0 <= self.address <= 0x10000 - self.count:
            raise ValueError(f"{self.count} inputs from {self.address} on do not exist")

    @cached_property
    def pdu(self) -> bytes:
        return struct.pack(">BBHH", ENCAPSULATED, self.mei, self.address, self.count)

    @cached_property
    def head(self) -> bytes:
        """Up to the byte count; with discrete inputs up to the byte count of their status."""
        head = bytes([ENCAPSULATED, self.mei, self.answer_size - 3])
        return head + bytes([self.status_size]) if self.mei.is_discrete else head

    @property
    def answer_size(self) -> int:
        if self.mei.is_discrete:
            return 5 + self.status_size + self.stamps_size
        return 3 + 2 * self.count + self.stamps_size

    @property
    def status_size(self) -> int:
        """Octets that hold the bits of ``count`` discrete inputs."""
        return (self.count + 7) // 8

    @property
    def stamps_size(self) -> int:
        """Octets of all stamps; behind the status of discrete inputs one octet says the same."""
        return self.count * self.mei.stamp_size


def is_read(pdu: bytes) -> bool:
    """Whether these octets are a request that changes nothing in a device."""
    if pdu[:1] and pdu[0] in _READS:
        return True
    if pdu[:2] == bytes([ENCAPSULATED, DEVICE_IDENTIFICATION]):
        return len(pdu) == 4 and pdu[2] in _READ_CODES
    if len(pdu) == 6 and pdu[0] == ENCAPSULATED and pdu[1] in _MOST:
        return True
    return pdu == bytes([REPORT_SERVER_ID])


def refusals(request: Request) -> tuple[tuple[bytes, int], ...]:
    """First octets and length of every PDU that refuses the request; its last octet is the code.

    With function 43 the MEI type may stand before the code or not. Where that octet is there, the
    longer form comes first: the beginning of its RTU frame is a whole frame of the shorter form
    for one code of each unit and MEI type. The price: a device that leaves the MEI type out and
    says its number as the code, which is no code of any document, is understood only once nothing
    follows.
    """
    octet = bytes([request.pdu[0] | EXCEPTION_BIT])
    if request.pdu[0] != ENCAPSULATED:
        return ((octet, 2),)
    return (octet + request.pdu[1:2], 3), (octet, 2)


def check_answer(request: Request, pdu: bytes) -> None:
    """Raises:
    ExceptionAnswer: the device refused.
    WrongAnswer: function, MEI type, byte count or echo differ from what was asked, or the length
        does.
    """
    function = request.pdu[0]
    for head, size in refusals(request):
        if len(pdu) == size and pdu.startswith(head):
            raise ExceptionAnswer(function, pdu[-1])
    if not pdu or pdu[0] != function:
        raise WrongAnswer(f"this does not answer function {function}", pdu)
    if isinstance(request, ReadStamped) and pdu[1:2] != request.pdu[1:2]:
        raise WrongAnswer(f"this does not answer MEI type 0x{request.mei:02X}", pdu)
    size = request.size_of(pdu) if isinstance(request, SelfSized) else request.answer_size
    if len(pdu) != size:
        raise WrongAnswer(f"{len(pdu)} octets instead of {size}", pdu)
    if not pdu.startswith(request.head):
        raise WrongAnswer("byte count or echo does not fit the request", pdu)
    if isinstance(request, ReadStamped) and request.mei.is_discrete:
        said = pdu[len(request.head) + request.status_size]
        if said != request.stamps_size:
            raise WrongAnswer(f"{said} octets of stamps instead of {request.stamps_size}", pdu)


def words(pdu: bytes) -> tuple[int, ...]:
    """Registers of a checked answer to ReadRegisters."""
    return struct.unpack(f">{(len(pdu) - 2) // 2}H", pdu[2:])

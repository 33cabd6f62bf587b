"""Requests, each knowing exactly what its answer must look like."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

from roclog.errors import ExceptionAnswer, WrongAnswer
from roclog.modbus.library import read_registers_pdu, write_register_pdu

EXCEPTION_BIT: Final = 0x80


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


def check_answer(request: Request, pdu: bytes) -> None:
    """Raises:
    ExceptionAnswer: the device refused.
    WrongAnswer: function, byte count or echo differ from what was asked, or the length does.
    """
    function = request.pdu[0]
    if len(pdu) == 2 and pdu[0] == function | EXCEPTION_BIT:
        raise ExceptionAnswer(function, pdu[1])
    if not pdu or pdu[0] != function:
        raise WrongAnswer(f"this does not answer function {function}", pdu)
    if len(pdu) != request.answer_size:
        raise WrongAnswer(f"{len(pdu)} octets instead of {request.answer_size}", pdu)
    if not pdu.startswith(request.head):
        raise WrongAnswer("byte count or echo does not fit the request", pdu)


def words(pdu: bytes) -> tuple[int, ...]:
    """Registers of a checked answer to ReadRegisters."""
    return struct.unpack(f">{(len(pdu) - 2) // 2}H", pdu[2:])

"""Requests to the ADDI-DATA MSX-E, where a register is a function and a read or write calls it.

Sources: the MODBUS interface description of the MSX-E3317 for function 3 and its exceptions; the
vendor's client for functions 16 and 23, the size of byte counts and the status. Function 23 is
known from that client only. A payload is the octets between the fields of Modbus; its numbers of
16 and 32 bits are in the order of the dialect, its text is not swapped.

A call may act, a read too. So none is repeated because its answer was lost, none is joined with
another, none cut, and word counts are exact. Only what a profile reads on schedule is called again,
when it is due again: for those functions the profile declares that a call changes nothing. What a
user declares as repeatable is called once more where its answer was lost.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from roclog.modbus.dialect import MSX_E, Dialect

STATUS_REGISTER: Final = 10000
"""GetLastCommandStatusEx. It tells of the last call of any client: ask right after a refusal."""
STATUS_WORDS: Final = 54
REMOTE_EXECUTION_ERROR: Final = 9
"""Exception: the function was called and failed; its status says why."""

_MOST_READ: Final = 125
_MOST_WRITTEN: Final = 100
_SEE_ERRNO: Final = -100


@dataclass(frozen=True)
class ReadFunction:
    """Function 3: call a function without parameters.

    words: exactly as documented. payload_octets: of the answer, where it is one more than 2 * words
    (a structure of 133 octets is asked for as 66 words).

    Raises:
        ValueError: no such register, not 1 to 125 words, or octets that do not belong to them.
    """

    register: int
    words: int
    payload_octets: int | None = None
    dialect: Dialect = MSX_E

    def __post_init__(self) -> None:
        _check_register(self.register)
        _check_words(self.words, _MOST_READ)
        if self._octets - 2 * self.words not in (0, 1):
            raise ValueError(f"{self._octets} octets are not asked for as {self.words} words")

    @cached_property
    def pdu(self) -> bytes:
        return b"\x03" + self.dialect.word(self.register) + self.dialect.word(self.words)

    @cached_property
    def head(self) -> bytes:
        return b"\x03" + self.dialect.count(self.register, self._octets)

    @property
    def answer_size(self) -> int:
        return len(self.head) + self._octets

    def payload(self, pdu: bytes) -> bytes:
        """Of a checked answer, octets as on the wire."""
        return pdu[len(self.head) :]

    @property
    def _octets(self) -> int:
        return 2 * self.words if self.payload_octets is None else self.payload_octets


@dataclass(frozen=True)
class WriteFunction:
    """Function 16: call a function with parameters; the answer repeats register and words.

    Raises:
        ValueError: no such register, or the parameters are not 1 to 100 words.
    """

    register: int
    parameters: bytes
    dialect: Dialect = MSX_E

    def __post_init__(self) -> None:
        _check_register(self.register)
        _check_parameters(self.parameters)

    @cached_property
    def pdu(self) -> bytes:
        return self.head + _counted(self.dialect, self.register, self.parameters)

    @cached_property
    def head(self) -> bytes:
        words = len(self.parameters) // 2
        return b"\x10" + self.dialect.word(self.register) + self.dialect.word(words)

    @property
    def answer_size(self) -> int:
        return 5


@dataclass(frozen=True)
class ReadWriteFunction:
    """Function 23: call a function with parameters, and one without.

    The byte count of the request follows the written register, that of the answer the read one. The
    vendor's client expects half of the byte count; here it is 2 * words, anything else is wrong.

    Raises:
        ValueError: as ReadFunction and WriteFunction.
    """

    register: int
    words: int
    write_register: int
    parameters: bytes
    dialect: Dialect = MSX_E

    def __post_init__(self) -> None:
        _check_register(self.register)
        _check_register(self.write_register)
        _check_words(self.words, _MOST_READ)
        _check_parameters(self.parameters)

    @cached_property
    def pdu(self) -> bytes:
        written = self.write_register, len(self.parameters) // 2
        fields = (self.register, self.words, *written)
        head = b"\x17" + b"".join(map(self.dialect.word, fields))
        return head + _counted(self.dialect, self.write_register, self.parameters)

    @cached_property
    def head(self) -> bytes:
        return b"\x17" + self.dialect.count(self.register, 2 * self.words)

    @property
    def answer_size(self) -> int:
        return len(self.head) + 2 * self.words

    def payload(self, pdu: bytes) -> bytes:
        """Of a checked answer, octets as on the wire."""
        return pdu[len(self.head) :]


@dataclass(frozen=True, slots=True)
class CommandStatus:
    """What GetLastCommandStatus tells.

    return_value: 0 = done, -100 = errno tells, others as the function documents. errno: of the
    module's system. text: up to its first NUL, or all 100 characters.
    """

    return_value: int
    errno: int
    text: str

    def __str__(self) -> str:
        errno = f", errno {self.errno}" if self.return_value == _SEE_ERRNO or self.errno else ""
        text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in self.text)
        return f"returned {self.return_value}{errno}{': ' * bool(text)}{text}"


def status_request(dialect: Dialect = MSX_E) -> ReadFunction:
    return ReadFunction(STATUS_REGISTER, STATUS_WORDS, dialect=dialect)


def command_status(payload: bytes, dialect: Dialect = MSX_E) -> CommandStatus:
    """Decode the payload of GetLastCommandStatus.

    Raises:
        ValueError: not its 108 octets; a checked answer has them.
    """
    if len(payload) != 2 * STATUS_WORDS:
        raise ValueError(f"a status has {2 * STATUS_WORDS} octets, not {len(payload)}")
    mark = ">" if dialect.order == "big" else "<"
    return_value, errno, text = struct.unpack(f"{mark}iI100s", payload)
    return CommandStatus(return_value, errno, text.partition(b"\0")[0].decode("latin-1"))


def _counted(dialect: Dialect, register: int, octets: bytes) -> bytes:
    return dialect.count(register, len(octets)) + octets


def _check_register(register: int) -> None:
    if not 0 <= register <= 0xFFFF:
        raise ValueError(f"register {register} is not 0 to 65535")


def _check_words(words: int, most: int) -> None:
    if not 1 <= words <= most:
        raise ValueError(f"{words} is not 1 to {most} words")


def _check_parameters(parameters: bytes) -> None:
    if len(parameters) % 2:
        raise ValueError(f"{len(parameters)} octets of parameters are no whole words")
    _check_words(len(parameters) // 2, _MOST_WRITTEN)

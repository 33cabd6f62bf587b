"""The inputs of a device, their states, and its answers to function 43.

Written from "A technique for implementation of Time Stamping of Data using the MODBUS Encapsulated
Interface Transport" alone.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mei_stamps import MS, NEVER_SET, octets
from roc_options import rng
from wire import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE, PduError

if TYPE_CHECKING:
    from mei_options import Options
    from roc_truth import Truth

ENCAPSULATED = 0x2B
DISCRETE, REGISTERS = "discrete_inputs", "input_registers"
MEI_TYPES = {0x82: (DISCRETE, 7), 0x84: (REGISTERS, 7), 0x92: (DISCRETE, 4), 0x94: (REGISTERS, 4)}
MOST = {0x82: 34, 0x84: 27, 0x92: 60, 0x94: 41}
"""Inputs whose answer still fits the 253 octets of a PDU."""
_HOUR = 3600 * 10**9
_FORM = 6


@dataclass(frozen=True)
class State:
    """n: counts all states of the device. time_ns: what the stamp says, UTC; 0 where it says none.

    stamp: all 7 octets.
    """

    n: int
    value: int
    time_ns: int
    stamp: bytes


@dataclass(frozen=True)
class Reply:
    """facts: of the truth log, None where the log has it already."""

    pdu: bytes | None
    facts: dict[str, object] | None = None


class Model:
    """unit, execute and settled are what a link wants of a device.

    Every `state` is in the truth log, and every `answer` with the states that it told.
    """

    def __init__(self, options: Options, truth: Truth) -> None:
        self.unit = options.unit
        self._options = options
        self._truth = truth
        self._random = rng(options.seed, "events")
        self._started = time.time_ns(), time.monotonic_ns()
        self._failures = options.failures
        self._count = 0
        self._inputs: dict[str, dict[int, State]] = {DISCRETE: {}, REGISTERS: {}}

    def power_up(self) -> None:
        """Every input gets its first state, up to `oldest` hours of age."""
        sizes = {DISCRETE: self._options.discrete, REGISTERS: self._options.registers}
        first = self._options.first
        for table, count in sizes.items():
            for address in range(first, first + count):
                never = self._random.random() < self._options.never
                age = self._random.randrange(int(self._options.oldest * _HOUR) + 1)
                at = 0 if never else self._clock() - age
                self._set(table, address, self._value(table), at)

    def event(self) -> None:
        """One input changes; never twice in one millisecond, which no stamp could tell apart."""
        now = self._clock() // MS * MS
        free = [
            (table, address)
            for table, states in self._inputs.items()
            for address, state in states.items()
            if state.time_ns < now
        ]
        table, address = self._random.choice(free)
        value = known = self._inputs[table][address].value
        if self._random.random() >= self._options.same:
            while value == known:
                value = self._value(table)
        self._set(table, address, value, now, iv=self._random.random() < self._options.iv)

    def execute(self, pdu: bytes, fate: str, origin: dict[str, object]) -> Reply:
        """`fate` is what the link will do to the answer; `origin` goes into the truth log."""
        try:
            return self._answer(pdu, origin)
        except PduError as error:
            facts = {"request": pdu.hex(), "code": error.code, "fate": fate, **origin}
            self._truth.log("exception", **facts)
            is_long = self._options.exceptions == "long" and pdu[0] == ENCAPSULATED
            mei = pdu[1:2] if is_long else b""
            return Reply(bytes([pdu[0] | 0x80]) + mei + bytes([error.code]))

    def settled(self, reply: Reply, fate: str, **extra: object) -> None:
        """The answer has gone its way: `fate` is what became of it in the end."""
        if reply.facts is not None:
            self._truth.log("answer", fate=fate, **reply.facts, **extra)

    def _answer(self, pdu: bytes, origin: dict[str, object]) -> Reply:
        if pdu[0] != ENCAPSULATED or len(pdu) < 2 or pdu[1] not in MEI_TYPES:
            raise PduError(ILLEGAL_FUNCTION)
        if len(pdu) != _FORM:
            raise PduError(ILLEGAL_VALUE)
        mei = pdu[1]
        address, count = int.from_bytes(pdu[2:4], "big"), int.from_bytes(pdu[4:6], "big")
        if not 1 <= count <= MOST[mei]:
            raise PduError(ILLEGAL_VALUE)
        table, size = MEI_TYPES[mei]
        span = range(address, address + count)
        if not all(at in self._inputs[table] for at in span):
            raise PduError(ILLEGAL_ADDRESS)
        self._fail(mei, span)
        states = [self._inputs[table][at] for at in span]
        body = _bits(states, size) if table == DISCRETE else self._words(states, size)
        facts: dict[str, object] = {"mei": mei, "address": address, "count": count}
        facts["states"] = [state.n for state in states]
        return Reply(bytes([ENCAPSULATED, mei, len(body)]) + body, {**facts, **origin})

    def _fail(self, mei: int, span: range) -> None:
        for failure in self._failures:
            if failure.mei == mei and failure.address in span:
                if failure.left == 1:
                    self._failures.remove(failure)
                failure.left = max(0, failure.left - 1)
                raise PduError(failure.code)

    def _words(self, states: list[State], size: int) -> bytes:
        pairs = [(state.value.to_bytes(2, "big"), state.stamp[:size]) for state in states]
        if self._options.layout == "grouped":
            return b"".join(value for value, _ in pairs) + b"".join(stamp for _, stamp in pairs)
        return b"".join(value + stamp for value, stamp in pairs)

    def _clock(self) -> int:
        """UTC nanoseconds that the device's clock shows; it never steps with the host's."""
        wall, monotonic = self._started
        passed = time.monotonic_ns() - monotonic
        gained = passed * self._options.clock_drift / 1e6
        return wall + passed + int(self._options.clock_offset * 1e9 + gained)

    def _value(self, table: str) -> int:
        return self._random.randrange(2 if table == DISCRETE else 0x10000)

    def _set(self, table: str, address: int, value: int, at: int, *, iv: bool = False) -> None:
        """at: UTC ns by the device's clock, 0 where it was never set."""
        self._count += 1
        at = at // MS * MS
        stamp = octets(at, self._options.zone, dow=self._options.dow, iv=iv) if at else NEVER_SET
        self._inputs[table][address] = State(self._count, value, at, stamp)
        self._truth.log(
            "state",
            n=self._count,
            table=table,
            address=address,
            value=value,
            time_ns=0 if iv else at,
            octets=stamp.hex(),
            flags=[] if at and not iv else ["iv" if iv else "no_time"],
        )


def _bits(states: list[State], size: int) -> bytes:
    """Status from the lowest bit of the first octet on, then stamps; octet counts before both."""
    status = bytearray((len(states) + 7) // 8)
    for index, state in enumerate(states):
        status[index // 8] |= state.value << index % 8
    stamps = b"".join(state.stamp[:size] for state in states)
    return bytes([len(status), *status, len(stamps)]) + stamps

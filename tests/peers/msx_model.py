"""The MSX-E3317 without a network: its functions, its clock, and what is true about them.

Functions are those that the interface description spells out; the numbers it only lists are not
there (exception 2). Of the writes, those which every MSX-E has; they change nothing but the status.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msx_frames import READ_WRITE, WRITE, Call, count_size, counted_answer
from roc_options import rng
from wire import ILLEGAL_ADDRESS, ILLEGAL_VALUE, PduError, exception_pdu

if TYPE_CHECKING:
    from collections.abc import Callable

    from msx_options import Failure, Options

STATUS, TYPE, TIME, CUSTOMER = 10000, 10200, 10500, 10550
PRESSURE_CHANNELS, CALIBRATION = 21000, 21150
CHANNELS, CHANNELS_INFO = 15000, 15050

OLD_NUMBERS = {0: STATUS, 1: TYPE, 2: TIME, 3: CUSTOMER}
WORDS = {
    STATUS: 54,
    TYPE: 100,
    TIME: 4,
    CUSTOMER: 16,
    PRESSURE_CHANNELS: 2,
    CALIBRATION: 8,
    CHANNELS: 2,
    CHANNELS_INFO: 96,
}
WRITES = {
    **dict.fromkeys((100, 11000), 8),
    **dict.fromkeys((101, 11050), 32),
    **dict.fromkeys((102, 11100), 4),
    **dict.fromkeys((103, 11150), 4),
    **dict.fromkeys((104, 11200), 48),
    **dict.fromkeys((105, 11250), 16),
}
"""Octets of parameters."""

REMOTE_EXECUTION_ERROR = 9
_PLAIN_KEY = bytes(range(0xA0, 0xB0))
_CRYPTED_KEY = bytes(range(0x50, 0x60))


class Clock:
    """The module's own time: off at the start, and fast or slow from there."""

    def __init__(self, offset: float, drift: float) -> None:
        self._begun = time.monotonic_ns()
        self._start = time.time_ns() + round(offset * 1e9)
        self._drift = drift

    def microseconds(self) -> int:
        elapsed = time.monotonic_ns() - self._begun
        return (self._start + elapsed + round(elapsed * self._drift / 1e6)) // 1000

    def elapsed_seconds(self) -> int:
        return (time.monotonic_ns() - self._begun) // 10**9


@dataclass(frozen=True)
class Outcome:
    """What a call gave. `payload` None: an exception, or an answer without any."""

    call: Call | None
    pdu: bytes
    payload: bytes | None
    facts: dict[str, object]


class Model:
    def __init__(self, options: Options) -> None:
        self._options = options
        self._mark = ">" if options.order == "big" else "<"
        self.clock = Clock(options.clock_offset, options.clock_drift)
        self.failures: dict[int, Failure] = {f.register: f for f in options.failures}
        self._failed: Counter[int] = Counter()
        self._status = (0, 0, "")
        self._payloads: dict[int, Callable[[], tuple[bytes, dict[str, object]]]] = {
            STATUS: self._tell_status,
            TYPE: self._tell_type,
            TIME: self._tell_time,
            CUSTOMER: self._tell_customer,
            PRESSURE_CHANNELS: self._tell_number,
            CALIBRATION: self._tell_calibration,
            CHANNELS: self._tell_number,
            CHANNELS_INFO: self._tell_channels,
        }

    def execute(self, function: int, call: Call | PduError) -> Outcome:
        if isinstance(call, PduError):
            return Outcome(None, exception_pdu(function, call.code), None, {"code": call.code})
        try:
            payload, facts = self._carry_out(call)
        except PduError as error:
            return Outcome(call, exception_pdu(function, error.code), None, {"code": error.code})
        if call.register is None:
            words = (call.written or 0, len(call.parameters) // 2)
            return Outcome(call, struct.pack(f"{self._mark}BHH", WRITE, *words), None, facts)
        pdu = counted_answer(function, count_size(call.register), payload, self._options.order)
        return Outcome(call, pdu, payload, facts)

    def _carry_out(self, call: Call) -> tuple[bytes, dict[str, object]]:
        if call.written is not None:
            if call.written not in WRITES:
                raise PduError(ILLEGAL_ADDRESS)
            if len(call.parameters) != WRITES[call.written]:
                raise PduError(ILLEGAL_VALUE)
            self._perform(call.written)
        if call.register is None:
            return b"", {}
        function = OLD_NUMBERS.get(call.register, call.register)
        if function not in WORDS:
            raise PduError(ILLEGAL_ADDRESS)
        if call.words != WORDS[function]:
            raise PduError(ILLEGAL_VALUE)
        if function != STATUS:  # the status is that of the call before
            self._perform(call.register)
        return self._payloads[function]()

    def _perform(self, register: int) -> None:
        failure = self.failures.get(register)
        most = self._options.fail_count
        if failure is None or (most and self._failed[register] >= most):
            self._status = (0, 0, "")
            return
        self._failed[register] += 1
        self._status = (failure.return_value, failure.errno, failure.text)
        raise PduError(REMOTE_EXECUTION_ERROR)

    def _pack(self, layout: str, *values: object) -> bytes:
        return struct.pack(self._mark + layout, *values)

    def _tell_status(self) -> tuple[bytes, dict[str, object]]:
        value, errno, text = self._status
        facts: dict[str, object] = {"return_value": value, "errno": errno, "text": text}
        return self._pack("iI100s", value, errno, text.encode("latin-1")[:99]), facts

    def _tell_type(self) -> tuple[bytes, dict[str, object]]:
        text = self._options.module
        return self._pack("200s", text.encode("latin-1")[:199]), {"text": text}

    def _tell_time(self) -> tuple[bytes, dict[str, object]]:
        seconds, microseconds = divmod(self.clock.microseconds(), 10**6)
        facts: dict[str, object] = {"seconds": seconds, "microseconds": microseconds}
        return self._pack("II", seconds, microseconds), facts

    def _tell_customer(self) -> tuple[bytes, dict[str, object]]:
        return _PLAIN_KEY + _CRYPTED_KEY, {}

    def _tell_number(self) -> tuple[bytes, dict[str, object]]:
        return self._pack("I", self._options.channels), {"number": self._options.channels}

    def _tell_calibration(self) -> tuple[bytes, dict[str, object]]:
        """Something else every second."""
        random = rng(self._options.seed, f"calibration {self.clock.elapsed_seconds()}")
        status, channel = random.randrange(4), random.randrange(16)
        reference, digital = random.randrange(-4096, 4096) / 16, random.getrandbits(24)
        facts: dict[str, object] = {
            "status": status,
            "channel": channel,
            "reference": reference,
            "digital": digital,
        }
        return self._pack("IIfI", status, channel, reference, digital), facts

    def _tell_channels(self) -> tuple[bytes, dict[str, object]]:
        random = rng(self._options.seed, "channels")
        used = self._options.channels
        arrays = [
            [random.randrange(1, 5) if k < used else 0 for k in range(16)],
            [k // 4 if k < used else 0 for k in range(16)],
            [k % 4 if k < used else 0 for k in range(16)],
        ]
        facts: dict[str, object] = dict(zip(("type", "position", "index"), arrays, strict=True))
        return b"".join(self._pack("16I", *array) for array in arrays), facts


def described(call: Call) -> dict[str, object]:
    """A call as the truth log has it."""
    facts: dict[str, object] = {"function": call.function}
    if call.function != WRITE:
        facts |= {"register": call.register, "words": call.words}
    if call.function in (WRITE, READ_WRITE):
        facts |= {"written": call.written, "parameters": call.parameters.hex()}
    return facts

"""The MSX-E3317 without a network: its functions, its clock, and what is true about them.

Functions are those that the interface description spells out; the numbers it only lists are not
there (exception 2). Of the writes, those which every MSX-E has; they change nothing but the status.

With `acquisition` there are three more, whose layouts no document of the MSX-E3317 gives. They are
made up here, after what the vendor's client knows of the MSX-E371x: an auto refresh counter before
16 values, stamps with microseconds before seconds, a packed structure of 133 octets asked for as 66
words, and the same values below 1000 with a byte count of 16 bits.
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
OLD_VALUES, VALUES, INFORMATION = 101, 15300, 15450

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
MADE_UP = {OLD_VALUES: 34, VALUES: 38, INFORMATION: 66}
"""Words of the functions that are there with `acquisition` only."""
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

    def turn(self, period: float) -> tuple[int, int]:
        """How many periods have passed, and the module's microseconds when the last one ended."""
        length = round(period * 1e9)
        turns = (time.monotonic_ns() - self._begun) // length
        elapsed = turns * length
        return turns, (self._start + elapsed + round(elapsed * self._drift / 1e6)) // 1000


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
            OLD_VALUES: self._tell_old_values,
            VALUES: self._tell_values,
            INFORMATION: self._tell_information,
        }
        self._words = WORDS | (MADE_UP if options.acquisition else {})

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
        if function not in self._words:
            raise PduError(ILLEGAL_ADDRESS)
        if call.words != self._words[function]:
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

    def _acquired(self) -> tuple[int, int, list[int]]:
        """Counter, module time in microseconds, and the numbers of the 16 places."""
        turn, at = self.clock.turn(self._options.acquisition)
        random = rng(self._options.seed, f"values {turn}")
        return turn, at, [random.randrange(-(2**20), 2**20) for _ in range(16)]

    def _tell_values(self) -> tuple[bytes, dict[str, object]]:
        counter, at, numbers = self._acquired()
        values = [number / 16 for number in numbers]
        high, low = divmod(at, 10**6)
        facts: dict[str, object] = {"counter": counter, "values": values, "at_us": at}
        return self._pack("I16fII", counter, *values, low, high), facts

    def _tell_old_values(self) -> tuple[bytes, dict[str, object]]:
        counter, _, numbers = self._acquired()
        return self._pack("I16i", counter, *numbers), {"counter": counter, "values": numbers}

    def _tell_information(self) -> tuple[bytes, dict[str, object]]:
        """Numbers at odd octets, and octets that are not to be swapped."""
        turn, _, numbers = self._acquired()
        facts: dict[str, object] = {
            "kind": turn % 256,
            "serial": numbers[0] % 2**32,
            "text": f"LVDT {turn}",
            "level": numbers[1] % 2**16 - 2**15,
            "gain": numbers[2] / 16,
            "revision": numbers[3] % 2**16,
            "offset": numbers[4],
            "key": rng(self._options.seed, f"key {turn}").randbytes(33).hex(),
            "comment": f"{turn} " * 30,
        }
        kind, serial, text, level, gain, revision, offset, key, comment = facts.values()
        head = (kind, serial, str(text).encode(), level, gain, revision, offset)
        tail = bytes.fromhex(str(key)), str(comment).encode()[:51]
        facts["comment"] = tail[1].decode()
        return self._pack("BI32shfHi33s51s", *head, *tail), facts


def described(call: Call) -> dict[str, object]:
    """A call as the truth log has it."""
    facts: dict[str, object] = {"function": call.function}
    if call.function != WRITE:
        facts |= {"register": call.register, "words": call.words}
    if call.function in (WRITE, READ_WRITE):
        facts |= {"written": call.written, "parameters": call.parameters.hex()}
    return facts

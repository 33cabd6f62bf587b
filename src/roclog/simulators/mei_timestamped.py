"""A device whose inputs carry the time of their last change, simulated from the paper.

Source: "A technique for implementation of Time Stamping of Data using the MODBUS Encapsulated
Interface Transport". Where it is silent, this simulator decides:

- An input is read by one MEI type, that of its list. A type without a list is refused with
  exception 1, as every other function; an input that is not there with exception 2.
- The clock runs in UTC; a stamp has neither summer time nor the day of the week.
- Changes come at random. An input that changed rests until half of the others have changed.
- Discrete inputs toggle. Registers are 4 to 20 mA in microamperes and never keep their value.
- At the start each input was changed some time within the last hour.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from random import Random
from typing import TYPE_CHECKING, Final, TextIO

from roclog.simulators import stamped_pdu

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from roclog.simulators.stamped_pdu import Input, StampedRequest

TRUTH_COLUMNS: Final = ("happened_at", "device_time", "table", "address", "value", "time_octets")
INVALID: Final = 0x80
"""Bit 7 of the minute octet."""
LOWEST: Final = 4_000
SPAN: Final = 16_001
HOUR_S: Final = 3600
NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
PPM: Final = 1_000_000
YEARS: Final = range(1970, 2100)


class Quirk(StrEnum):
    """In what a device differs from the paper's tables and examples where these are right."""

    GROUPED = "grouped"
    """Registers as the table has them: all values, then all stamps."""
    SHORT_EXCEPTIONS = "short-exceptions"
    """Exception answers without the MEI type, as V1.1b3 has them."""
    INVALID_TIME = "invalid-time"
    """Every stamp is marked as invalid (IV)."""
    MISPRINTED = "misprinted"
    """Discrete inputs with the MEI type and the counts that section 2.2 misprints: a fault."""


@dataclass(frozen=True, slots=True)
class InputList:
    """Inputs that follow each other, read by one of the MEI types 0x82, 0x84, 0x92 and 0x94."""

    mei: int
    address: int
    count: int

    @property
    def table(self) -> str:
        return "discrete_inputs" if self.mei in stamped_pdu.DISCRETE else "input_registers"


DEFAULT_LISTS: Final = (InputList(0x82, 196, 22), InputList(0x94, 8, 2))


@dataclass(slots=True)
class _State:
    value: int
    stamp: bytes


class SimulatedStampedInputs:
    """A device with its inputs, driven by `step` and asked by `answer`.

    Args:
        unit: Address, 0-255.
        seed: Equal seeds give equal changes, however the time is cut into steps.
        truth: Gets a CSV header now, a row for the state of each input at the start, and one for
            each change, flushed. Both times are UTC: of the simulation and of the device's clock.
        lists: The inputs.
        rate: Changes per second on average, of all inputs together; 0 for none.
        started_at_ns: UTC at the start; the host's when not given.
        clock_offset_s: Seconds that the device's clock is ahead at the start.
        clock_drift_ppm: What it gains from then on, in millionths.
        quirks: What the device does otherwise.

    Raises:
        ValueError: An argument is none of the above, or an input is in two lists.
    """

    def __init__(
        self,
        unit: int = 1,
        *,
        seed: int,
        truth: TextIO | None = None,
        lists: Iterable[InputList] = DEFAULT_LISTS,
        rate: float = 1.0,
        started_at_ns: int | None = None,
        clock_offset_s: float = 0.0,
        clock_drift_ppm: float = 0.0,
        quirks: Collection[Quirk] = (),
    ) -> None:
        if unit not in range(256):
            raise ValueError(f"unit {unit} is not in 0-255")
        if not 0 <= rate < PPM:
            raise ValueError(f"{rate} changes per second are not between 0 and a million")
        self._unit = unit
        self._truth = truth
        self._rate = rate
        self._started_at_ns = time.time_ns() if started_at_ns is None else started_at_ns
        self._offset_ns = round(clock_offset_s * NS_PER_S)
        self._drift_ppm = clock_drift_ppm
        self._quirks = frozenset(quirks)
        self._random = Random(f"mei-timestamped {seed} {unit}")
        self._elapsed_ns = 0
        self._states: dict[tuple[int, int], _State] = {}
        if _moment(self._device_time(-HOUR_S * NS_PER_S)).year not in YEARS:
            raise ValueError(f"a clock {clock_offset_s} s ahead is not in {YEARS[0]}-{YEARS[-1]}")
        self._write_truth(*TRUTH_COLUMNS)
        self._set_up(tuple(lists))
        if not self._states:
            raise ValueError("a device without inputs")
        self._resting = list(self._states)
        self._random.shuffle(self._resting)
        self._next_ns = self._interval()

    @property
    def unit(self) -> int:
        return self._unit

    def step(self, seconds: float) -> None:
        """Let time pass.

        Raises:
            ValueError: `seconds` is negative.
        """
        if seconds < 0:
            raise ValueError(f"time cannot run backwards: {seconds} s")
        self._elapsed_ns += round(seconds * NS_PER_S)
        while self._rate and self._next_ns <= self._elapsed_ns:
            self._change(self._next_ns)
            self._next_ns += self._interval()

    def answer(self, pdu: bytes) -> bytes:
        """Answer a request PDU."""
        if pdu[0] != stamped_pdu.FUNCTION:
            return bytes((pdu[0] | 0x80, stamped_pdu.ILLEGAL_FUNCTION))
        try:
            return self._read(stamped_pdu.parse_request(pdu))
        except stamped_pdu.Refused as refused:
            with_mei = len(pdu) > 1 and Quirk.SHORT_EXCEPTIONS not in self._quirks
            mei = pdu[1] if with_mei else 0
            return stamped_pdu.exception_answer(mei, refused.code, with_mei=with_mei)

    def _read(self, request: StampedRequest) -> bytes:
        if not any(mei == request.mei for mei, _ in self._states):
            raise stamped_pdu.Refused(stamped_pdu.ILLEGAL_FUNCTION)
        inputs: list[Input] = []
        for address in range(request.address, request.address + request.count):
            state = self._states.get((request.mei, address))
            if state is None:
                raise stamped_pdu.Refused(stamped_pdu.ILLEGAL_ADDRESS)
            inputs.append((state.value, state.stamp))
        if request.mei in stamped_pdu.REGISTERS:
            grouped = Quirk.GROUPED in self._quirks
            return stamped_pdu.register_answer(request.mei, inputs, grouped=grouped)
        answer = stamped_pdu.discrete_answer(request.mei, inputs)
        return stamped_pdu.as_printed(answer) if Quirk.MISPRINTED in self._quirks else answer

    def _set_up(self, lists: tuple[InputList, ...]) -> None:
        known: set[tuple[str, int]] = set()
        for one in lists:
            if one.mei not in stamped_pdu.DISCRETE | stamped_pdu.REGISTERS:
                raise ValueError(f"MEI type 0x{one.mei:02X} is not 0x82, 0x84, 0x92 or 0x94")
            if one.count < 1 or one.address < 0 or one.address + one.count > 0x10000:
                raise ValueError(f"{one.count} inputs from {one.address} on are not in 0-65535")
            for address in range(one.address, one.address + one.count):
                if (one.table, address) in known:
                    raise ValueError(f"{one.table} {address} is in two lists")
                known.add((one.table, address))
                is_discrete = one.mei in stamped_pdu.DISCRETE
                draw = self._random.randrange(2 if is_discrete else SPAN)
                value = draw if is_discrete else LOWEST + draw
                past_ns = self._random.randrange(HOUR_S * NS_PER_S)
                self._set(one.mei, address, value, -past_ns)

    def _interval(self) -> int:
        return round(self._random.expovariate(self._rate) * NS_PER_S) if self._rate else 0

    def _change(self, at_ns: int) -> None:
        awake = (len(self._resting) + 1) // 2
        place = self._random.randrange(awake)
        mei, address = key = self._resting.pop(place)
        self._resting.append(key)
        value = self._states[key].value
        if mei in stamped_pdu.DISCRETE:
            value ^= 1
        else:
            value = LOWEST + (value - LOWEST + self._random.randrange(1, SPAN)) % SPAN
        self._set(mei, address, value, at_ns)

    def _set(self, mei: int, address: int, value: int, at_ns: int) -> None:
        """Give an input its state; `at_ns` from the start."""
        device_time = self._device_time(at_ns)
        is_invalid = Quirk.INVALID_TIME in self._quirks
        octets = _stamp(device_time, stamped_pdu.stamp_size(mei), is_invalid=is_invalid)
        self._states[mei, address] = _State(value, octets)
        self._write_truth(
            _text(self._started_at_ns + at_ns),
            _text(device_time),
            InputList(mei, address, 1).table,
            str(address),
            str(value),
            octets.hex(),
        )

    def _device_time(self, at_ns: int) -> int:
        gained_ns = round(at_ns * self._drift_ppm / PPM)
        return self._started_at_ns + self._offset_ns + at_ns + gained_ns

    def _write_truth(self, *cells: str) -> None:
        if self._truth is not None:
            self._truth.write(",".join(cells) + "\n")
            self._truth.flush()


def _moment(utc_ns: int) -> datetime:
    """The second of an instant; ValueError or OverflowError outside the calendar."""
    return datetime.fromtimestamp(utc_ns // NS_PER_S, UTC)


def _text(utc_ns: int) -> str:
    """ISO 8601 to the millisecond."""
    return f"{_moment(utc_ns):%Y-%m-%dT%H:%M:%S}.{utc_ns // NS_PER_MS % 1000:03d}Z"


def _stamp(utc_ns: int, size: int, *, is_invalid: bool) -> bytes:
    """The 7 octets of the paper's table, or the first 4; finer than a millisecond is cut off."""
    moment = _moment(utc_ns)
    milliseconds = 1000 * moment.second + utc_ns // NS_PER_MS % 1000
    minute = moment.minute | (INVALID if is_invalid else 0)
    date = (moment.day, moment.month, moment.year % 100)
    return (milliseconds.to_bytes(2, "little") + bytes((minute, moment.hour, *date)))[:size]

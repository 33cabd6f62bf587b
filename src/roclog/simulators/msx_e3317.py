"""The MSX-E3317 pressure module, simulated from its interface description.

Only functions that the description spells out exist; the numbers it merely lists are answered with
exception 2, a wrong word count with exception 3, functions 16 and 23 with exception 1. Where the
description is silent, this simulator decides:

- Channels are of type 1 and sit four to a position.
- A calibration goes through the channels, a minute for each, in five steps of reference; the
  digital value is the reference as 24 bits of 10 bar, with noise. Its status is 1 while it settles.
- The status of the last call is always "done": nothing fails.
"""

from __future__ import annotations

import struct
import time
from random import Random
from typing import TYPE_CHECKING, Any, Final, Literal, TextIO

from roclog.simulators.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

ByteOrder = Literal["big", "little"]

READ_REGISTERS: Final = 3
ILLEGAL_FUNCTION: Final = 1
ILLEGAL_DATA_ADDRESS: Final = 2
ILLEGAL_DATA_VALUE: Final = 3

FIRST_WITH_SHORT_COUNT: Final = 1000
"""Answers of the registers below count their octets with 16 bits."""

PLACES: Final = 16
PER_POSITION: Final = 4
CHANNEL_S: Final = 60
STEPS_BAR: Final = (0.0, 2.5, 5.0, 7.5, 10.0)
SETTLING_S: Final = 2
FULL_SCALE: Final = 2**24 - 1
NS_PER_S: Final = 1_000_000_000


class SimulatedMsxE3317:
    """A module with its clock and a calibration, driven by `step` and asked by `answer`.

    Args:
        unit: 0 or 1.
        seed: Equal seeds give equal values at equal times.
        byte_order: Of all numbers in a PDU; text is not swapped. The endpoint does the same with
            the MBAP header.
        channels: Pressure channels, at most 16.
        started_at_ns: The module's clock at the start, UTC; the host's when not given.
        truth: Gets what the answers tell, as of Truth; not of functions with text.

    Raises:
        ValueError: An argument is none of the above.
    """

    def __init__(
        self,
        unit: int = 1,
        *,
        seed: int,
        byte_order: ByteOrder = "big",
        channels: int = 8,
        started_at_ns: int | None = None,
        truth: TextIO | None = None,
    ) -> None:
        if unit not in (0, 1):
            raise ValueError(f"unit {unit} is neither 0 nor 1")
        if byte_order not in ("big", "little"):
            raise ValueError(f"byte order {byte_order!r} is neither big nor little")
        if not 1 <= channels <= PLACES:
            raise ValueError(f"{channels} is not 1 to {PLACES} channels")
        self._unit = unit
        self._seed = seed
        self._mark = ">" if byte_order == "big" else "<"
        self._channels = channels
        self._now_ns = time.time_ns() if started_at_ns is None else started_at_ns
        self._elapsed_ns = 0
        self._truth = Truth(truth)
        number = {"channels": channels}
        functions: dict[tuple[int, ...], tuple[int, Callable[[], bytes]]] = {
            (0, 10000): (54, lambda: bytes(108)),
            (1, 10200): (100, lambda: b"MSX-E3317".ljust(200, b"\0")),
            (2, 10500): (4, self._time),
            (3, 10550): (16, self._customer),
            (21000,): (2, lambda: self._numbers("pressure_channels", "I", number)),
            (21150,): (8, self._calibration),
            (15000,): (2, lambda: self._numbers("acquisition_channels", "I", number)),
            (15050,): (96, self._channels_info),
        }
        self._functions = {register: each for keys, each in functions.items() for register in keys}

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
        passed_ns = round(seconds * NS_PER_S)
        self._now_ns += passed_ns
        self._elapsed_ns += passed_ns

    def answer(self, pdu: bytes) -> bytes:
        """Answer a request PDU in the module's byte order."""
        function = pdu[0]
        if function != READ_REGISTERS:
            return bytes((function | 0x80, ILLEGAL_FUNCTION))
        if len(pdu) != 5:
            return bytes((function | 0x80, ILLEGAL_DATA_VALUE))
        register, words = struct.unpack(f"{self._mark}HH", pdu[1:])
        if register not in self._functions:
            return bytes((function | 0x80, ILLEGAL_DATA_ADDRESS))
        expected, call = self._functions[register]
        if words != expected:
            return bytes((function | 0x80, ILLEGAL_DATA_VALUE))
        payload = call()
        count = "B" if register >= FIRST_WITH_SHORT_COUNT else "H"
        return bytes((function,)) + self._pack(count, len(payload)) + payload

    def _pack(self, layout: str, *values: Any) -> bytes:
        return struct.pack(self._mark + layout, *values)

    def _numbers(self, block: str, layout: str, values: Mapping[str, float]) -> bytes:
        self._truth.tell((block, name, repr(value)) for name, value in values.items())
        return self._pack(layout, *values.values())

    def _time(self) -> bytes:
        seconds, nanoseconds = divmod(self._now_ns, NS_PER_S)
        told = {"seconds": seconds, "microseconds": nanoseconds // 1000}
        return self._numbers("clock", "II", told)

    def _customer(self) -> bytes:
        return Random(f"msx-e3317 customer {self._seed}").randbytes(32)

    def _calibration(self) -> bytes:
        elapsed_s = self._elapsed_ns / NS_PER_S
        channel, in_channel_s = divmod(elapsed_s, CHANNEL_S)
        step, in_step_s = divmod(in_channel_s, CHANNEL_S / len(STEPS_BAR))
        reference_bar = STEPS_BAR[int(step)]
        noise = Random(f"msx-e3317 noise {self._seed} {self._elapsed_ns}").gauss(0, 20)
        digital = round(reference_bar / STEPS_BAR[-1] * FULL_SCALE + noise)
        told = {
            "status": int(in_step_s < SETTLING_S),
            "channel": int(channel) % self._channels,
            "reference": reference_bar,
            "digital_value": min(max(digital, 0), FULL_SCALE),
        }
        return self._numbers("calibration_status", "IIfI", told)

    def _channels_info(self) -> bytes:
        empty = [0] * (PLACES - self._channels)
        columns: dict[str, Callable[[int], int]] = {
            "type": lambda _: 1,
            "hardware_position": lambda place: place // PER_POSITION,
            "channel_index": lambda place: place % PER_POSITION,
        }
        told = {
            f"{name}_{place + 1}": number
            for name, tell in columns.items()
            for place, number in enumerate([*map(tell, range(self._channels)), *empty])
        }
        return self._numbers("channels_info", f"{len(told)}I", told)

"""Relays and sensors of an MPA-48, and its answers to functions 1 and 4.

Written from the manual's Appendix A (framing), its pages 23 (relays) and 25 (channels of three
registers, their scaling by sensor model), and common Modbus rules for what it leaves open.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING

from roc_options import rng
from wire import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE, PduError, octets_of

if TYPE_CHECKING:
    from random import Random

    from mpa_options import Options
    from roc_truth import Truth

READ_RELAYS, READ_INPUTS = 1, 4
MOST = {READ_RELAYS: 2000, READ_INPUTS: 125}
RELAYS = 8
STATUSES = (1, 2, 3)
"""Not responding; sensor error; 3 differs by model."""
KEPT = 0.75
"""Share of the changes at which a sensor keeps its status."""
EXTREME = 0.25


@dataclass(frozen=True)
class Quantity:
    """A register holds value / step + bias, below zero as two's complement.

    lowest, highest: values that are drawn; extremes come often.
    """

    name: str
    step: Decimal
    lowest: Decimal
    highest: Decimal
    bias: int = 0

    def draw(self, random: Random) -> Decimal:
        if random.random() < EXTREME:
            return random.choice((self.lowest, self.highest))
        steps = int((self.highest - self.lowest) / self.step)
        return self.lowest + random.randint(0, steps) * self.step

    def register(self, value: Decimal) -> int:
        return (int(value / self.step) + self.bias) % 0x10000


def _quantity(name: str, step: str, lowest: str, highest: str, bias: int = 0) -> Quantity:
    return Quantity(name, Decimal(step), Decimal(lowest), Decimal(highest), bias)


TEMPERATURE = _quantity("temperature", "0.1", "-20.0", "60.0")
SENSORS = {
    "10": (_quantity("dissolved_oxygen", "0.01", "0.00", "655.35"), TEMPERATURE),
    "15": (_quantity("suspended_solids", "1", "0", "65535"), None),
    "51": (_quantity("ph", "0.01", "0.00", "14.00"), TEMPERATURE),
    "52": (_quantity("orp", "1", "-2000", "2000", bias=2000), None),
}
"""Primary and secondary quantity; of some the secondary is undefined."""


class Channel:
    """A sensor; while its status is not 0 measurements are any number, undefined ones always.

    told: what the registers say, by quantity.
    """

    def __init__(self, model: str, random: Random, trouble: float) -> None:
        self.model = model
        self._random = random
        self._trouble = trouble
        self.status = 0
        self.registers = [0, 0, 0]
        self.told: dict[str, str] = {}
        self.change()

    def change(self) -> None:
        random = self._random
        status = self.status
        if random.random() >= KEPT:
            is_well = random.random() >= self._trouble
            status = 0 if is_well else random.choice(STATUSES)
        quantities = (quantity for quantity in SENSORS[self.model] if quantity is not None)
        self.measure(status, [quantity.draw(random) for quantity in quantities])

    def measure(self, status: int, values: list[Decimal]) -> None:
        """values: of what the model measures."""
        self.status = status
        self.registers = [status, *(self._random.randrange(0x10000) for _ in range(2))]
        self.told = {}
        for place, value in enumerate([] if status else values, start=1):
            quantity = SENSORS[self.model][place - 1]
            assert quantity is not None, self.model
            self.registers[place] = quantity.register(value)
            self.told[quantity.name] = str(value)


@dataclass(frozen=True)
class Reply:
    """facts: of the truth log, None where the log has it already."""

    pdu: bytes | None
    facts: dict[str, object] | None = None


class Model:
    """unit, execute and settled are what a link wants of a device.

    The truth log has an `answer` for each request that was answered, with what it told: `relays`
    from the first address on, or `channels` by the register of their status, and an `exception` for
    each that was refused. at_ns: when the values were taken.
    """

    def __init__(self, options: Options, truth: Truth) -> None:
        self.unit = options.unit
        self._truth = truth
        self._random = rng(options.seed, "relays")
        self._failures = options.failures
        self.relays = [False] * RELAYS
        self.channels = {
            register: Channel(model, rng(options.seed, f"channel {register}"), options.trouble)
            for register, model in options.sensors.items()
        }

    def power_up(self) -> None:
        self.change()

    def change(self) -> None:
        self.relays = [self._random.random() < 0.5 for _ in range(RELAYS)]
        for channel in self.channels.values():
            channel.change()

    def execute(self, pdu: bytes, fate: str, origin: dict[str, object]) -> Reply:
        """`fate` is what the link will do to the answer; `origin` goes into the truth log."""
        facts = {"function": pdu[0], "request": pdu.hex(), "at_ns": time.time_ns(), **origin}
        try:
            data, told = self._read(pdu)
        except PduError as error:
            self._truth.log("exception", code=error.code, fate=fate, **facts)
            return Reply(bytes([pdu[0] | 0x80, error.code]))
        if fate == "short":
            data = data[: len(data) // 2]
        return Reply(bytes([pdu[0], len(data)]) + data, {**facts, "data": data.hex(), **told})

    def settled(self, reply: Reply, fate: str, **extra: object) -> None:
        """The answer has gone its way: `fate` is what became of it in the end."""
        if reply.facts is not None:
            self._truth.log("answer", fate=fate, **reply.facts, **extra)

    def _read(self, pdu: bytes) -> tuple[bytes, dict[str, object]]:
        """The data of the answer, and what they tell."""
        function = pdu[0]
        if function not in MOST:
            raise PduError(ILLEGAL_FUNCTION)
        if len(pdu) != 5:
            raise PduError(ILLEGAL_VALUE)
        address, count = int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big")
        if not 1 <= count <= MOST[function]:
            raise PduError(ILLEGAL_VALUE)
        span = range(address, address + count)
        if function == READ_RELAYS:
            if span.stop > RELAYS:
                raise PduError(ILLEGAL_ADDRESS)
            self._fail(function, span)
            states = self.relays[address : span.stop]
            bits = sum(is_on << bit for bit, is_on in enumerate(states))
            return bytes([bits]), {"relays": states}
        words = {
            register + place: word
            for register, channel in self.channels.items()
            for place, word in enumerate(channel.registers)
        }
        if not all(at in words for at in span):
            raise PduError(ILLEGAL_ADDRESS)
        self._fail(function, span)
        told = {
            str(register): {"model": c.model, "status": c.status, "told": c.told}
            for register, c in self.channels.items()
            if register in span and register + 2 in span
        }
        return octets_of([words[at] for at in span]), {"channels": told}

    def _fail(self, function: int, span: range) -> None:
        for failure in self._failures:
            if failure.function == function and failure.address in span:
                if failure.left == 1:
                    self._failures.remove(failure)
                failure.left = max(0, failure.left - 1)
                raise PduError(failure.code)

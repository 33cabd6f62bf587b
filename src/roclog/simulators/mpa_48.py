"""The Insite IG MPA-48 analyser, simulated from its manual.

Source: Appendix A "Modbus Protocol" of the manual, with its pages 23 (relays) and 25 (channels).
Where it is silent, this simulator decides:

- Coils 0-7 and the three registers of each channel are all there is: everything else is answered
  with exception 2, a count that no answer holds with exception 3, functions other than 1 and 4 with
  exception 1.
- Channel 1 is at register 0, as in the sibling Model 2000CE. Channels beyond 2 are where they are
  told to be.
- Everything is measured anew once a second. A temperature below zero is in two's complement.
- Relay 1 switches the blower of the basin, relay 2 its sludge pump, relay 3 is on while a sensor
  has a status other than 0; the rest are off.
- A sensor has such a status for up to a minute, about every ten minutes; its measurements stand
  still meanwhile. An undefined register holds some word that never changes.
"""

from __future__ import annotations

import re
from random import Random
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TextIO

from roclog.simulators.basin import Basin
from roclog.simulators.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Tell = Callable[[Basin], tuple[int, str]]
    Told = tuple[str, str, str]

READ_COILS: Final = 1
READ_INPUT_REGISTERS: Final = 4
ILLEGAL_FUNCTION: Final = 1
ILLEGAL_DATA_ADDRESS: Final = 2
ILLEGAL_DATA_VALUE: Final = 3
MOST: Final = {READ_COILS: 2000, READ_INPUT_REGISTERS: 125}
"""Application Protocol V1.1b3, sections 6.1 and 6.4."""

RELAYS: Final = 8
CHANNEL_WORDS: Final = 3
CHANNEL: Final = re.compile(r"channel_[1-9][0-9]?")
KNOWN_ADDRESSES: Final = MappingProxyType({"channel_1": 0, "channel_2": 3})
DEFAULT_SENSORS: Final = MappingProxyType({"channel_1": "model-15", "channel_2": "model-10"})
ORP_BIAS_MV: Final = 2_000

STATUSES: Final = (1, 2, 3)
TROUBLE_EVERY_S: Final = 600
TROUBLE_S: Final = (20, 60)

NS_PER_S: Final = 1_000_000_000


def _hundredths(value: float) -> tuple[int, str]:
    """The register, and the value that it says."""
    number = max(0, round(100 * value))
    return number, f"{number / 100:.2f}"


def _tenths(value: float) -> tuple[int, str]:
    number = round(10 * value)
    return number % 0x10000, f"{number / 10:.1f}"


def _whole(value: float) -> tuple[int, str]:
    number = max(0, round(value))
    return number, str(number)


def _biased(value: float) -> tuple[int, str]:
    number = max(0, round(value) + ORP_BIAS_MV)
    return number, str(number - ORP_BIAS_MV)


MODELS: Final[Mapping[str, tuple[tuple[str, Tell], ...]]] = MappingProxyType(
    {
        "model-10": (
            ("dissolved_oxygen", lambda basin: _hundredths(basin.oxygen_ppm)),
            ("temperature", lambda basin: _tenths(basin.temperature_cel)),
        ),
        "model-15": (("suspended_solids", lambda basin: _whole(basin.solids_mg_l)),),
        "model-51": (
            ("ph", lambda basin: _hundredths(basin.ph)),
            ("temperature", lambda basin: _tenths(basin.temperature_cel)),
        ),
        "model-52": (("orp", lambda basin: _biased(basin.orp_mv)),),
    }
)
"""Name and register of each quantity that a model measures."""


class _Channel:
    """A sensor and its three registers; `told`: what they say, by name, empty = no measurement."""

    def __init__(self, name: str, model: str, address: int, random: Random) -> None:
        self.name = name
        self.address = address
        self._quantities = MODELS[model]
        self._random = random
        undefined = random.randrange(1, 0x10000)
        self.words = [0, undefined, undefined]
        self.told: list[tuple[str, str]] = []
        self._left_s = 0

    @property
    def has_trouble(self) -> bool:
        return self.words[0] != 0

    def measure(self, basin: Basin) -> None:
        """Once a second."""
        self._left_s = max(0, self._left_s - 1)
        if self._left_s == 0:
            self.words[0] = 0
            if self._random.random() < 1 / TROUBLE_EVERY_S:
                self.words[0] = self._random.choice(STATUSES)
                self._left_s = self._random.randint(*TROUBLE_S)
        self.told = [("status", str(self.words[0]))]
        for place, (name, tell) in enumerate(self._quantities, start=1):
            text = ""
            if not self.has_trouble:
                self.words[place], text = tell(basin)
            self.told.append((name, text))


class SimulatedMpa48:
    """An analyser at a basin, driven by `step` and asked by `answer`.

    Args:
        unit: Address, 1-247.
        seed: Equal seeds and units give equal measurements, however the time is cut into steps.
        truth: Gets what the answers tell, as of Truth.
        sensors: Model by channel.
        addresses: Register of the status by channel, for those beyond channel 2 at least.

    Raises:
        ValueError: An argument is none of the above, or two channels share a register.
    """

    def __init__(
        self,
        unit: int = 1,
        *,
        seed: int,
        truth: TextIO | None = None,
        sensors: Mapping[str, str] = DEFAULT_SENSORS,
        addresses: Mapping[str, int] | None = None,
    ) -> None:
        if not 1 <= unit <= 247:
            raise ValueError(f"unit {unit} is not in 1-247")
        self._unit = unit
        self._truth = Truth(truth)
        self._elapsed_ns = 0
        self._basin = Basin(Random(f"mpa-48 {seed} {unit}"))
        self._channels = [
            _Channel(name, model, address, Random(f"mpa-48 {seed} {unit} {name}"))
            for name, model, address in _placed(sensors, addresses or {})
        ]
        self._words: dict[int, tuple[_Channel, int]] = {}
        for channel in self._channels:
            for place in range(CHANNEL_WORDS):
                if self._words.setdefault(channel.address + place, (channel, place))[0] != channel:
                    raise ValueError(f"register {channel.address + place} is in two channels")
        self._relays = [False] * RELAYS
        self._measure()

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
        while self._elapsed_ns >= NS_PER_S:
            self._elapsed_ns -= NS_PER_S
            self._measure()

    def answer(self, pdu: bytes) -> bytes:
        """Answer a request PDU."""
        function = pdu[0]
        if function not in MOST:
            return bytes((function | 0x80, ILLEGAL_FUNCTION))
        address, count = int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big")
        if len(pdu) != 5 or not 1 <= count <= MOST[function]:
            return bytes((function | 0x80, ILLEGAL_DATA_VALUE))
        span = range(address, address + count)
        known = range(RELAYS) if function == READ_COILS else self._words
        if not all(each in known for each in span):
            return bytes((function | 0x80, ILLEGAL_DATA_ADDRESS))
        data, told = self._coils(span) if function == READ_COILS else self._registers(span)
        self._truth.tell(told)
        return bytes((function, len(data))) + data

    def _coils(self, span: range) -> tuple[bytes, list[Told]]:
        told = [("relays", f"relay_{each + 1}", str(int(self._relays[each]))) for each in span]
        return bytes((sum(self._relays[each] << bit for bit, each in enumerate(span)),)), told

    def _registers(self, span: range) -> tuple[bytes, list[Told]]:
        data = bytearray()
        told = []
        for each in span:
            channel, place = self._words[each]
            if place < len(channel.told):
                told.append((channel.name, *channel.told[place]))
            data += channel.words[place].to_bytes(2, "big")
        return bytes(data), told

    def _measure(self) -> None:
        self._basin.live_one_second()
        for channel in self._channels:
            channel.measure(self._basin)
        has_trouble = any(channel.has_trouble for channel in self._channels)
        self._relays[:3] = [self._basin.is_blown, self._basin.is_pumped, has_trouble]


def _placed(sensors: Mapping[str, str], addresses: Mapping[str, int]) -> list[tuple[str, str, int]]:
    """Channel, model and register of the status."""
    if not sensors:
        raise ValueError("an analyser without sensors")
    places = {**KNOWN_ADDRESSES, **addresses}
    for name, model in sensors.items():
        if not CHANNEL.fullmatch(name):
            raise ValueError(f"{name!r} is not channel_1 to channel_99")
        if model not in MODELS:
            raise ValueError(f"{model!r} is not one of {', '.join(MODELS)}")
        if name not in places:
            raise ValueError(f"the address of {name} is not known and must be given")
        if not 0 <= places[name] <= 0x10000 - CHANNEL_WORDS:
            raise ValueError(f"{name} at {places[name]} is not in 0-65535")
    for name in addresses.keys() - sensors.keys():
        raise ValueError(f"{name} has an address, but no sensor")
    return [(name, model, places[name]) for name, model in sensors.items()]

"""What the ROC's register document says of registers 300-326, read anew for these tests."""

from __future__ import annotations

from decimal import Decimal
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

Values = dict[str, Decimal]

_FIRST: Final = 300
_ALARMS: Final = (
    "laser_current_low",
    "laser_current_high",
    "photo_diode_power_low",
    "photo_diode_power_high",
    "temperature_low",
    "temperature_high",
    "concentration_low",
    "concentration_high",
    "channel_1_alarm",
    "channel_2_alarm",
    "channel_3_alarm",
    "channel_4_alarm",
)
_CLASSES: Final = {
    "nas_class_2_3": 320,
    "nas_class_3_4": 321,
    "sae_class_1": 322,
    "sae_class_2": 323,
    "sae_class_3": 324,
    "sae_class_4": 325,
}
LIVE: Final = frozenset({"temperature", "alarms", *_ALARMS})
"""Columns that may move while the sample stays."""


def decode(registers: Sequence[int]) -> Values:
    """Every column of a sample; truth values are 0 and 1."""

    def word(address: int) -> int:
        return registers[address - _FIRST]

    def signed(address: int) -> int:
        return word(address) - 0x10000 if word(address) & 0x8000 else word(address)

    def double(address: int) -> int:
        return word(address) << 16 | word(address + 1)

    values: Values = {}
    for size in (1, 2, 3, 4):
        values[f"count_{size}"] = Decimal(double(306 + 2 * size)).scaleb(-2)
        values[f"iso_code_{size}"] = Decimal(word(315 + size)).scaleb(-1)
    for name, address in _CLASSES.items():
        values[name] = Decimal(signed(address))
    values["temperature"] = Decimal(signed(326)).scaleb(-1)
    minutes, seconds = divmod(word(305), 0x100)
    values["sample_period"] = Decimal(60 * minutes + seconds)
    alarms = double(306)
    values["alarms"] = Decimal(alarms)
    for bit, name in enumerate(_ALARMS):
        values[name] = Decimal(alarms >> bit & 1)
    return values


def identity(values: Mapping[str, Decimal]) -> tuple[Decimal, ...]:
    """What tells one sample from another."""
    return tuple(value for name, value in values.items() if name not in LIVE)

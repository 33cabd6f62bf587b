"""Insite IG MPA-48 analyser: relays, and a sensor on each channel.

Source: MPA-48 manual, Appendix A "Modbus Protocol", with page 23 (relays, function 1) and page 25
(sensors, function 4: the example reads channel 2 at input registers 3 to 5). The model of a sensor
cannot be read from the device, so that it must be told. What the manual leaves open:

- Channel 1 at registers 0 to 2 is stated for the sibling Model 2000CE only, and taken from there.
- Further channels: no address is known, and the sibling has other things behind register 5. Their
  address must be given.
- Status 3 of Model 10 is from the sibling's manual.
- Baud rate and unit as delivered are not stated: 9600 baud, unit 1.
- Temperature below zero is not described: taken as a signed number.
"""

from __future__ import annotations

import re
from decimal import Decimal
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from roclog.errors import RegisterMapError
from roclog.register_map import (
    Block,
    Point,
    RegisterMap,
    SerialDefaults,
    Table,
    ValidWhen,
    WordType,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

CHANNELS: Final[Mapping[str, int]] = MappingProxyType({"channel_1": 0, "channel_2": 3})
"""Input register of the status, by channel, where it is known."""
_CHANNEL: Final = re.compile(r"channel_[1-9][0-9]?")
_RELAYS: Final = 8
_REGISTERS: Final = 3
"""Of a channel: the status and two measurements."""
_HUNDREDTH: Final = Decimal("0.01")
_TENTH: Final = Decimal("0.1")
_VALID: Final = ValidWhen(point="status", values=(0,))
_ERRORS: Final = ((0, "normal"), (1, "sensor not responding"), (2, "sensor error"))


class Sensor(NamedTuple):
    """What a model measures; the second register of some is undefined and has no point."""

    title: str
    status_3: str
    points: tuple[Point, ...]


def _measured(name: str, unit: str, title: str, **more: Any) -> Point:
    given = {"offset": 1, "type": WordType.U16, **more}
    return Point(name=name, unit=unit, title=title, valid_when=_VALID, **given)


_TEMPERATURE: Final = _measured(
    "temperature", "Cel", "Temperature of the sensor", offset=2, type=WordType.S16, scale=_TENTH
)
_OXYGEN: Final = _measured("dissolved_oxygen", "[ppm]", "Dissolved oxygen", scale=_HUNDREDTH)
_SOLIDS: Final = _measured("suspended_solids", "mg/L", "Suspended solids")
_PH: Final = _measured("ph", "[pH]", "pH", scale=_HUNDREDTH)
_ORP: Final = _measured(
    "orp", "mV", "Redox potential; the register is 2000 mV higher", add=Decimal(-2000)
)
SENSORS: Final[Mapping[str, Sensor]] = MappingProxyType(
    {
        "model-10": Sensor(
            "optical dissolved oxygen", "new sensor codes needed", (_OXYGEN, _TEMPERATURE)
        ),
        "model-15": Sensor("suspended solids", "needs zero calibration", (_SOLIDS,)),
        "model-51": Sensor("pH", "sensor error", (_PH, _TEMPERATURE)),
        "model-52": Sensor("oxidation-reduction potential", "sensor error", (_ORP,)),
    }
)
"""By model."""
_SAME_AS: Final[Mapping[str, str]] = MappingProxyType({"model-15L": "model-15"})
"""Model 15L measures as Model 15 does."""

RELAYS: Final = Block(
    name="relays",
    table=Table.COILS,
    address=0,
    count=_RELAYS,
    title="Relay states, coils 0-7",
    points=tuple(
        Point(name=f"relay_{n + 1}", offset=n, type=WordType.BIT, title=f"Relay {n + 1} is on")
        for n in range(_RELAYS)
    ),
)


def mpa_48(sensors: Mapping[str, str], addresses: Mapping[str, int] | None = None) -> RegisterMap:
    """The map of an analyser with these sensors.

    Args:
        sensors: model by channel, like ``{"channel_1": "model-15", "channel_2": "model-10"}``.
        addresses: input register of the status, by channel: needed where it is not known.

    Raises:
        RegisterMapError: with all problems: no sensor, no such model, no address.
    """
    given = addresses or {}
    places = {**CHANNELS, **given}
    problems = [
        f"{channel or table}: {text}" for table, channel, text in find_problems(sensors, given)
    ]
    if problems:
        raise RegisterMapError("mpa-48", problems)
    return _register_map(_channel(name, sensors[name], places[name]) for name in sensors)


def _register_map(channels: Iterable[Block], notes: tuple[str, ...] = ()) -> RegisterMap:
    return RegisterMap(
        name="mpa-48",
        title="Insite IG MPA-48 analyser",
        source="Insite IG MPA-48 manual, Appendix A, pages 23 and 25",
        unit=1,
        serial=SerialDefaults(baudrate=9600, is_documented=False),
        answer_limit=1_000_000_000,
        samples=(RELAYS, *channels),
        notes=notes,
    )


def find_problems(
    sensors: Mapping[str, str], addresses: Mapping[str, int]
) -> Iterator[tuple[str, str, str]]:
    """(sensors or addresses, channel, what is wrong); the channel is empty where there is none."""
    if not sensors:
        yield "sensors", "", 'none; give the model on each channel, like channel_1 = "model-15"'
    for name, model in sensors.items():
        if not _CHANNEL.fullmatch(name):
            yield "sensors", name, "is not a channel: channel_1 to channel_99"
        elif name not in CHANNELS and name not in addresses:
            text = (
                f"its address is not documented and must be given: addresses = {{ {name} = ... }}"
            )
            yield "sensors", name, text
        if model not in SENSORS and model not in _SAME_AS:
            models = ", ".join([*SENSORS, *_SAME_AS])
            yield "sensors", name, f"{model!r} is not one of {models}"
    for name, address in addresses.items():
        if name not in sensors:
            yield "addresses", name, "has an address, but no sensor"
        if not 0 <= address <= 65533:
            yield "addresses", name, f"registers {address} to {address + 2} do not exist"
    yield from _find_overlaps(sensors, addresses)


def _find_overlaps(
    sensors: Mapping[str, str], addresses: Mapping[str, int]
) -> Iterator[tuple[str, str, str]]:
    places = {**CHANNELS, **addresses}
    there = [name for name in sensors if name in places]
    for pair in combinations(there, 2):
        one, other = sorted(pair, key=lambda name: name in addresses)
        if abs(places[one] - places[other]) < _REGISTERS:
            table = "addresses." if one in addresses else ""
            text = (
                f"registers {_span(places[other])} overlap those of {table}{one}, "
                f"{_span(places[one])}; each channel has {_REGISTERS} of its own"
            )
            yield "addresses", other, text


def _span(address: int) -> str:
    return f"{address} to {address + _REGISTERS - 1}"


def _channel(name: str, given: str, address: int) -> Block:
    """given: the model as the user calls it."""
    model = _SAME_AS.get(given, given)
    sensor = SENSORS[model]
    status = Point(
        name="status",
        offset=0,
        type=WordType.U16,
        low=Decimal(0),
        high=Decimal(3),
        meanings=(*_ERRORS, (3, sensor.status_3)),
        title="Status of the sensor; measurements count only where it is 0",
    )
    return Block(
        name=name,
        message=f"channel_{model.replace('-', '_')}",
        table=Table.INPUT_REGISTERS,
        address=address,
        count=_REGISTERS,
        title=f"{name.replace('_', ' ').capitalize()}: {given}, {sensor.title}",
        points=(status, *sensor.points),
    )


_NOTES: Final = """\
the configuration says which model is on which channel: sensors = { channel_1 = "model-15" }
each model is shown as on channel_1, at registers 0-2, stated only for the sibling Model 2000CE
on channel_2 each model is at registers 3-5
where other channels are is not documented and must be given: addresses = { channel_3 = ... }
the line is 8N1 as documented; baud rate and unit as delivered are not"""
OVERVIEW: Final = _register_map(
    (_channel("channel_1", model, CHANNELS["channel_1"]) for model in SENSORS),
    notes=tuple(_NOTES.splitlines()),
)
"""Every model, each as on channel 1."""

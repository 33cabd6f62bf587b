"""Any device that hands out inputs with time stamps over function 43.

Source: "A technique for implementation of Time Stamping of Data using the MODBUS Encapsulated
Interface Transport", MEI types 0x82, 0x84, 0x92 and 0x94. docs/time-stamped-inputs.md says how each
point that it leaves open is decided. Line settings and the time an answer may take are not given:
9600 Bd without parity and 500 ms stand for them until a configuration says otherwise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from roclog.register_map import RegisterMap, SerialDefaults, StampedInputs, StampRules

if TYPE_CHECKING:
    from collections.abc import Iterable

_LISTS: Final = (
    'the configuration says which inputs there are: points = [ { kind = "discrete_inputs", '
    "stamp = 7, address = 196, count = 22 } ]"
)


def register_map(lists: Iterable[StampedInputs], rules: StampRules) -> RegisterMap:
    """The map of a device with these lists of inputs."""
    return RegisterMap(
        name="mei-timestamped",
        title="Time-stamped inputs over function 43",
        source="A technique for implementation of Time Stamping of Data using the MODBUS "
        "Encapsulated Interface Transport",
        unit=1,
        serial=SerialDefaults(baudrate=9600, is_documented=False),
        answer_limit=500_000_000,
        samples=(),
        stamped=tuple(lists),
        stamp_rules=rules,
    )


OVERVIEW: Final = replace(register_map((), StampRules()), notes=(_LISTS,))
"""What is known before the inputs are."""

"""What people may have written to a device, as data of its register map. `record` never does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from decimal import Decimal

SAVE: Final = "save"
RESET: Final = "reset"
COMMANDS: Final = (SAVE, RESET)
"""Names of commands: what `roclog device` has a sub-command for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One of several ways in which a document lets positive numbers be read.

    factor: the value is the number times it. name: in words, like "in tenths".
    """

    name: str
    factor: Decimal


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """What may be written while another point of the block has the number ``when``.

    name: of that number, like "ISO". low, high: of the value, inclusive, in any of the readings.
    numbers: what else may be written, whatever the reading.
    """

    when: int
    name: str
    low: Decimal
    high: Decimal
    numbers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A point of one register that may be written.

    low, high: of the value, in its unit, inclusive; None = what the point gives, or its meanings.
    ranges: instead of those, where they depend on the point ``selector``. readings: how the numbers
    can be read, where the document is of two minds.
    remark: what the document says of it that people have to know.
    """

    point: str
    low: Decimal | None = None
    high: Decimal | None = None
    selector: str = ""
    ranges: tuple[Range, ...] = ()
    readings: tuple[Reading, ...] = ()
    remark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """Something that the device does once when a number is written to a register.

    name: one of COMMANDS. answers: False = the document says that no answer comes.
    """

    name: str
    address: int
    value: int
    answers: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Writable:
    """Settings and commands of a device.

    block: the facts block that has the settings, written one register at a time (function 6).
    unit: the setting that is the address the device answers to; empty = it has none.
    clock: the settings that hold year, month and day, hour, minute and second of its clock, UTC;
    empty = it has none.
    """

    block: str
    settings: tuple[Setting, ...]
    unit: str = ""
    clock: tuple[str, ...] = ()
    commands: tuple[Command, ...] = ()

    def setting(self, name: str) -> Setting | None:
        return next((setting for setting in self.settings if setting.point == name), None)

    def command(self, name: str) -> Command | None:
        return next((command for command in self.commands if command.name == name), None)

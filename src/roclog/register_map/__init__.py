"""The words a device is described in. A register map is data: everything else follows from it.

Addresses are PDU addresses, counted from 0 (Application Protocol V1.1b3, section 4.4). Offsets
count registers (words of 16 bits) from the address of their block, bits in a block of coils or
discrete inputs, octets in a packed block.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from roclog.modbus.dialect import STANDARD, Dialect
from roclog.modbus.request import Mei
from roclog.modbus.stamped import Layout
from roclog.register_map.kinds import Table, WordOrder, WordType
from roclog.register_map.times import (
    Cp32,
    Cp56,
    SecondsMicroseconds,
    SplitCalendar,
    TimeSource,
    UnixSeconds,
)
from roclog.register_map.triggers import Change, ClearOnRead, Counter, FlagAndClear, Trigger

if TYPE_CHECKING:
    from decimal import Decimal

    from roclog.register_map.writable import Writable

__all__ = [
    "MAX_BLOCK",
    "MAX_RANGED_POINTS",
    "MAX_READ_BITS",
    "MAX_READ_REGISTERS",
    "MODBUS_PORT",
    "PACKED_OCTETS",
    "Block",
    "Change",
    "ClearOnRead",
    "Counter",
    "Cp32",
    "Cp56",
    "FlagAndClear",
    "Point",
    "RegisterMap",
    "SecondsMicroseconds",
    "SerialDefaults",
    "SplitCalendar",
    "StampRules",
    "StampedInputs",
    "Table",
    "TimeSource",
    "Trigger",
    "UnixSeconds",
    "ValidWhen",
    "WordOrder",
    "WordType",
    "camel_case",
]

MODBUS_PORT: Final = 502
"""TCP and UDP; Messaging on TCP/IP V1.0b, section 3.1.1 (registered with IANA)."""
MAX_READ_REGISTERS: Final = 125
"""V1.1b3, section 6.3."""
MAX_READ_BITS: Final = 2000
"""V1.1b3, section 6.1."""
MAX_BLOCK: Final = 8000
"""Registers or bits of a block that several requests fetch; its octets fit one sample."""
PACKED_OCTETS: Final = range(2, 251)
"""Of a packed block: a function is asked for 1 to 125 words."""
MAX_RANGED_POINTS: Final = 64
"""The masks of a sample have one bit for each of the first 64 points of its block."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidWhen:
    """A measurement counts only while another field of its block has one of these values.

    point: an unscaled integer point, one of its named bits (0 or 1), one of its parts, or a bit.
    """

    point: str
    values: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One value of a block.

    offset: registers from the address of the block; in a block of bits, bits; packed, octets.
    words: of text and octets, how many, in the same units.
    scale, add: the value is the number in the device times ``scale`` plus ``add``; kept as Decimal
    so that 57 * 0.01 is 0.57 exactly.
    word_order: of this point, whatever the device's is; None = the device's, which holds for values
    of more than one register.
    unit: UCUM.
    low, high: the range that the device's document gives, in the unit of the value, inclusive.
    sentinels: numbers in the device, before scale and add, that say why there is no measurement.
    valid_when: otherwise the measurement is missing.
    meanings: what single values mean, for people (tables, documentation); the value stays a number.
    bits: name of each meaningful bit by number, 0 = least significant; one boolean field each.
    parts: (lowest bit, bits, name) of numbers that share the word; one unsigned field each.
    """

    name: str
    offset: int
    type: WordType
    words: int = 0
    scale: Decimal | None = None
    unit: str = ""
    low: Decimal | None = None
    high: Decimal | None = None
    meanings: tuple[tuple[int, str], ...] = ()
    bits: tuple[tuple[int, str], ...] = ()
    title: str = ""
    add: Decimal | None = None
    word_order: WordOrder | None = None
    sentinels: tuple[tuple[Decimal, str], ...] = ()
    valid_when: ValidWhen | None = None
    parts: tuple[tuple[int, int, str], ...] = ()

    @property
    def is_scaled(self) -> bool:
        return self.scale is not None or self.add is not None

    @property
    def can_be_missing(self) -> bool:
        """Whether a sample can say that there is no measurement; a device's own NaN is a value."""
        return bool(self.sentinels) or self.valid_when is not None or self.type.is_bcd

    @property
    def field_names(self) -> tuple[str, ...]:
        """The point, its named bits, its parts."""
        bits = (name for _, name in self.bits)
        return (self.name, *bits, *(name for _, _, name in self.parts))


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Words that belong together.

    atomic: fetched in one request of their own. Otherwise a request may take in neighbours of the
    same table and period, and a block that is larger than an answer is fetched by several.
    period: nanoseconds from read to read; None = as the device is configured.
    is_clock: ``time`` is the device's clock when it is read, not the time of a measurement.
    repeatable: where the answer to a call is lost, the function may be called once more at once.
    packed: the answer of a function as a structure of octets. Offsets and ``count`` are octets, odd
    ones too, and the order of the device holds for every number.
    message: name of the message type where it is not that of the block, in the same words.
    must_not_increase: points whose values cannot grow from one to the next. With the ranges of the
    32-bit points this tells a wrong word order (one warning event, never a rewrite).
    """

    name: str
    table: Table
    address: int
    count: int
    points: tuple[Point, ...]
    trigger: Trigger | None = None
    time: TimeSource | None = None
    must_not_increase: tuple[str, ...] = ()
    title: str = ""
    period: int | None = None
    atomic: bool = True
    is_clock: bool = False
    message: str = ""
    packed: bool = False
    repeatable: bool = False

    @property
    def handshake(self) -> FlagAndClear | None:
        """The trigger where it is a flag that the client clears."""
        return self.trigger if isinstance(self.trigger, FlagAndClear) else None

    @property
    def octets(self) -> int:
        """Size of the block as on the wire: two octets a register, eight bits an octet."""
        if self.packed:
            return self.count
        return (self.count + 7) // 8 if self.table.has_bits else 2 * self.count

    def size_of(self, point: Point) -> int:
        """Registers, bits or octets of one of its points."""
        if point.type.has_length:
            return point.words
        return point.type.words * (2 if self.packed else 1)

    @property
    def can_miss(self) -> bool:
        """Whether its samples have a ``missing`` mask."""
        return any(point.can_be_missing for point in self.points)


@dataclass(frozen=True, slots=True, kw_only=True)
class StampedInputs:
    """A list of inputs that carry the time of their last change, read by function 43.

    table: discrete inputs or input registers. stamp: octets of a time stamp, 7 or 4.
    layout: of registers, values and stamps in turn or apart; None = the device is asked.
    """

    table: Table
    stamp: int
    address: int
    count: int
    layout: Layout | None = Layout.INTERLEAVED

    @property
    def mei(self) -> Mei:
        """What asks for them."""
        return Mei[f"{'DISCRETE' if self.table.has_bits else 'REGISTERS'}_{self.stamp}"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StampRules:
    """How a device's stamps are read; roclog.stamps says what each means."""

    zone: str = "UTC"
    year_pivot: int = 70
    lenient: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialDefaults:
    """Line settings that the device's document fixes, and the silence it asks before a frame.

    is_documented: False where no document states them, so that they only fill in what the
    configuration leaves open.
    """

    baudrate: int
    bytesize: int = 8
    parity: str = "N"
    stopbits: int = 1
    silence_characters: float = 3.5
    is_documented: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterMap:
    """A device. ``facts`` are blocks read at the start and kept as metadata, not as samples.

    cycle: (facts block, names of the points in seconds) whose sum is the time between samples.
    identity: (facts block, point) of what tells this very device from another one of its kind:
    where one of them changes, another device stands there.
    answer_limit: longest time the document allows the device to answer, nanoseconds.
    dialect: how its frames differ from the standard's. has_serial_port: False = TCP and UDP only.
    stamped: lists of inputs that carry their own time stamps, read as stamp_rules say.
    writable: what people may have written to it.
    """

    name: str
    title: str
    source: str
    unit: int
    serial: SerialDefaults
    answer_limit: int
    samples: tuple[Block, ...]
    facts: tuple[Block, ...] = ()
    cycle: tuple[str, tuple[str, ...]] | None = None
    identity: tuple[tuple[str, str], ...] = ()
    port: int = MODBUS_PORT
    dialect: Dialect = STANDARD
    has_serial_port: bool = True
    stamped: tuple[StampedInputs, ...] = ()
    stamp_rules: StampRules = StampRules()
    writable: Writable | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def blocks(self) -> tuple[Block, ...]:
        return self.facts + self.samples

    @property
    def stamped_tables(self) -> tuple[Table, ...]:
        """The tables of ``stamped``, each once."""
        return tuple(dict.fromkeys(inputs.table for inputs in self.stamped))

    @property
    def flagged(self) -> Block | None:
        """The block with a flag to clear; a map has at most one."""
        flagged = (b for b in self.samples if isinstance(b.trigger, FlagAndClear))
        return next(flagged, None)

    def block(self, name: str) -> Block:
        """Raises KeyError where the map has no such block."""
        for block in self.blocks:
            if block.name == name:
                return block
        raise KeyError(name)


def camel_case(name: str) -> str:
    """``iso_code_1`` to ``IsoCode1``, as message types and protobuf's JSON names are formed."""
    return "".join(part.capitalize() for part in name.split("_"))

"""``profile = "registers"`` and ``mpa-48``: everything a map can say, and everything it cannot."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from roclog.config import Settings, load, warnings
from roclog.decode import decode, named_values
from roclog.register_map import (
    Change,
    ClearOnRead,
    Counter,
    Cp56,
    FlagAndClear,
    Point,
    RegisterMap,
    SecondsMicroseconds,
    SplitCalendar,
    Table,
    UnixSeconds,
    ValidWhen,
    WordOrder,
    WordType,
)

if TYPE_CHECKING:
    from collections.abc import Callable

EXAMPLES = Path(__file__).parents[2] / "examples"
HEAD = """
[connections.net]
transport = "tcp"
host = "10.0.0.1"
[devices.tank]
profile = "registers"
connection = "net"
unit = 9
"""
BLOCK = """[[devices.tank.blocks]]
name = "level"
table = "holding_registers"
address = 100
"""
LEVEL = '{ name = "level", offset = 0, type = "uint16" }'
KEY = "devices.tank.blocks[0]"


def points(*more: str) -> str:
    return f"points = [{', '.join(more)}]\n"


def point(text: str, name: str = "p", type_: str = "uint16") -> str:
    """A block of one point with these keys more."""
    more = f", {text}" if text else ""
    return points(f'{{ name = "{name}", offset = 0, type = "{type_}"{more} }}')


@pytest.fixture
def loaded(tmp_path: Path) -> Callable[[str], RegisterMap]:
    def load_it(text: str) -> RegisterMap:
        path = tmp_path / "roclog.toml"
        path.write_text(HEAD + text, encoding="utf-8")
        return load(path).devices["tank"].profile

    return load_it


POINT = f"{KEY}.points[0]"
MISTAKES: dict[str, tuple[str, str]] = {
    "a type as Modbus tools call it": (
        BLOCK + point("", type_="u16"),
        f'{POINT}.type: "u16" is not a type, did you mean "uint16"?',
    ),
    "a type as PLCs call it": (
        BLOCK + point("", type_="REAL"),
        f'{POINT}.type: "REAL" is not a type, did you mean "float32"?',
    ),
    "a type that is nothing like one": (
        BLOCK + point("", type_="xyz"),
        f'{POINT}.type: "xyz" is not a type: "uint16", "int16", "uint32", "int32", "uint64",',
    ),
    "a table as manuals call it": (
        BLOCK.replace("holding_registers", "input") + points(LEVEL),
        (
            f'{KEY}.table: "input" is not "coils", "discrete_inputs", "input_registers" or '
            '"holding_registers", did you mean "input_registers"?'
        ),
    ),
    "a block without its table": (
        BLOCK.replace('table = "holding_registers"\n', "") + points(LEVEL),
        f'{KEY}.table: missing, needed is "coils", "discrete_inputs", ',
    ),
    "a label as manuals count": (
        BLOCK.replace("100", "400101") + points(LEVEL),
        (
            f"{KEY}.address: 400101 is not a PDU address: a number from 0 to 65535, counted from "
            "0; the register that manuals call 40001 or 400001 is 0 in holding_registers"
        ),
    ),
    "an address for an offset": (
        BLOCK + points(LEVEL, '{ name = "p", offset = 140, type = "uint16" }'),
        (
            f"{KEY}.points[1].offset: 140 is register 240, since offsets count from the address "
            "of the block, 100; a block has 125 registers, or 8000 with atomic = false"
        ),
    ),
    "the address of a point": (
        BLOCK + points('{ name = "p", offset = 0, address = 9, type = "uint16" }'),
        f'{POINT}.address: unknown key, did you mean "offset"?',
    ),
    "a factor": (
        BLOCK + point("factor = 0.1"),
        f'{POINT}.factor: unknown key, did you mean "scale"?',
    ),
    "a text of no length": (
        BLOCK + point("", type_="text"),
        f"{POINT}.words: missing, needed is the number of registers of text",
    ),
    "a point larger than its block": (
        BLOCK + "count = 1\n" + point("", type_="float32"),
        f"{POINT}.offset: offset 0 with 2 words is outside the block, which has 1",
    ),
    "an order of one register for two": (
        BLOCK + point('word_order = "BA"', type_="float32"),
        f"{POINT}.word_order: BA is an order of one register, float32 has 2: ABCD, CDAB, BADC or",
    ),
    "names of bits the wrong way round": (
        BLOCK + point("bits = { running = 0 }"),
        f"{POINT}.bits.running: 0 is not a text in quotes, needed is a table of bit and name, like",
    ),
    "one pair of brackets": (
        BLOCK.replace("[[", "[").replace("]]", "]") + points(LEVEL),
        "devices.tank.blocks: a table is not an array of tables, needed are blocks, written as [[",
    ),
    "nothing but facts": (
        BLOCK + 'read = "once"\n' + points(LEVEL),
        'devices.tank.blocks: all have read = "once", so that nothing would be recorded',
    ),
    "a point over two lines": (
        BLOCK + "points = [{ name = 'p',\n offset = 0, type = 'uint16' }]\n",
        (
            "line 13, column 24: not TOML: Invalid initial character for a key part; a table in "
            "{ } stays on one line and has no comma at its end"
        ),
    ),
    "an octet": (
        BLOCK + point("", type_="uint8"),
        (
            f'{POINT}.type: "uint8" is not a type; an octet is a part of a uint16, named by bits = '
            '{ 0-7 = "lower", 8-15 = "upper" }'
        ),
    ),
    "a divisor": (
        BLOCK + point("divisor = 10"),
        f"{POINT}.divisor: unknown key; scale multiplies: what a manual divides by 10 has scale =",
    ),
    "a type with its order": (
        BLOCK + point("", type_="float32_swap"),
        f'{POINT}.type: "float32_swap" is not a type; write type = "float32", word_order = "CDAB"',
    ),
    "a type with its order in capitals": (
        BLOCK + point("", type_="UINT32-LE"),
        f'{POINT}.type: "UINT32-LE" is not a type; write type = "uint32", word_order = "DCBA"',
    ),
    "a trigger in a word": (
        BLOCK + points(LEVEL) + 'trigger = "cyclic"\n',
        (
            f'{KEY}.trigger: "cyclic" is not a table, needed is one like {{ change = ["state"] }} '
            'or { counter = "number" }; cyclic is the default, without a trigger'
        ),
    ),
    "a status as a formula": (
        BLOCK + point('valid_when = "s == 1"'),
        f'{POINT}.valid_when: "s == 1" is not a table, needed is one like {{ point = "status", ',
    ),
    "a flag that is a number": (
        BLOCK + points(LEVEL) + "trigger = { clear_on_read = 5 }\n",
        f"{KEY}.trigger.clear_on_read: 5 is not a table, needed is one like {{ address = 2, mask =",
    ),
    "a sentinel of unsigned words": (
        BLOCK + point('sentinels = { 65535 = "none" }', type_="int16"),
        (
            f"{POINT}.sentinels: sentinel 65535 is not a number of int16; these words are -1, or "
            "0xFFFF"
        ),
    ),
    "a sentinel after the scale": (
        BLOCK + point('scale = 0.1, sentinels = { "-3276.8" = "none" }', type_="int16"),
        (
            f"{POINT}.sentinels: sentinel -3276.8 is not a number of int16; a sentinel is the "
            "number in the device, before scale and add, like -32768"
        ),
    ),
    "a sentinel with a dot": (
        BLOCK + point('sentinels = { -9999.0 = "none" }', type_="float32"),
        f'{POINT}.sentinels.-9999: a key with a dot is written in quotes, "-9999.0" = ...',
    ),
    "a sentinel that is NaN": (
        BLOCK + point('sentinels = { nan = "none" }', type_="float32"),
        f"{POINT}.sentinels.nan: not needed, NaN is no number and is recorded as that",
    ),
    "a sentinel of the words of NaN": (
        BLOCK + point('sentinels = { 0xFFC00000 = "none" }', type_="float32"),
        f"{POINT}.sentinels.0xFFC00000: not needed, NaN is no number",
    ),
    "a sentinel of no digits": (
        BLOCK + point('sentinels = { 0xFFFFFFFF = "none" }', type_="bcd32"),
        f"{POINT}.sentinels.0xFFFFFFFF: not needed, words that are no decimal digits",
    ),
    "a sentinel beyond a float": (
        BLOCK + point('sentinels = { 1e39 = "none" }', type_="float32"),
        f"{POINT}.sentinels: sentinel 1E+39 is not a number of float32",
    ),
    "the name of a bit": (
        BLOCK + point('bits = { 0 = "Run" }'),
        (f"{POINT}.bits.0: 'Run' cannot be a name: 1 to 48 of a-z, 0-9 and _, with a letter first"),
    ),
    "the name of a part": (
        BLOCK + point('bits = { 8-11 = "seq" }'),
        f"{POINT}.bits.8-11: 'seq' cannot be a name, every sample has a field of that name",
    ),
    "blocks of nothing": (
        "blocks = []\n",
        "devices.tank.blocks: is empty, needed are blocks, written as [[devices.NAME.blocks]]",
    ),
    "a zone of no time": (
        'timezone = "Europe/Berlin"\n' + BLOCK + points(LEVEL),
        "devices.tank.timezone: has no effect, since no block has a time",
    ),
    "a zone of seconds": (
        'timezone = "Europe/Berlin"\n'
        + BLOCK
        + points(LEVEL)
        + 'time = { source = "unix", offset = 1 }\n',
        "devices.tank.timezone: has no effect, since unix and unix_us count seconds of UTC",
    ),
    "an acknowledge of no flag": (
        "acknowledge = false\n" + BLOCK + points(LEVEL) + "trigger = { change = [] }\n",
        "devices.tank.acknowledge: has no effect, since no block has trigger = { flag = ... }",
    ),
    "a cycle of no samples": (
        'cycle = "10s"\n' + BLOCK + points(LEVEL),
        "devices.tank.cycle: has no effect, since no block has a trigger",
    ),
    "a period of facts": (
        BLOCK
        + 'read = "once"\nperiod = "10s"\n'
        + points(LEVEL)
        + BLOCK.replace('"level"', '"other"')
        + points(LEVEL),
        f'{KEY}.period: has no effect with read = "once"',
    ),
    "a counter in several requests": (
        BLOCK
        + "atomic = false\ncount = 126\n"
        + points(LEVEL)
        + 'trigger = { counter = "level" }\n',
        f"{KEY}.trigger: a block with a trigger must be read in one request, at most 125 registers",
    ),
    "too many registers for one request": (
        BLOCK + "count = 200\n" + points(LEVEL),
        f"{KEY}.count: count 200 is not 1 to 125 registers, or 8000 with atomic = false",
    ),
    "a flag that a coil cannot be": (
        BLOCK
        + "trigger = { clear_on_read = { table = 'coils', address = 2, mask = 4 } }\n"
        + points(LEVEL),
        f"{KEY}.trigger: clear on read: a bit AND 4 is never 4, needed is mask 1",
    ),
    "a name that no terminal should obey": (
        BLOCK + point('valid_when = { point = "\\u202e\\u001b[2J", values = [1] }'),
        f"{POINT}.valid_when: no point \\u202e\\u001b[2J in this block",
    ),
    "an identity without its block": (
        'identity = ["number"]\n' + BLOCK + points(LEVEL),
        'devices.tank.identity[0]: "number" is not a block.point',
    ),
    "an identity that is a sample": (
        'identity = ["level.level"]\n' + BLOCK + points(LEVEL),
        "devices.tank.identity: no point level.level in a block that is read once",
    ),
    "no blocks": ("", "devices.tank.blocks: missing, needed is blocks"),
    "blocks in words": ('blocks = "none"', 'devices.tank.blocks: "none" is not an array of tables'),
    "no table": ('[[devices.tank.blocks]]\nname = "a"', f"{KEY}.table: missing"),
    "a table that is none": (
        BLOCK.replace("holding_registers", "holding") + points(LEVEL),
        f'{KEY}.table: "holding" is not',
    ),
    "an unknown key": (BLOCK + "adress = 1\n" + points(LEVEL), f"{KEY}.adress: unknown key, did"),
    "an address of 17 bits": (
        BLOCK.replace("100", "65536") + points(LEVEL),
        f"{KEY}.address: 65536 is not a PDU address",
    ),
    "a block name": (
        BLOCK.replace('"level"', '"Level"') + points(LEVEL),
        f'{KEY}.name: "Level" is not a name',
    ),
    "a taken block name": (
        BLOCK.replace('"level"', '"gap"') + points(LEVEL),
        f"{KEY}.name: name must be lower case letters",
    ),
    "no points": (BLOCK + "points = []\n", f"{KEY}.points: no points"),
    "too many registers": (
        BLOCK + "count = 126\n" + points(LEVEL),
        f"{KEY}.count: count 126 is not 1 to 125 registers",
    ),
    "registers that do not exist": (
        BLOCK.replace("100", "65535") + "count = 2\n" + points(LEVEL),
        f"{KEY}.address: registers 65535 to 65536 do not exist",
    ),
    "a period of nothing": (BLOCK + 'period = "0s"\n' + points(LEVEL), f"{KEY}.period: '0s' is"),
    "a point without a type": (
        BLOCK + points('{ name = "p", offset = 0 }'),
        f"{POINT}.type: missing, needed is a type",
    ),
    "a type that is none": (BLOCK + point("", type_="uint24"), f'{POINT}.type: "uint24" is not'),
    "a name of a common field": (BLOCK + point("", "seq"), f"{POINT}.name: 'seq' cannot be a name"),
    "a point outside": (
        BLOCK + "count = 1\n" + point("", type_="float64"),
        f"{POINT}.offset: offset 0 with 4 words is outside the block",
    ),
    "two points in one register": (
        BLOCK + points(LEVEL, LEVEL.replace('"level"', '"other"')),
        f"{KEY}.points[1].offset: shares register 0 with level",
    ),
    "two points of one name": (
        BLOCK + points(LEVEL, LEVEL.replace("offset = 0", "offset = 1")),
        f"{KEY}.points[1].name: field level: named twice",
    ),
    "a bit among registers": (BLOCK + point("", type_="bit"), f"{POINT}.type: bit is not a type"),
    "a register among coils": (
        BLOCK.replace("holding_registers", "coils") + points(LEVEL),
        f"{POINT}.type: uint16 is not a type of coils",
    ),
    "a scale of bytes": (
        BLOCK + point("words = 2, scale = 2", type_="bytes"),
        f"{POINT}.scale: bytes cannot have a scale",
    ),
    "words of a number": (BLOCK + point("words = 2"), f"{POINT}.words: only text and bytes"),
    "an order that is none": (
        BLOCK + point('word_order = "CDBA"', type_="uint32"),
        f'{POINT}.word_order: "CDBA" is not',
    ),
    "an order of words in one register": (
        BLOCK + point('word_order = "CDAB"'),
        f"{POINT}.word_order: CDAB is not an order of one register",
    ),
    "a scale of zero": (BLOCK + point("scale = 0"), f"{POINT}.scale: scale 0 is not a number"),
    "a scale in quotes": (BLOCK + point('scale = "0.1"'), f'{POINT}.scale: "0.1" is not a number'),
    "infinity added": (BLOCK + point("add = inf"), f"{POINT}.add: add Infinity is not a number"),
    "a unit that is not UCUM": (BLOCK + point('unit = "°C"'), f"{POINT}.unit: unit '°C' is not"),
    "half a range": (BLOCK + point("range = [1]"), f"{POINT}.range: an array is not two numbers"),
    "a range upside down": (BLOCK + point("range = [2, 1]"), f"{POINT}.range: low 2 is above high"),
    "bits the wrong way": (
        BLOCK + point('bits = { 7-4 = "mode" }'),
        f"{POINT}.bits.7-4: is not a bit like 0",
    ),
    "a bit outside": (BLOCK + point('bits = { 16 = "b" }'), f"{POINT}.bits: bit 16 is outside"),
    "bits of a scaled number": (
        BLOCK + point('scale = 0.1, bits = { 0 = "b" }'),
        f"{POINT}.bits: bits need an unscaled unsigned integer",
    ),
    "bits that overlap": (
        BLOCK + point('bits = { 5 = "b", 4-7 = "mode" }'),
        f"{POINT}.bits: bit 5: named twice",
    ),
    "a meaning of no number": (
        BLOCK + point('meanings = { open = "1" }'),
        f'{POINT}.meanings.open: "open" is not a whole number',
    ),
    "a sentinel of another type": (
        BLOCK + point('sentinels = { -1 = "none" }'),
        f"{POINT}.sentinels: sentinel -1 is not a number of uint16",
    ),
    "a sentinel of too many words": (
        BLOCK + point('sentinels = { 0x18000 = "none" }'),
        f"{POINT}.sentinels.0x18000: these words are no number of uint16",
    ),
    "a sentinel in words": (
        BLOCK + point('sentinels = { none = "none" }'),
        f'{POINT}.sentinels.none: "none" is not a number',
    ),
    "a status that is not there": (
        BLOCK + point('valid_when = { point = "ghost", values = [0] }'),
        f"{POINT}.valid_when: no point ghost in this block",
    ),
    "a status of itself": (
        BLOCK + point('valid_when = { point = "p", values = [0] }'),
        f"{POINT}.valid_when: a point cannot depend on itself",
    ),
    "a status that is never so": (
        BLOCK
        + points(
            LEVEL,
            '{ name = "x", offset = 1, type = "uint16", valid_when = '
            '{ point = "level", values = [65536] } }',
        ),
        f"{KEY}.points[1].valid_when: level is never 65536",
    ),
    "a status without values": (
        BLOCK
        + points(
            LEVEL,
            '{ name = "x", offset = 1, type = "uint16", valid_when = '
            '{ point = "level", values = [] } }',
        ),
        f"{KEY}.points[1].valid_when: no values",
    ),
    "a trigger of nothing": (
        BLOCK + points(LEVEL) + "trigger = {}\n",
        f"{KEY}.trigger: is nothing, needed is one of flag",
    ),
    "two triggers": (
        BLOCK + points(LEVEL) + 'trigger = { flag = 1, counter = "level" }\n',
        f"{KEY}.trigger: is flag and counter",
    ),
    "a key of another trigger": (
        BLOCK + points(LEVEL) + 'trigger = { counter = "level", new = 1 }\n',
        f"{KEY}.trigger.new: only with flag",
    ),
    "a flag that nobody can clear": (
        BLOCK.replace("holding", "input") + points(LEVEL) + "trigger = { flag = 1 }\n",
        f"{KEY}.trigger: flag: only a holding register can be cleared",
    ),
    "a flag that is a point": (
        BLOCK + points(LEVEL) + "trigger = { flag = 0 }\n",
        f"{POINT}.offset: shares register 0 with the flag; leave this point out, the flag needs",
    ),
    "a payload of no point": (
        BLOCK + points(LEVEL) + 'trigger = { flag = 1, payload = ["levle"] }\n',
        f'{KEY}.trigger.payload: no point "levle" in this block, did you mean "level"?',
    ),
    "a counter that is not there": (
        BLOCK + points(LEVEL) + 'trigger = { counter = "ghost" }\n',
        f"{KEY}.trigger: counter: no point ghost in this block",
    ),
    "a counter of a range upside down": (
        BLOCK + points(LEVEL) + 'trigger = { counter = "level", first = 5, last = 4 }\n',
        f"{KEY}.trigger: counter: 5 to 4 is not a range of uint16",
    ),
    "a flag that its mask hides": (
        BLOCK
        + points(LEVEL)
        + "trigger = { clear_on_read = { address = 2, mask = 4, new = 1 } }\n",
        f"{KEY}.trigger: clear on read: the flag can never be 1 with mask 4",
    ),
    "a flag in several requests": (
        BLOCK + "atomic = false\n" + points(LEVEL) + "trigger = { flag = 1 }\n",
        f"{KEY}.atomic: a block with a flag must be read in one request",
    ),
    "a trigger of what is read once": (
        BLOCK + 'read = "once"\n' + points(LEVEL) + "trigger = { change = [] }\n",
        f"{KEY}.trigger: facts are read once",
    ),
    "a time without its words": (
        BLOCK + points(LEVEL) + 'time = { source = "unix_us", seconds = 2 }\n',
        f"{KEY}.time.microseconds: missing, needed for unix_us",
    ),
    "a word of another time": (
        BLOCK + points(LEVEL) + 'time = { source = "unix", offset = 2, hour = 1 }\n',
        f'{KEY}.time.hour: only with source = "calendar"',
    ),
    "a calendar without a day": (
        BLOCK + points(LEVEL) + 'time = { source = "calendar", year = 1, month = 2, hour = 3 }\n',
        f"{KEY}.time: there is no day",
    ),
    "a time outside": (
        BLOCK + "count = 2\n" + points(LEVEL) + 'time = { source = "unix", offset = 1 }\n',
        f"{KEY}.time: offset 2 is outside the block",
    ),
    "a stamp without a date on schedule": (
        BLOCK + points(LEVEL) + 'time = { source = "cp32", offset = 1 }\n',
        f"{KEY}.time: a stamp without a date needs a trigger",
    ),
    "a zone that is none": (
        'timezone = "Mars"\n' + BLOCK + points(LEVEL),
        "devices.tank.timezone: 'Mars' is not a time zone",
    ),
    "two flags in one device": (
        (BLOCK + points(LEVEL) + "trigger = { flag = 1 }\n")
        + (BLOCK + points(LEVEL) + "trigger = { flag = 1 }\n").replace('"level"', '"other"'),
        "devices.tank.blocks: blocks level and other: only one can have a flag",
    ),
}


_CASCADES = {"no table", "a flag that is a point", "a trigger of what is read once"}
"""One mistake, more than one thing that does not hold."""


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_have_their_key_path(mistake: str, refusal: Callable[[str], list[str]]) -> None:
    text, problem = MISTAKES[mistake]
    lines = refusal(HEAD + text)
    assert any(line.startswith(problem) for line in lines), lines
    assert all(line.isprintable() for line in lines)
    allowed = (
        3
        if mistake in ("no table", "a flag that is a point", "a trigger of what is read once")
        else 1
    )
    assert len(lines) <= allowed, lines


def test_all_mistakes_of_a_map_are_told_at_once(refusal: Callable[[str], list[str]]) -> None:
    lines = refusal(
        HEAD.replace("unit = 9\n", "")
        + BLOCK
        + points(
            '{ name = "a", offset = 0, type = "float32", word_order = "CDBA" }',
            '{ name = "b", offset = 1, type = "uint16", scale = 0, unit = "°C" }',
            '{ name = "c", type = "uint16" }',
        )
        + BLOCK.replace('"level"', '"Level"')
        + points(LEVEL)
    )
    assert [line.partition(":")[0] for line in lines] == [
        f"{KEY}.points[0].word_order",
        f"{KEY}.points[2].offset",
        "devices.tank.blocks[1].name",
        "devices.tank.unit",
        f"{KEY}.points[1].unit",
        f"{KEY}.points[1].scale",
        f"{KEY}.points[1].offset",
    ]


def test_every_word_of_a_point(loaded: Callable[[str], RegisterMap]) -> None:
    made = loaded(
        BLOCK
        + points(
            '{ name = "status", offset = 0, type = "uint16", bits = { 0 = "ok", 4-6 = "mode" }, '
            'meanings = { 0 = "off", 0x10 = "manual" }, title = "State" }',
            '{ name = "t", offset = 1, type = "int16", word_order = "BA", scale = 0.1, add = -40, '
            'unit = "Cel", range = [-40, 99.5], sentinels = { 0x8000 = "none", 32767 = "short" }, '
            'valid_when = { point = "ok", values = [1] } }',
            '{ name = "f", offset = 2, type = "float32", word_order = "DCBA", '
            'sentinels = { "-999.9" = "none" } }',
            '{ name = "digits", offset = 4, type = "bcd32", sentinels = { 0x99999999 = "none" } }',
        )
    )
    (block,) = made.samples
    assert (block.name, block.table, block.address, block.count) == (
        "level",
        Table.HOLDING_REGISTERS,
        100,
        6,
    )
    assert block.points == (
        Point(
            name="status",
            offset=0,
            type=WordType.U16,
            bits=((0, "ok"),),
            parts=((4, 3, "mode"),),
            meanings=((0, "off"), (16, "manual")),
            title="State",
        ),
        Point(
            name="t",
            offset=1,
            type=WordType.S16,
            word_order=WordOrder.BADC,
            scale=Decimal("0.1"),
            add=Decimal(-40),
            unit="Cel",
            low=Decimal(-40),
            high=Decimal("99.5"),
            sentinels=((Decimal(-32768), "none"), (Decimal(32767), "short")),
            valid_when=ValidWhen(point="ok", values=(1,)),
        ),
        Point(
            name="f",
            offset=2,
            type=WordType.F32,
            word_order=WordOrder.DCBA,
            sentinels=((Decimal("-999.9"), "none"),),
        ),
        Point(
            name="digits",
            offset=4,
            type=WordType.BCD32,
            sentinels=((Decimal(99999999), "none"),),
        ),
    )


@pytest.mark.parametrize(
    ("text", "trigger", "count"),
    [
        ("", None, 1),
        ("{ flag = 5 }", FlagAndClear(flag=5, payload=((0, 1),), is_assumed=True), 6),
        (
            '{ flag = 5, new = 2, clear = 3, payload = ["level"] }',
            FlagAndClear(flag=5, new=2, clear=3, payload=((0, 1),)),
            6,
        ),
        ('{ counter = "level" }', Counter(point="level"), 1),
        (
            '{ counter = "level", first = 1, last = 9 }',
            Counter(point="level", first=1, last=9),
            1,
        ),
        ("{ change = [] }", Change(), 1),
        ('{ change = ["level"] }', Change(payload=((0, 1),)), 1),
        (
            "{ clear_on_read = { address = 100 } }",
            ClearOnRead(table=Table.HOLDING_REGISTERS, address=100),
            1,
        ),
        (
            '{ clear_on_read = { table = "input_registers", address = 2, mask = 4 } }',
            ClearOnRead(table=Table.INPUT_REGISTERS, address=2, mask=4, new=4),
            1,
        ),
    ],
)
def test_triggers(
    text: str, trigger: Any, count: int, loaded: Callable[[str], RegisterMap]
) -> None:
    said = f"trigger = {text}\n" if text else ""
    (block,) = loaded(BLOCK + points(LEVEL) + said).samples
    assert (block.trigger, block.count) == (trigger, count)


@pytest.mark.parametrize(
    ("text", "time", "count"),
    [
        ('{ source = "unix", offset = 1 }', UnixSeconds(offset=1), 3),
        (
            '{ source = "unix", offset = 1, word_order = "CDAB", epoch = 946684800 }',
            UnixSeconds(offset=1, word_order=WordOrder.CDAB, epoch=946684800),
            3,
        ),
        (
            '{ source = "unix", offset = 1, epoch = -3600 }',
            UnixSeconds(offset=1, epoch=-3600),
            3,
        ),
        (
            '{ source = "unix_us", seconds = 3, microseconds = 1 }',
            SecondsMicroseconds(seconds=3, microseconds=1),
            5,
        ),
        (
            '{ source = "cp56", offset = 1, word_order = "BADC" }',
            Cp56(offset=1, word_order=WordOrder.BADC, zone="Europe/Berlin"),
            5,
        ),
        (
            '{ source = "calendar", year = 1, month_day = 2, hour_minute = 3, year_base = 2000 }',
            SplitCalendar(year=1, month_day=2, hour_minute=3, year_base=2000, zone="Europe/Berlin"),
            4,
        ),
    ],
)
def test_times(text: str, time: Any, count: int, loaded: Callable[[str], RegisterMap]) -> None:
    zone = 'timezone = "Europe/Berlin"\n' if hasattr(time, "zone") else ""
    (block,) = loaded(zone + BLOCK + points(LEVEL) + f"time = {text}\n").samples
    assert (block.time, block.count) == (time, count)


def test_numbers_as_manuals_print_them(loaded: Callable[[str], RegisterMap]) -> None:
    """The largest binary32 in eight digits, and a scale that turns the sign round."""
    largest = 'scale = -1, sentinels = { "3.4028235e38" = "none" }'
    (block,) = loaded(BLOCK + point(largest, type_="float32")).samples
    assert named_values(block, decode(block, [0x7F7F, 0xFFFF])) == {"p": None}
    assert named_values(block, decode(block, [0x3F80, 0x0000])) == {"p": -1.0}


def test_a_zone_that_says_what_is_so(loaded: Callable[[str], RegisterMap]) -> None:
    stamp = 'time = { source = "unix", offset = 1 }\n'
    assert loaded('timezone = "UTC"\n' + BLOCK + points(LEVEL) + stamp).samples[0].time
    both = BLOCK + points(LEVEL) + stamp + BLOCK.replace('"level"', '"other"') + points(LEVEL)
    calendar = 'time = { source = "cp56", offset = 1 }\n'
    made = loaded('timezone = "Europe/Berlin"\n' + both + calendar)
    assert made.samples[0].time == UnixSeconds(offset=1)


def test_local_seconds(loaded: Callable[[str], RegisterMap]) -> None:
    """Noon of 2024-07-01 as a clock at +02:00 counts it is 10:00 UTC."""
    stamp = 'time = { source = "unix", offset = 1, epoch = -7200 }\n'
    (block,) = loaded(BLOCK + points(LEVEL) + stamp).samples
    noon = int(datetime(2024, 7, 1, 12, tzinfo=UTC).timestamp())
    utc = int(datetime(2024, 7, 1, 10, tzinfo=UTC).timestamp())
    assert decode(block, [0, noon >> 16, noon & 0xFFFF]).device_time == utc * 10**9
    assert decode(block, [0, 0, 7100]).device_time == 0


def test_an_unsaid_payload_is_worth_a_warning(load_text: Callable[[str], Settings]) -> None:
    dose = LEVEL.replace("level", "dose").replace("offset = 0", "offset = 1")
    block = HEAD + BLOCK + points(LEVEL, dose)
    (warning,) = warnings(load_text(block + "trigger = { flag = 5 }\n"))
    assert str(warning).startswith(
        "devices.tank.blocks: level: a change of any point is a sample, also while the flag is down"
    )
    for said in ('["level"]', '["level", "dose"]'):
        text = block + f"trigger = {{ flag = 5, payload = {said} }}\n"
        assert warnings(load_text(text)) == []
    single = HEAD + BLOCK + points(LEVEL) + "trigger = { flag = 5 }\n"
    assert warnings(load_text(single)) == []


def test_blocks_of_every_kind(loaded: Callable[[str], RegisterMap]) -> None:
    made = loaded(
        BLOCK
        + 'period = "250ms"\natomic = false\n'
        + points(LEVEL)
        + BLOCK.replace('"level"', '"names"')
        + 'read = "once"\n'
        + point("words = 4", "model", "text")
        + BLOCK.replace('"level"', '"relays"').replace("holding_registers", "coils")
        + point("", "pump", "bit")
    )
    level, relays = made.samples
    assert (level.period, level.atomic) == (250_000_000, False)
    assert (relays.table, relays.points[0].type) == (Table.COILS, WordType.BIT)
    assert [block.name for block in made.facts] == ["names"]


# Real instruments


def values(name: str, device: str, block: str, words: dict[int, int]) -> dict[str, Any]:
    """Of a block of an example: words by their register."""
    made = load(EXAMPLES / name).devices[device].profile.block(block)
    given = [words.get(made.address + n, 0) for n in range(made.count)]
    decoded = decode(made, given)
    return named_values(made, decoded) | {"device_time": decoded.device_time}


def test_met_one() -> None:
    found = values(
        "met-one-6000.toml",
        "met1",
        "sample",
        {500: 2026, 501: 0x0B17, 502: 6, 503: 0x1E0F, 511: 1, 512: 2, 544: 0xFFF6, 545: 455},
    )
    assert found["device_time"] == 1_795_415_415 * 10**9  # 2026-11-23T06:30:15Z
    assert (found["count_1"], found["temperature"], found["humidity"]) == (65538, -1.0, 45.5)
    identity = values(
        "met-one-6000.toml", "met1", "identity", {15: 0x3838, 16: 0x3031, 17: 0, 38: 101}
    )
    assert (identity["model"], identity["firmware_version"]) == ("8801", 1.01)


def test_lighthouse() -> None:
    found = values(
        "lighthouse-rlpc.toml",
        "rlpc",
        "record",
        {0: 0x522E, 1: 0x5FD4, 3: 60, 5: 1, 7: 6, 9: 1234},
    )
    assert found["device_time"] == 1_378_770_900 * 10**9  # 2013-09-09T23:55:00Z
    assert (found["sample_time"], found["channel_1"]) == (60, 1234)
    # The manual's example: a flow alert and an overflow are a value of 6.
    assert (found["status"], found["flow_alert"], found["overflow"]) == (6, True, True)
    identity = values("lighthouse-rlpc.toml", "rlpc", "identity", {0: 0x0087, 3: 210})
    assert (identity["map_version"], identity["firmware_version"]) == (1.35, 2.1)


def test_rmf() -> None:
    words = {33: 4512, 34: 3550, 41: 99, 56: 21, 57: 20, 58: 17}
    there = values("rmf-cms-2.toml", "cms", "result", {31: 0b1, **words})
    assert (there["code_1"], there["code_2"], there["code_3"]) == (21, 20, 17)
    assert (there["temperature"], there["humidity"], there["count_1"]) == (45.12, 35.5, 99)
    away = values("rmf-cms-2.toml", "cms", "result", {31: 0b1000, **words})
    assert (away["code_1"], away["count_1"], away["temperature"]) == (None, None, 45.12)


# The analyser whose sensors must be told

MPA = """
[connections.net]
transport = "tcp"
host = "10.0.0.1"
[devices.basin]
profile = "mpa-48"
connection = "net"
unit = 3
"""


def test_mpa_48(tmp_path: Path) -> None:
    path = tmp_path / "roclog.toml"
    sensors = 'sensors = { channel_1 = "model-15", channel_2 = "model-10" }\n'
    path.write_text(MPA + sensors)
    made = load(path).devices["basin"].profile
    assert [block.name for block in made.samples] == ["relays", "channel_1", "channel_2"]
    assert made.block("channel_2").address == 3


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "devices.basin.sensors: missing, needed is a table of channel and model"),
        ("sensors = {}", "devices.basin.sensors: none; give the model on each channel"),
        (
            'sensors = { channel_1 = "model-11", channel_2 = "Model 10" }',
            (
                'devices.basin.sensors.channel_1: "model-11" is not a model: model-10, model-15, '
                "model-15L, model-51 or model-52"
            ),
        ),
        (
            'sensors = { channel_1 = "model-11", channel_2 = "Model 10" }',
            (
                'devices.basin.sensors.channel_2: "Model 10" is not a model: model-10, model-15, '
                'model-15L, model-51 or model-52, did you mean "model-10"?'
            ),
        ),
        ("sensors = { channel_1 = 10 }", "devices.basin.sensors.channel_1: 10 is not a model: "),
        (
            'sensors = { channel_3 = "model-10" }\naddresses = { channel_3 = "6" }',
            (
                'devices.basin.addresses.channel_3: "6" is not a register: a number from 0 to '
                "65533, without quotes"
            ),
        ),
        (
            (
                'sensors = { channel_3 = "model-10", channel_4 = "model-51" }\n'
                "addresses = { channel_3 = 6, channel_4 = 8 }"
            ),
            (
                "devices.basin.addresses.channel_4: registers 8 to 10 overlap those of "
                "addresses.channel_3, 6 to 8; each channel has 3 of its own"
            ),
        ),
        (
            (
                'sensors = { channel_3 = "model-10", channel_1 = "model-51" }\n'
                "addresses = { channel_3 = 2 }"
            ),
            (
                "devices.basin.addresses.channel_3: registers 2 to 4 overlap those of channel_1, "
                "0 to 2; "
            ),
        ),
        (
            'sensors = { channel_3 = "model-10" }',
            "devices.basin.sensors.channel_3: its address is not documented",
        ),
        ('sensors = { one = "model-10" }', "devices.basin.sensors.one: is not a channel"),
        (
            'sensors = { channel_1 = "model-10" }\naddresses = { channel_3 = 6 }',
            "devices.basin.addresses.channel_3: has an address, but no sensor",
        ),
        (
            'sensors = { channel_3 = "model-10" }\naddresses = { channel_3 = 65534 }',
            "devices.basin.addresses.channel_3: registers 65534 to 65536 do not exist",
        ),
    ],
)
def test_mpa_48_mistakes(text: str, problem: str, refusal: Callable[[str], list[str]]) -> None:
    lines = refusal(MPA + text)
    assert any(line.startswith(problem) for line in lines), lines


def test_a_model_that_is_close_to_two_is_not_guessed(refusal: Callable[[str], list[str]]) -> None:
    (line,) = refusal(MPA + 'sensors = { channel_1 = "model-99" }')
    assert line.endswith("model-51 or model-52")


def test_a_model_15l_is_a_model_15(load_text: Callable[[str], Settings]) -> None:
    found = load_text(MPA + 'sensors = { channel_1 = "model-15L", channel_2 = "model-15" }')
    one, other = found.devices["basin"].profile.samples[1:]
    assert (one.message, one.points) == (other.message, other.points)
    assert one.title == "Channel 1: model-15L, suspended solids"


@pytest.mark.parametrize("address", [30001, 30007])
def test_an_address_as_the_manual_counts(
    address: int, load_text: Callable[[str], Settings]
) -> None:
    found = load_text(
        MPA + f'sensors = {{ channel_3 = "model-10" }}\naddresses = {{ channel_3 = {address} }}'
    )
    assert [str(problem) for problem in warnings(found)] == [
        (
            f"devices.basin.addresses: channel_3: address {address} is asked for as it is; a "
            f"manual that counts input registers from 30001 means address {address - 30001}"
        )
    ]


def test_two_analysers_with_one_unit(load_text: Callable[[str], Settings]) -> None:
    sensors = 'sensors = { channel_1 = "model-10" }\n'
    device = MPA[MPA.index("[devices") :] + sensors
    text = MPA + sensors + device.replace("basin", "pond")
    assert [str(problem) for problem in warnings(load_text(text))] == [
        (
            'devices.pond.unit: 3 is the unit of device "basin" on the same connection, and both '
            "read relays: one device is asked twice; where there are two, each needs its own unit"
        )
    ]
    other = MPA + sensors + device.replace("basin", "pond").replace("unit = 3", "unit = 4")
    assert warnings(load_text(other)) == []


def test_identity(loaded: Callable[[str], RegisterMap]) -> None:
    who = BLOCK.replace('"level"', '"who"').replace("100", "10") + 'read = "once"\n' + points(LEVEL)
    found = loaded('identity = ["who.level"]\n' + BLOCK + points(LEVEL) + who)
    assert found.identity == (("who", "level"),)

"""What a register map cannot say: every mistake is found, and all of them at once."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from typing import Any

import pytest

from roclog.devices import PROFILES
from roclog.errors import RegisterMapError
from roclog.map_check import check_register_map
from roclog.map_check.points import RESERVED_NAMES
from roclog.register_map import (
    Block,
    Change,
    ClearOnRead,
    Counter,
    FlagAndClear,
    Point,
    RegisterMap,
    SecondsMicroseconds,
    SerialDefaults,
    SplitCalendar,
    Table,
    UnixSeconds,
    WordType,
    camel_case,
)
from roclog.schema import MISSING, SIGNATURE, sample_type

U16, U32, TEXT = WordType.U16, WordType.U32, WordType.TEXT
MM_SS = WordType.MINUTES_SECONDS


def point(name: str = "level", offset: int = 0, type_: WordType = U16, **more: Any) -> Point:
    return Point(name=name, offset=offset, type=type_, **more)


def block(*points: Point, name: str = "tank", **more: Any) -> Block:
    given = {"table": Table.HOLDING_REGISTERS, "address": 100, "count": 10, **more}
    return Block(name=name, points=points or (point(),), **given)


def device(*samples: Block, **more: Any) -> RegisterMap:
    given = {
        "name": "tank-1",
        "title": "Tank",
        "source": "a manual",
        "unit": 1,
        "serial": SerialDefaults(baudrate=9600),
        "answer_limit": 1_000_000,
        **more,
    }
    return RegisterMap(samples=samples or (block(),), **given)


def packed(*points: Point, **more: Any) -> Block:
    """A structure of 10 octets."""
    return block(*points, packed=True, **more)


def flagged(**more: Any) -> Block:
    trigger = FlagAndClear(**{"flag": 9, "payload": ((0, 2),), **more})
    return block(trigger=trigger)


def facts(unit: str = "s", type_: WordType = MM_SS) -> tuple[Block, ...]:
    return (block(point("period", 0, type_, unit=unit), name="setup"),)


def line(**more: Any) -> RegisterMap:
    return device(serial=SerialDefaults(**{"baudrate": 9600, **more}))


def calendar(*offsets: int) -> SplitCalendar:
    year, month_day, hour, minute_second = offsets
    return SplitCalendar(year=year, month_day=month_day, hour=hour, minute_second=minute_second)


def many(last: Point) -> Block:
    return block(*(point(f"p{n}", n) for n in range(64)), last, count=65)


MISTAKES = {
    "map named in capitals": (device(name="Tank"), "name: must be lower case"),
    "map without a name": (device(name=""), "name: must be lower case"),
    "unit": (device(unit=256), "unit: 256 is not 0 to 255"),
    "answer limit": (device(answer_limit=0), "answer_limit: must be"),
    "no samples": (replace(device(), samples=()), "samples: no block"),
    "baudrate": (line(baudrate=0), "serial: must have a baudrate"),
    "seven bits": (line(bytesize=7), "serial: must have a baudrate, 8 data bits"),
    "stop bits": (line(stopbits=3), "serial: must have"),
    "parity": (line(parity="M"), "serial: parity 'M' is not"),
    "too little silence": (line(silence_characters=3.4), "serial: a silence of 3.4"),
    "silence without end": (line(silence_characters=float("inf")), "serial: a silence of inf"),
    "silence not a number": (line(silence_characters=float("nan")), "serial: a silence of nan"),
    "two flags": (
        device(flagged(), replace(flagged(), name="other")),
        "blocks tank and other: only one can have a flag",
    ),
    "flag among the facts": (
        device(facts=(replace(flagged(), name="setup"),)),
        "block setup: facts are read once",
    ),
    "too large a structure": (device(packed(count=251)), "count 251 is not 2 to 250 octets"),
    "too small a structure": (
        device(packed(point(type_=WordType.OCTETS, words=1), count=1)),
        "count 1 is not 2 to 250 octets",
    ),
    "a function beyond all": (device(packed(address=65536)), "register 65536 does not exist"),
    "a function that is no holding register": (
        device(packed(table=Table.INPUT_REGISTERS)),
        "table: a function is a holding register",
    ),
    "a flag in a structure": (
        device(packed(trigger=FlagAndClear(flag=9, payload=((0, 2),)))),
        "trigger: a function has no flag",
    ),
    "a call that clears, twice": (
        device(
            packed(trigger=ClearOnRead(table=Table.HOLDING_REGISTERS, address=100), repeatable=True)
        ),
        "repeatable: the second call would tell another sample",
    ),
    "a number behind a structure": (
        device(packed(point("a", 7, U32))),
        "point a: offset 7 with 4 octets is outside the block",
    ),
    "a shared octet": (
        device(packed(point("a", 0, U32), point("b", 3))),
        "point b: shares octet 3 with a",
    ),
    "a calendar in octets": (
        device(packed(time=calendar(0, 1, 2, 3))),
        "time: octets hold seconds",
    ),
    "microseconds behind a structure": (
        device(packed(time=SecondsMicroseconds(seconds=3, microseconds=7))),
        "time: offset 10 is outside the block",
    ),
    "microseconds in the seconds": (
        device(packed(time=SecondsMicroseconds(seconds=0, microseconds=3))),
        "time: one register is used twice",
    ),
    "a range of bytes": (
        device(block(point(type_=WordType.OCTETS, words=2, low=Decimal(0), high=Decimal(1)))),
        "bytes has no range",
    ),
    "a meaning of bytes": (
        device(block(point(type_=WordType.OCTETS, words=2, meanings=((0, "off"),)))),
        "bytes is not an enumeration",
    ),
    "block twice": (device(block(), block()), "block tank: named twice"),
    "blocks alike": (
        device(block(name="tank_1"), block(name="tank1")),
        "block tank1: differs from tank_1 only in _",
    ),
    "cycle of nothing": (device(facts=facts(), cycle=("setup", ())), "cycle: no points"),
    "identity of a sample": (
        device(identity=(("tank", "level"),)),
        "identity: no point tank.level in a block that is read once",
    ),
    "cycle of no point": (
        device(facts=facts(), cycle=("setup", ("hold",))),
        "cycle: no point setup.hold",
    ),
    "cycle of a sample": (device(cycle=("tank", ("level",))), "cycle: no point tank.level"),
    "cycle in minutes": (
        device(facts=facts("min"), cycle=("setup", ("period",))),
        "cycle: setup.period is not in seconds",
    ),
    "block name": (device(block(name="Tank")), "block Tank: name must be lower case"),
    "block name with a dash": (device(block(name="ta-nk")), "name must be lower case"),
    "block name taken": (device(block(name="gap")), "name must be lower case"),
    "empty block": (device(block(count=0)), "count 0 is not 1 to 125"),
    "large block": (device(block(count=126)), "count 126 is not 1 to 125"),
    "beyond the last register": (
        device(block(address=65530)),
        "registers 65530 to 65539 do not exist",
    ),
    "before the first register": (device(block(address=-1)), "registers -1 to 8 do not exist"),
    "no points": (device(replace(block(), points=())), "block tank: no points"),
    "point name": (device(block(point("Level"))), "'Level' cannot be a name"),
    "point name with a newline": (device(block(point("level\n"))), "cannot be a name"),
    "point name too long": (device(block(point("p" * 49))), "cannot be a name"),
    "point name taken": (device(block(point("seq"))), "'seq' cannot be a name"),
    "bit name taken": (device(block(point(bits=((0, "raw"),)))), "'raw' cannot be a name"),
    "field twice": (
        device(block(point(), point("level", 1))),
        "field level: named twice",
    ),
    "bit and point alike": (
        device(block(point("a", bits=((0, "b"),)), point("b", 1))),
        "field b: named twice",
    ),
    "fields alike in JSON": (
        device(block(point("count_1"), point("count1", 1))),
        "field count1: differs from count_1 only in _",
    ),
    "point outside": (device(block(point(offset=10))), "offset 10 with 1 words is outside"),
    "point half outside": (
        device(block(point(offset=9, type_=U32))),
        "offset 9 with 2 words is outside",
    ),
    "point before": (device(block(point(offset=-1))), "offset -1 with 1 words is outside"),
    "text without words": (
        device(facts=(block(point(type_=TEXT), name="setup"),)),
        "offset 0 with 0 words is outside",
    ),
    "words of a number": (device(block(point(words=2))), "only text and bytes have a number"),
    "shared register": (
        device(block(point("a", 0, U32), point("b", 1))),
        "point b: shares register 1 with a",
    ),
    "scale of zero": (device(block(point(scale=Decimal(0)))), "scale 0 is not a number from"),
    "endless negative scale": (
        device(block(point(scale=Decimal("-1e31")))),
        "scale -1E+31 is not a number from 1E-30 to 1E+30, with or without a minus",
    ),
    "scale not a number": (device(block(point(scale=Decimal("nan")))), "scale NaN is not"),
    "endless scale": (device(block(point(scale=Decimal("1e400")))), "scale 1E+400 is not"),
    "scaled minutes": (
        device(block(point(type_=MM_SS, scale=Decimal(2)))),
        "minutes_seconds cannot have a scale",
    ),
    "half a range": (device(block(point(low=Decimal(0)))), "low and high go together"),
    "range upside down": (
        device(block(point(low=Decimal(2), high=Decimal(1)))),
        "low 2 is above high 1",
    ),
    "endless range": (
        device(block(point(low=Decimal(0), high=Decimal("inf")))),
        "0 to Infinity is not a range",
    ),
    "range not a number": (
        device(block(point(low=Decimal("nan"), high=Decimal(1)))),
        "NaN to 1 is not a range",
    ),
    "range of an endless scale": (
        device(block(point(scale=Decimal("1e999999"), low=Decimal(1), high=Decimal(9)))),
        "scale 1E+999999 is not a number",
    ),
    "range of no scale": (
        device(block(point(scale=Decimal("nan"), low=Decimal(1), high=Decimal(9)))),
        "scale NaN is not a number",
    ),
    "sentinel of an endless scale": (
        device(block(point(scale=Decimal("1e-999999"), sentinels=((Decimal("1e999"), "no"),)))),
        "sentinel 1E+999 is not a number of uint16",
    ),
    "sentinel that is no number": (
        device(block(point(sentinels=((Decimal("nan"), "no"),)))),
        "is not a number of uint16",
    ),
    "range that is never reached": (
        device(block(point(scale=Decimal("-0.1"), low=Decimal(1), high=Decimal(9)))),
        "1 to 9 is never reached, since this uint16 is from -6553.5 to 0",
    ),
    "meaning of no number": (
        device(block(point(meanings=((0x1FFFF, "none"),)))),
        "131071 is never the value, uint16 is from 0 to 65535",
    ),
    "range of a text": (
        device(
            facts=(
                block(point(type_=TEXT, words=1, low=Decimal(0), high=Decimal(1)), name="setup"),
            )
        ),
        "text has no range",
    ),
    "too many ranges": (
        device(many(point("last", 64, low=Decimal(0), high=Decimal(1)))),
        "point last: only the first 64 points",
    ),
    "too many types with illegal words": (
        device(many(point("last", 64, MM_SS))),
        "point last: only the first 64 points",
    ),
    "bit outside": (device(block(point(bits=((16, "b"),)))), "bit 16 is outside 16 bits"),
    "bit below": (device(block(point(bits=((-1, "b"),)))), "bit -1 is outside 16 bits"),
    "bit twice": (device(block(point(bits=((1, "b"), (1, "c"))))), "bit 1: named twice"),
    "bits of a scaled value": (
        device(block(point(bits=((1, "b"),), scale=Decimal("0.1")))),
        "bits need an unscaled unsigned integer",
    ),
    "bits of minutes": (
        device(block(point(type_=MM_SS, bits=((1, "b"),)))),
        "bits need an unscaled unsigned integer",
    ),
    "two meanings": (device(block(point(meanings=((0, "a"), (0, "b"))))), "0: two meanings"),
    "order of no point": (
        device(block(must_not_increase=("ghost",))),
        "must_not_increase: ghost is not a 32-bit point",
    ),
    "order of a 16-bit point": (
        device(block(must_not_increase=("level",))),
        "must_not_increase: level is not a 32-bit point",
    ),
    "time outside": (device(block(time=calendar(1, 2, 3, 10))), "time: offset 10 is outside"),
    "time twice": (device(block(time=calendar(1, 2, 3, 3))), "time: one register is used twice"),
    "flag outside": (device(flagged(flag=10)), "flag: offset 10 is outside the block"),
    "flag is a point": (device(flagged(flag=0)), "point level: shares register 0 with the flag"),
    "flag that clears to itself": (device(flagged(new=0)), "new and clear are the same value"),
    "flag of 17 bits": (device(flagged(new=0x10000)), "new and clear must fit 16 bits"),
    "flag below zero": (device(flagged(clear=-1)), "new and clear must fit 16 bits"),
    "flag in input registers": (
        device(replace(flagged(), table=Table.INPUT_REGISTERS)),
        "only a holding register can be cleared",
    ),
    "no payload": (device(flagged(payload=())), "payload: empty"),
    "payload of nothing": (device(flagged(payload=((2, 0),))), "payload: 0 words from offset 2"),
    "payload outside": (device(flagged(payload=((5, 6),))), "payload: offset 10 is outside"),
    "coils of words": (device(block(table=Table.COILS)), "uint16 is not a type of coils"),
    "too many coils": (
        device(block(point(type_=WordType.BIT), table=Table.COILS, count=2001)),
        "count 2001 is not 1 to 2000 bits",
    ),
    "text longer than an answer": (
        device(block(point(type_=TEXT, words=126), count=300, atomic=False)),
        "126 registers are longer than an answer, 125 registers",
    ),
    "time longer than an answer": (
        device(block(count=300, atomic=False, time=calendar(1, 2, 3, 200))),
        "time: offsets 1 to 200 do not fit one answer",
    ),
    "time and text longer than an answer": (
        device(
            block(
                point(offset=100, type_=TEXT, words=90),
                count=300,
                atomic=False,
                time=calendar(1, 2, 3, 101),
            )
        ),
        "time: offsets 1 to 189 do not fit one answer",
    ),
    "counter in several requests": (
        device(block(count=126, atomic=False, trigger=Counter(point="level"))),
        "a block with a trigger must be read in one request, at most 125 registers, not 126",
    ),
    "change in several requests": (
        device(
            block(
                point(type_=WordType.BIT),
                table=Table.COILS,
                count=2001,
                atomic=False,
                trigger=Change(),
            )
        ),
        "a block with a trigger must be read in one request, at most 2000 bits, not 2001",
    ),
    "block beyond a sample": (
        device(block(count=8001, atomic=False, address=0)),
        "count 8001 is not 1 to 8000 registers",
    ),
    "period of nothing": (device(block(period=0)), "period: 0 ns is not more than nothing"),
    "message name": (device(block(message="A b")), "message 'A b' must be lower case"),
    "message of two forms": (
        device(block(message="m"), block(point("other"), name="other", message="m")),
        "block other: the message m of tank has other fields",
    ),
    "part of nothing": (
        device(block(point(parts=((4, 0, "mode"),)))),
        "mode: bits 4 to 3 are not 1 to 32 of 16",
    ),
    "part and bit": (
        device(block(point(bits=((4, "b"),), parts=((4, 2, "mode"),)))),
        "bit 4: named twice",
    ),
    "too many that can be missing": (
        device(many(point("last", 64, WordType.BCD16))),
        "only the first 64 points of a block can have a range or be missing",
    ),
    "cycle that can be missing": (
        device(
            facts=(block(point("period", 0, WordType.BCD16, unit="s"), name="setup"),),
            cycle=("setup", ("period",)),
        ),
        "cycle: setup.period can be missing",
    ),
    "time among coils": (
        device(block(point(type_=WordType.BIT), table=Table.COILS, time=UnixSeconds(offset=0))),
        "time: bits hold no time",
    ),
    "payload with the flag": (device(flagged(payload=((8, 2),))), "payload: contains the flag"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes(mistake: str) -> None:
    register_map, text = MISTAKES[mistake]
    with pytest.raises(RegisterMapError) as caught:
        check_register_map(register_map)
    assert any(text in problem for problem in caught.value.problems), caught.value.problems


def test_all_mistakes_are_told_at_once() -> None:
    bad = device(
        block(point("Level", scale=Decimal(0)), address=-1, name="Tank"),
        name="Tank",
        unit=300,
    )
    with pytest.raises(RegisterMapError) as caught:
        check_register_map(bad)
    assert len(caught.value.problems) == 6
    assert str(caught.value).count("\n") == 5
    assert all(text.startswith("register map Tank: ") for text in str(caught.value).splitlines())


def test_a_map_without_mistakes() -> None:
    check_register_map(device())
    check_register_map(device(flagged(), block(name="other")))
    check_register_map(device(facts=facts(), cycle=("setup", ("period",)), unit=0))
    check_register_map(device(block(address=65526), block(address=0, count=1, name="first")))
    check_register_map(device(many(point("last", 64))))


def test_no_field_of_a_sample_can_be_hidden_by_a_point() -> None:
    own = [field for field in sample_type("x", block()).fields if field.number < 16]
    assert {field.name for field in (*SIGNATURE, MISSING, *own)} <= RESERVED_NAMES


def test_blocks_by_name() -> None:
    roc = PROFILES["hiac-roc"]
    assert [b.name for b in roc.blocks] == ["identity", "configuration", "sample"]
    assert roc.block("sample") is roc.samples[0]
    with pytest.raises(KeyError):
        roc.block("ghost")


def test_tables_and_their_functions() -> None:
    assert (Table.COILS.read_function, Table.DISCRETE_INPUTS.read_function) == (1, 2)
    assert [table.has_bits for table in Table] == [True, True, False, False]
    assert Table.HOLDING_REGISTERS.read_function == 3
    assert Table.INPUT_REGISTERS.read_function == 4


def test_camel_case() -> None:
    assert camel_case("iso_code_1") == "IsoCode1"
    assert camel_case("a1b") == "A1b"

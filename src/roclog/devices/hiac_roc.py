"""HIAC ROC particle counter, also sold as Filtertechnik.

Source: "MODBUS Serial Communications Protocol", first draft, 27 March 2012. Register numbers there
are PDU addresses. What the document leaves open, and what is done:

- 32-bit word order is not stated: high word first by default, ``word_order`` changes it. The
  reserved bits of the alarms, the range of the counts and their order are watched.
- Sizes of the four counters are not stated: the counts are numbered, not named by size.
- Three idle rules are given (4-5 ms, 3.5 characters, "minimum 5 characters"): 5 characters.
- 110-113 say "0-29" and "1-digit implied decimal" and depend on 107: the integers are kept, and
  what either reading allows may be written. Under 107 = 0 no range is given, nor under NAS for
  112 and 113.
- 101-104 (the counter's clock) are R/W with write ranges, and "unused": they may be set when they
  are asked for by name, and people are told. Their zone is not stated: UTC, as of 301-304.
- When a written node ID (100) takes effect is not stated, nor whether 0x5A is needed first.
- 301-304 "read returns 0": used as device time only when they are not zero.
- Counts reach 2,500,000 per mL after scaling; that is the edge of the highest ISO code.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Final

from roclog.register_map import (
    Block,
    FlagAndClear,
    Point,
    RegisterMap,
    SerialDefaults,
    SplitCalendar,
    Table,
    WordType,
)
from roclog.register_map.writable import RESET, SAVE, Command, Range, Reading, Setting, Writable

_HUNDREDTH: Final = Decimal("0.01")
_TENTH: Final = Decimal("0.1")
_CLASSES: Final = ((-2, "000"), (-1, "00"), (13, "> 12"))
_LIMITS: Final = ((-3, "none"), (-2, "000"), (-1, "00"))


def _text(name: str, offset: int, words: int, title: str) -> Point:
    return Point(name=name, offset=offset, type=WordType.TEXT, words=words, title=title)


def _class(name: str, offset: int, title: str, low: int) -> Point:
    return Point(
        name=name,
        offset=offset,
        type=WordType.S16,
        low=Decimal(low),
        high=Decimal(13),
        meanings=tuple(pair for pair in _CLASSES if pair[0] >= low),
        title=title,
    )


IDENTITY: Final = Block(
    name="identity",
    table=Table.HOLDING_REGISTERS,
    address=0,
    count=48,
    title="Identification block, registers 0-47",
    points=(
        _text("manufacturer", 0, 15, "Manufacturer ID"),
        _text("model", 15, 10, "Model number"),
        _text("serial_number", 25, 5, "Serial number"),
        _text("sensor_id", 30, 4, "Sensor ID"),
        Point(
            name="calibration_year", offset=34, type=WordType.U16, title="Last calibration, unused"
        ),
        Point(
            name="calibration_day",
            offset=35,
            type=WordType.MONTH_DAY,
            title="Month and day, unused",
        ),
        Point(name="calibration_due_year", offset=36, type=WordType.U16, title="Due, unused"),
        Point(name="calibration_due_day", offset=37, type=WordType.MONTH_DAY, title="Due, unused"),
        Point(
            name="firmware_version",
            offset=38,
            type=WordType.U16,
            scale=_HUNDREDTH,
            title="Counter firmware, 100 = V1.00",
        ),
        Point(
            name="hardware_version",
            offset=39,
            type=WordType.U16,
            scale=_HUNDREDTH,
            title="Hardware, 100 = V1.00",
        ),
        _text("firmware_number", 41, 7, "Firmware number and revision"),
    ),
)

CONFIGURATION: Final = Block(
    name="configuration",
    table=Table.HOLDING_REGISTERS,
    address=100,
    count=14,
    title="Configuration block, registers 100-113",
    points=(
        Point(
            name="node_id",
            offset=0,
            type=WordType.U16,
            low=Decimal(1),
            high=Decimal(247),
            title="Node ID",
        ),
        Point(name="date_year", offset=1, type=WordType.U16, title="Counter date, unused"),
        Point(name="date_day", offset=2, type=WordType.MONTH_DAY, title="Counter date, unused"),
        Point(
            name="time_hour", offset=3, type=WordType.U16, unit="h", title="Counter time, unused"
        ),
        Point(
            name="time_minute", offset=4, type=WordType.MINUTES_SECONDS, unit="s", title="Unused"
        ),
        Point(
            name="sample_period",
            offset=5,
            type=WordType.MINUTES_SECONDS,
            unit="s",
            low=Decimal(5),
            high=Decimal(3599),
            title="Sample period, 00:05 to 59:59",
        ),
        Point(
            name="hold_period",
            offset=6,
            type=WordType.MINUTES_SECONDS,
            unit="s",
            low=Decimal(2),
            high=Decimal(3599),
            title="Hold period, 00:02 to 59:59",
        ),
        Point(
            name="alarm_trigger",
            offset=7,
            type=WordType.U16,
            low=Decimal(0),
            high=Decimal(3),
            meanings=((0, "system status"), (1, "ISO"), (2, "NAS"), (3, "SAE")),
            title="Alarm relay trigger; gives 110-113 their meaning",
        ),
        Point(
            name="alarm_direction",
            offset=8,
            type=WordType.U16,
            low=Decimal(0),
            high=Decimal(1),
            meanings=((0, "clean to dirty"), (1, "dirty to clean")),
            title="Alarm relay direction",
        ),
        Point(
            name="alarm_logic",
            offset=9,
            type=WordType.U16,
            low=Decimal(0),
            high=Decimal(1),
            meanings=((0, "active closed"), (1, "active open")),
            title="Alarm relay control logic",
        ),
        *(
            Point(name=f"limit_{n}", offset=9 + n, type=WordType.S16, meanings=_LIMITS, title=title)
            for n, title in enumerate(
                (
                    "ISO/SAE channel 1 limit, or NAS channels 2-3",
                    "ISO/SAE channel 2 limit, or NAS channels 3-4",
                    "ISO/SAE channel 3 limit",
                    "ISO/SAE channel 4 limit",
                ),
                start=1,
            )
        ),
    ),
)

SAMPLE: Final = Block(
    name="sample",
    table=Table.HOLDING_REGISTERS,
    address=300,
    count=27,
    title="Sample data block, registers 300-326",
    trigger=FlagAndClear(flag=0, new=1, clear=0, payload=((5, 1), (8, 18))),
    time=SplitCalendar(year=1, month_day=2, hour=3, minute_second=4),
    must_not_increase=("count_1", "count_2", "count_3", "count_4"),
    points=(
        *(
            Point(
                name=f"count_{n}",
                offset=6 + 2 * n,
                type=WordType.U32,
                scale=_HUNDREDTH,
                unit="1/mL",
                low=Decimal(0),
                high=Decimal(2_500_000),
                title=f"Size {n} counts",
            )
            for n in range(1, 5)
        ),
        *(
            Point(
                name=f"iso_code_{n}",
                offset=15 + n,
                type=WordType.U16,
                scale=_TENTH,
                low=Decimal(0),
                high=Decimal(29),
                meanings=((0, "< 1"), (29, "> 28.9")),
                title=f"ISO code channel {n}",
            )
            for n in range(1, 5)
        ),
        _class("nas_class_2_3", 20, "NAS class channels 2-3", -1),
        _class("nas_class_3_4", 21, "NAS class channels 3-4", -1),
        *(_class(f"sae_class_{n}", 21 + n, f"SAE class channel {n}", -2) for n in range(1, 5)),
        Point(
            name="temperature",
            offset=26,
            type=WordType.S16,
            scale=_TENTH,
            unit="Cel",
            low=Decimal(-30),
            high=Decimal("99.9"),
            title="Temperature",
        ),
        Point(
            name="sample_period",
            offset=5,
            type=WordType.MINUTES_SECONDS,
            unit="s",
            low=Decimal(0),
            high=Decimal(3599),
            title="Sample period",
        ),
        Point(
            name="alarms",
            offset=6,
            type=WordType.U32,
            title="Sample status alarms, registers 306-307",
            low=Decimal(0),
            high=Decimal(0xFFF),
            bits=(
                (0, "laser_current_low"),
                (1, "laser_current_high"),
                (2, "photo_diode_power_low"),
                (3, "photo_diode_power_high"),
                (4, "temperature_low"),
                (5, "temperature_high"),
                (6, "concentration_low"),
                (7, "concentration_high"),
                (8, "channel_1_alarm"),
                (9, "channel_2_alarm"),
                (10, "channel_3_alarm"),
                (11, "channel_4_alarm"),
            ),
        ),
    ),
)

_NONE: Final = -3
_ISO: Final = Range(when=1, name="ISO", low=Decimal(0), high=Decimal(29), numbers=(_NONE,))
_NAS: Final = Range(when=2, name="NAS", low=Decimal(0), high=Decimal(12), numbers=(_NONE, -1))
_SAE: Final = Range(when=3, name="SAE", low=Decimal(0), high=Decimal(12), numbers=(_NONE, -2, -1))
_READINGS: Final = (
    Reading(name="in whole numbers", factor=Decimal(1)),
    Reading(name="in tenths", factor=_TENTH),
)
_UNUSED: Final = "the document calls registers 101-104, the clock, unused: it may not run"


def _clock(point: str, low: int, high: int) -> Setting:
    return Setting(point=point, low=Decimal(low), high=Decimal(high), remark=_UNUSED)


def _limit(point: str, *ranges: Range) -> Setting:
    remark = (
        'the document says "0-29" and "1-digit implied decimal" of registers 110-113: both readings'
        " are shown; alarm_trigger (107) says which of ISO, NAS and SAE they are"
    )
    return Setting(
        point=point, selector="alarm_trigger", ranges=ranges, readings=_READINGS, remark=remark
    )


WRITABLE: Final = Writable(
    block="configuration",
    settings=(
        Setting(point="node_id"),
        _clock("date_year", 2000, 2100),
        _clock("date_day", 101, 1231),
        _clock("time_hour", 0, 23),
        _clock("time_minute", 0, 3599),
        Setting(point="sample_period"),
        Setting(point="hold_period"),
        Setting(point="alarm_trigger"),
        Setting(point="alarm_direction"),
        Setting(point="alarm_logic"),
        _limit("limit_1", _ISO, _NAS, _SAE),
        _limit("limit_2", _ISO, _NAS, _SAE),
        _limit("limit_3", _ISO, _SAE),
        _limit("limit_4", _ISO, _SAE),
    ),
    unit="node_id",
    clock=("date_year", "date_day", "time_hour", "time_minute"),
    commands=(
        Command(name=SAVE, address=1102, value=0x5A),
        Command(name=RESET, address=1101, value=0x55, answers=False),
    ),
)

REGISTER_MAP: Final = RegisterMap(
    name="hiac-roc",
    title="HIAC ROC / Filtertechnik particle counter",
    source="MODBUS Serial Communications Protocol, first draft, 2012-03-27",
    unit=138,
    serial=SerialDefaults(baudrate=9600, silence_characters=5),
    answer_limit=500_000_000,
    facts=(IDENTITY, CONFIGURATION),
    samples=(SAMPLE,),
    cycle=("configuration", ("sample_period", "hold_period")),
    identity=tuple(("identity", name) for name in ("manufacturer", "model", "serial_number")),
    writable=WRITABLE,
)

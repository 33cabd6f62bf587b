"""Hach Met One 6000 air particle counter.

Source: Met One 6000 Series User Manual, Appendix A "Modbus register maps", tables 16, 17, 19, 20
and 22 (pages 53 to 57 of the document): https://www.manualslib.com/manual/2889531/
Its addresses are PDU addresses. What it leaves open:

- The order of the two registers of a 32-bit number: high word first is assumed.
- The table: holding registers, since some of them can be written.
- How the line is set when the instrument is delivered: 19200 Bd 8N1 and unit 1 are assumed.
- How long it may take to answer: a second is assumed.
"""

from __future__ import annotations

from decimal import Decimal
from typing import TYPE_CHECKING, Any, Final

from roclog.register_map import (
    Block,
    Change,
    Point,
    RegisterMap,
    SerialDefaults,
    SplitCalendar,
    Table,
    WordType,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

_TENTH: Final = Decimal("0.1")
_HUNDREDTH: Final = Decimal("0.01")


def _word(name: str, offset: int, **more: Any) -> Point:
    return Point(name=name, offset=offset, type=WordType.U16, **more)


def _text(name: str, offset: int, words: int, title: str) -> Point:
    return Point(name=name, offset=offset, type=WordType.TEXT, words=words, title=title)


def _month_day(name: str, offset: int, title: str) -> Point:
    return Point(name=name, offset=offset, type=WordType.MONTH_DAY, title=title)


def _counts() -> Iterator[Point]:
    for size in range(1, 5):
        offset, title = 9 + 2 * size, f"Size {size} counts"
        yield Point(name=f"count_{size}", offset=offset, type=WordType.U32, title=title)


IDENTITY: Final = Block(
    name="identity",
    title="Identity, registers 0-39",
    table=Table.HOLDING_REGISTERS,
    address=0,
    count=40,
    points=(
        _text("manufacturer", 0, 15, "Manufacturer ID"),
        _text("model", 15, 10, "Model number"),
        _text("serial_number", 25, 5, "Serial number"),
        _text("sensor_id", 30, 4, "Sensor ID"),
        _word("calibration_year", 34, unit="a"),
        _month_day("calibration_day", 35, "Month * 100 + day"),
        _word("calibration_due_year", 36, unit="a"),
        _month_day("calibration_due_day", 37, "Month * 100 + day"),
        _word("firmware_version", 38, scale=_HUNDREDTH, title="0.01 to 0.26 are letters A to Z"),
        _word("hardware_version", 39, scale=_HUNDREDTH, title="Hardware version"),
    ),
)

SAMPLE: Final = Block(
    name="sample",
    title="Buffered record, registers 500-552",
    table=Table.HOLDING_REGISTERS,
    address=500,
    count=48,
    trigger=Change(payload=((0, 4),)),  # a new record has another time
    time=SplitCalendar(year=0, month_day=1, hour=2, minute_second=3),
    points=(
        _word("year", 0, unit="a", low=Decimal(2000), high=Decimal(9999)),
        _month_day("day", 1, "Month * 100 + day"),
        _word("hour", 2, unit="h", low=Decimal(0), high=Decimal(23)),
        Point(name="time", offset=3, type=WordType.MINUTES_SECONDS, unit="s", title="In the hour"),
        _word("period_hours", 4, unit="h", low=Decimal(0), high=Decimal(23)),
        Point(
            name="period",
            offset=5,
            type=WordType.MINUTES_SECONDS,
            unit="s",
            title="Beside the hours",
        ),
        Point(name="volume", offset=7, type=WordType.U32, title="Sample volume"),
        _word("status", 9, title="Bits as in table 20 of the manual"),
        *_counts(),
        _word("flow", 43, unit="mV"),
        Point(
            name="temperature",
            offset=44,
            type=WordType.S16,
            scale=_TENTH,
            unit="Cel",
            title="External probe",
        ),
        _word("humidity", 45, scale=_TENTH, unit="%", title="External probe"),
        _word("calibration", 47, unit="mV"),
    ),
)

REGISTER_MAP: Final = RegisterMap(
    name="met-one-6000",
    title="Hach Met One 6000 air particle counter",
    source="Hach Met One 6000 Series User Manual, Appendix A",
    unit=1,
    serial=SerialDefaults(baudrate=19200, is_documented=False),
    answer_limit=1_000_000_000,
    samples=(SAMPLE,),
    facts=(IDENTITY,),
    identity=(("identity", "model"), ("identity", "serial_number")),
)

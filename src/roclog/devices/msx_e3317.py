"""ADDI-DATA MSX-E3317 pressure measurement module, Ethernet.

Source: "MODBUS interface description" of the MSX-E3317, revision 5058-1014. A register is a
function of the module: word counts are exact, and nothing is read from the register behind it.
What the document leaves open, and what is done:

- Of the functions below 1000 and from 1000 on that do the same, those from 1000 on are called, as
  the document recommends; their answers are those of the standard.
- 15300 (AcquisitionAutoRefreshGetValues) and the functions that are only listed by number have no
  documented layout: they are not called, unless a configuration declares one.
- Which functions may be called again is not given. Those below tell something and are declared to
  change nothing: each is called when its period is over, GetModuleType at the start and after an
  outage, at most once a minute. A lost answer never makes a call: the next one on schedule does.
- TestCustomerID hands out key material: it is not called.
- Signs are not given: numbers are unsigned, like the names (ul...) say, but for the status, whose
  documented values are negative.
- What the numbers of a calibration status, a channel type and a position mean is not given: they
  are kept as they are. The reference value has no unit.
- How long an answer may take is not given: the vendor's client waits 5 s.
- Port 512, units 0 and 1 and the byte order that the module's web page offers: the vendor's client.
  With byte order "little" the words of a number are found as DCBA; text is the same in both.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Final

from roclog.modbus.dialect import MSX_E
from roclog.register_map import (
    Block,
    Point,
    RegisterMap,
    SecondsMicroseconds,
    SerialDefaults,
    Table,
    WordType,
)

_MINUTE: Final = 60 * 10**9
_CHANNELS: Final = 16
"""Places in the arrays of AcquisitionGetChannelsInfo."""


def _number(name: str, offset: int, title: str, type_: WordType = WordType.U32) -> Point:
    return Point(name=name, offset=offset, type=type_, title=title)


def _function(
    name: str,
    register: int,
    count: int,
    points: tuple[Point, ...],
    title: str,
    *,
    time: SecondsMicroseconds | None = None,
    period: int | None = None,
    is_clock: bool = False,
) -> Block:
    return Block(
        name=name,
        table=Table.HOLDING_REGISTERS,
        address=register,
        count=count,
        points=points,
        title=title,
        time=time,
        period=period,
        is_clock=is_clock,
    )


COMMAND_STATUS: Final = _function(
    "command_status",
    10000,
    54,
    (
        _number("return_value", 0, "0 = done, -100 = see errno", WordType.S32),
        _number("errno", 2, "Error number of the module's system"),
        Point(name="text", offset=4, type=WordType.TEXT, words=50, title="Error text"),
    ),
    "GetLastCommandStatusEx: asked for after a refusal, never on schedule",
)

MODULE_TYPE: Final = _function(
    "module_type",
    10200,
    100,
    (Point(name="module_type", offset=0, type=WordType.TEXT, words=100, title="Type of module"),),
    "MXCommon__GetModuleTypeEx",
)

CLOCK: Final = _function(
    "clock",
    10500,
    4,
    (
        Point(name="seconds", offset=0, type=WordType.U32, unit="s", title="Since 1970 (tv_sec)"),
        Point(
            name="microseconds",
            offset=2,
            type=WordType.U32,
            unit="us",
            low=Decimal(0),
            high=Decimal(999_999),
            title="Of the second (tv_usec)",
        ),
    ),
    "MXCommon__GetTimeEx",
    time=SecondsMicroseconds(seconds=0, microseconds=2),
    is_clock=True,
)

PRESSURE_CHANNELS: Final = _function(
    "pressure_channels",
    21000,
    2,
    (_number("channels", 0, "Number of pressure channels"),),
    "MSXE3317__PressureGetNumberOfChannels",
    period=_MINUTE,
)

CALIBRATION: Final = _function(
    "calibration_status",
    21150,
    8,
    (
        _number("status", 0, "Status of the calibration"),
        _number("channel", 2, "Channel being calibrated"),
        _number("reference", 4, "Reference value", WordType.F32),
        _number("digital_value", 6, "Digital value"),
    ),
    "MSXE3317__PressureCalibrationGetCurrentStatus",
)

ACQUISITION_CHANNELS: Final = _function(
    "acquisition_channels",
    15000,
    2,
    (
        Point(
            name="channels",
            offset=0,
            type=WordType.U32,
            low=Decimal(0),
            high=Decimal(_CHANNELS),
            title="Number of acquisition channels",
        ),
    ),
    "MSXE3317__AcquisitionGetNumberOfChannels",
    period=_MINUTE,
)

CHANNELS_INFO: Final = _function(
    "channels_info",
    15050,
    96,
    tuple(
        _number(f"{name}_{n + 1}", 2 * (_CHANNELS * array + n), f"{title}, place {n + 1}")
        for array, (name, title) in enumerate(
            (
                ("type", "Channel type"),
                ("hardware_position", "Hardware position"),
                ("channel_index", "Channel index"),
            )
        )
        for n in range(_CHANNELS)
    ),
    "MSXE3317__AcquisitionGetChannelsInfo",
    period=_MINUTE,
)

REGISTER_MAP: Final = RegisterMap(
    name="msx-e3317",
    title="ADDI-DATA MSX-E3317 pressure measurement module",
    source="MODBUS interface description of the MSX-E3317, revision 5058-1014",
    unit=1,
    port=512,
    dialect=MSX_E,
    has_serial_port=False,
    serial=SerialDefaults(baudrate=9600, is_documented=False),
    answer_limit=5_000_000_000,
    facts=(MODULE_TYPE,),
    identity=(("module_type", "module_type"),),
    samples=(CLOCK, CALIBRATION, PRESSURE_CHANNELS, ACQUISITION_CHANNELS, CHANNELS_INFO),
)

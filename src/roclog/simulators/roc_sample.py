"""One completed sample of the simulated HIAC ROC: its values, its registers, its line of truth.

Source: MODBUS Serial Communications Protocol of the device, section 4.0, "Sample Data Block" and
"Sample Status Alarm Bit Wise Map".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from roclog.simulators import roc_settings
from roclog.simulators.cleanliness import (
    ISO_ABOVE_RANGE,
    iso_code_tenths,
    nas_class,
    sae_class,
)
from roclog.simulators.roc_settings import CHANNELS, NAS_LIMITS, Direction, Trigger

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from roclog.simulators.oil import Measurement

SAMPLE_BLOCK: Final = range(300, 327)
MOST_HUNDREDTHS: Final = 250_000_000

LASER_CURRENT_MA: Final = (30.0, 73.0)
PHOTO_DIODE_POWER_V: Final = (4.50, 4.90)
TEMPERATURE_TENTHS: Final = (-100, 600)
LOW_CONCENTRATION_TENTHS: Final = 50

ALARM_NAMES: Final = (
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
"""Alarms in the order of their bits, 0 to 11."""

TRUTH_COLUMNS: Final = (
    "sample",
    *(f"count_{size}" for size in range(1, 5)),
    *(f"iso_code_{size}" for size in range(1, 5)),
    "nas_class_2_3",
    "nas_class_3_4",
    *(f"sae_class_{size}" for size in range(1, 5)),
    "temperature",
    "sample_period",
    "alarms",
    *ALARM_NAMES,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RocSample:
    """A sample in the resolution of the device.

    `counts` in hundredths per mL, `iso_codes` and `temperature` in tenths, `period_s` in seconds,
    `alarms` in the order of `ALARM_NAMES`.
    """

    counts: tuple[int, ...]
    iso_codes: tuple[int, ...]
    nas_classes: tuple[int, ...]
    sae_classes: tuple[int, ...]
    temperature: int
    period_s: int
    alarms: tuple[bool, ...]

    @classmethod
    def of(
        cls, measurement: Measurement, *, period_s: int, settings: Mapping[int, int]
    ) -> RocSample:
        """Evaluate a measurement with the configuration (registers 100-113) of that moment.

        Codes and classes follow from the counts in full; only what goes into the count registers
        is limited to 2,500,000 per mL, so a code above 27.9 can stand beside a full count.
        """
        per_100_ml = [round(100 * count) for count in measurement.counts_per_ml]
        iso_codes = tuple(iso_code_tenths(count) for count in per_100_ml)
        nas_classes = tuple(
            nas_class(index, per_100_ml[index + 1] - per_100_ml[index + 2])
            for index in range(NAS_LIMITS)
        )
        sae_classes = tuple(sae_class(size, count) for size, count in enumerate(per_100_ml))
        temperature = max(-300, min(round(10 * measurement.temperature_cel), 999))
        alarms = (
            *_outside(measurement.laser_current_ma, LASER_CURRENT_MA),
            *_outside(measurement.photo_diode_power_v, PHOTO_DIODE_POWER_V),
            *_outside(temperature, TEMPERATURE_TENTHS),
            iso_codes[0] < LOW_CONCENTRATION_TENTHS,
            iso_codes[0] >= ISO_ABOVE_RANGE,
            *_channel_alarms(settings, iso_codes, nas_classes, sae_classes),
        )
        return cls(
            counts=tuple(min(count, MOST_HUNDREDTHS) for count in per_100_ml),
            iso_codes=iso_codes,
            nas_classes=nas_classes,
            sae_classes=sae_classes,
            temperature=temperature,
            period_s=period_s,
            alarms=alarms,
        )

    @property
    def alarm_bits(self) -> int:
        """The 32-bit value of registers 306-307."""
        return sum(1 << bit for bit, is_set in enumerate(self.alarms) if is_set)

    def words(self, *, is_high_word_first: bool) -> dict[int, int]:
        """Give registers 300-326 as they are just after completion: flag up, time stamp zero."""
        words = dict.fromkeys(SAMPLE_BLOCK, 0)
        words[300] = 1
        words[305] = self.period_s // 60 << 8 | self.period_s % 60
        for address, value in zip(
            (306, 308, 310, 312, 314), (self.alarm_bits, *self.counts), strict=True
        ):
            pair = divmod(value, 0x10000)
            words[address], words[address + 1] = pair if is_high_word_first else pair[::-1]
        singles = (*self.iso_codes, *self.nas_classes, *self.sae_classes, self.temperature)
        for address, value in enumerate(singles, start=316):
            words[address] = value & 0xFFFF
        return words

    def truth_row(self, number: int) -> str:
        """Give the CSV row for `TRUTH_COLUMNS`, in physical units, without line end."""
        return ",".join(
            (
                str(number),
                *(_decimal(count, 100) for count in self.counts),
                *(_decimal(code, 10) for code in self.iso_codes),
                *map(str, self.nas_classes),
                *map(str, self.sae_classes),
                _decimal(self.temperature, 10),
                str(self.period_s),
                str(self.alarm_bits),
                *("true" if is_set else "false" for is_set in self.alarms),
            )
        )


def _outside(value: float, limits: tuple[float, float]) -> tuple[bool, bool]:
    """Tell whether a value is below its low limit, and whether it is above its high limit."""
    return value < limits[0], value > limits[1]


def _channel_alarms(
    settings: Mapping[int, int],
    iso_codes: Sequence[int],
    nas_classes: Sequence[int],
    sae_classes: Sequence[int],
) -> list[bool]:
    """Compare codes or classes with the limits, by the trigger in 107 and the direction in 108.

    Bit 8 belongs to the limit in register 110, bit 9 to 111 and so on; under NAS, bits 8 and 9 are
    the ranges 2-3 and 3-4.
    """
    match settings[roc_settings.TRIGGER]:
        case Trigger.ISO:
            tenths = list(iso_codes)
        case Trigger.NAS:
            tenths = [10 * value for value in nas_classes]
        case Trigger.SAE:
            tenths = [10 * value for value in sae_classes]
        case _:
            tenths = []
    alarms = [False] * CHANNELS
    is_falling = settings[roc_settings.DIRECTION] == Direction.DIRTY_TO_CLEAN
    for channel, value in enumerate(tenths):
        limit = roc_settings.limit_tenths(settings, channel)
        if limit is not None:
            alarms[channel] = value <= limit if is_falling else value >= limit
    return alarms


def _decimal(raw: int, divisor: int) -> str:
    """Write raw / divisor as the shortest decimal text, whole numbers bare."""
    return str(raw // divisor) if raw % divisor == 0 else repr(raw / divisor)

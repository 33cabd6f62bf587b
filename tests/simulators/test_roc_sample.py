"""One sample: alarms as the document's bit map says, registers and truth worked out by hand."""

from __future__ import annotations

import pytest

from roclog.simulators.oil import Measurement
from roclog.simulators.roc_sample import TRUTH_COLUMNS, RocSample
from roclog.simulators.roc_settings import default_words

SYS_STAT, ISO, NAS, SAE = range(4)
CLEAN_TO_DIRTY, DIRTY_TO_CLEAN = range(2)


def measurement(
    *counts: float, celsius: float = 40.0, laser: float = 50.0, photo: float = 4.7
) -> Measurement:
    one, two, three, four = counts or (80.0, 20.0, 1.3, 0.01)
    return Measurement(
        counts_per_ml=(one, two, three, four),
        temperature_cel=celsius,
        laser_current_ma=laser,
        photo_diode_power_v=photo,
    )


def sample(seen: Measurement, **settings: int) -> RocSample:
    words = default_words(138) | {int(key[1:]): word & 0xFFFF for key, word in settings.items()}
    return RocSample.of(seen, period_s=70, settings=words)


def bits(seen: Measurement, **settings: int) -> int:
    return sample(seen, **settings).alarm_bits


def test_registers_and_truth_of_a_sample_worked_out_by_hand() -> None:
    done = sample(measurement(celsius=-1.5, laser=80.0))
    words = done.words(is_high_word_first=True)
    assert list(words) == list(range(300, 327))
    assert list(words.values()) == [
        *(1, 0, 0, 0, 0, 0x010A),  # new data, no time stamp, 01:10
        *(0, 2),  # laser current high
        *(0, 8000, 0, 2000, 0, 130, 0, 1),
        *(130, 110, 70, 0),  # 12.97, 10.97, 7.02 and below 1
        *(3, 2),  # 1870 and 129 particles between the sizes
        *(4, 3, 2, 0xFFFE),
        0xFFF1,
    ]
    assert done.truth_row(7) == (
        "7,80,20,1.3,0.01,13,11,7,0,3,2,4,3,2,-2,-1.5,70,2,"
        "false,true,false,false,false,false,false,false,false,false,false,false"
    )


def test_truth_columns() -> None:
    assert ",".join(TRUTH_COLUMNS) == (
        "sample,count_1,count_2,count_3,count_4,iso_code_1,iso_code_2,iso_code_3,iso_code_4,"
        "nas_class_2_3,nas_class_3_4,sae_class_1,sae_class_2,sae_class_3,sae_class_4,"
        "temperature,sample_period,alarms,laser_current_low,laser_current_high,"
        "photo_diode_power_low,photo_diode_power_high,temperature_low,temperature_high,"
        "concentration_low,concentration_high,channel_1_alarm,channel_2_alarm,channel_3_alarm,"
        "channel_4_alarm"
    )


def test_word_order_of_32_bit_values() -> None:
    done = sample(measurement(700.0, 1.0, 1.0, 1.0))  # 70,000 hundredths = 0x00011170
    high_first = done.words(is_high_word_first=True)
    low_first = done.words(is_high_word_first=False)
    assert (high_first[308], high_first[309]) == (0x0001, 0x1170)
    assert (low_first[308], low_first[309]) == (0x1170, 0x0001)


def test_count_registers_end_at_2_500_000_per_ml_but_the_code_goes_on() -> None:
    done = sample(measurement(6_000_000.0, 1.0, 1.0, 1.0))
    words = done.words(is_high_word_first=True)
    assert (words[308], words[309]) == (0x0EE6, 0xB280)
    assert words[316] == 290
    assert words[322] == 13
    assert done.alarm_bits == 1 << 7


def test_examples_of_the_document() -> None:
    # 2 (binary 10) is Laser Current High.
    assert bits(measurement(laser=73.1)) == 2
    # 320 (binary 101000000) is Concentration Low and Channel 1 Alarm.
    clean = measurement(0.2, 0.1, 0.0, 0.0)
    assert bits(clean, r107=ISO, r108=DIRTY_TO_CLEAN, r110=50) == 320


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        (measurement(laser=29.9), 1 << 0),
        (measurement(laser=30.0), 0),
        (measurement(laser=73.0), 0),
        (measurement(photo=4.49), 1 << 2),
        (measurement(photo=4.50), 0),
        (measurement(photo=4.90), 0),
        (measurement(photo=4.91), 1 << 3),
        (measurement(celsius=-10.1), 1 << 4),
        (measurement(celsius=-10.0), 0),
        (measurement(celsius=60.0), 0),
        (measurement(celsius=60.1), 1 << 5),
        (measurement(0.31, 0.0, 0.0, 0.0), 0),  # code 5.0
        (measurement(0.30, 0.0, 0.0, 0.0), 1 << 6),  # code 4.9
    ],
)
def test_status_alarms_at_their_limits(seen: Measurement, expected: int) -> None:
    assert bits(seen) == expected


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        # ISO codes are 13.0 / 11.0 / 7.0 / 0, NAS 3 / 2, SAE 4 / 3 / 2 / 000.
        ({"r107": SYS_STAT, "r110": 290, "r111": 290}, 0),
        ({"r107": ISO}, 0),
        ({"r107": ISO, "r110": 130, "r111": 109, "r112": 70, "r113": 0}, 0b1101 << 8),
        ({"r107": ISO, "r108": CLEAN_TO_DIRTY, "r110": 130, "r111": 111}, 0b0001 << 8),
        ({"r107": NAS, "r110": 30, "r111": 19}, 0b0001 << 8),
        ({"r107": NAS, "r108": CLEAN_TO_DIRTY, "r110": 31, "r111": -1}, 0b0010 << 8),
        ({"r107": SAE, "r110": 40, "r111": 29, "r112": -1, "r113": -1}, 0b1001 << 8),
        ({"r107": SAE, "r108": CLEAN_TO_DIRTY, "r112": 20, "r113": -1}, 0b0100 << 8),
        ({"r107": NAS, "r112": 120, "r113": 120}, 0),
    ],
)
def test_channel_alarms(settings: dict[str, int], expected: int) -> None:
    assert bits(measurement(), **settings) == expected


def test_temperature_register_ends_at_its_documented_range() -> None:
    assert sample(measurement(celsius=-31.0)).temperature == -300
    assert sample(measurement(celsius=120.0)).temperature == 999

"""The oil: plausible to look at, and the same for the same generator."""

from __future__ import annotations

from itertools import pairwise
from random import Random

from roclog.simulators.oil import FILTER_OFF_PER_ML, FILTER_ON_PER_ML, Measurement, OilSystem


def take(seed: int, samples: int) -> list[Measurement]:
    oil = OilSystem(Random(seed))
    return [oil.measure(elapsed_s=15, period_s=10) for _ in range(samples)]


def test_equal_generators_give_equal_measurements() -> None:
    assert take(1, 50) == take(1, 50)
    assert take(1, 50) != take(2, 50)


def test_counts_never_increase_with_size() -> None:
    for measurement in take(3, 500):
        counts = measurement.counts_per_ml
        assert all(a >= b >= 0 for a, b in pairwise(counts))


def test_saw_tooth_is_complete_within_about_forty_samples() -> None:
    for seed in range(20):
        counts = [measurement.counts_per_ml[0] for measurement in take(seed, 50)]
        top = max(range(50), key=counts.__getitem__)
        assert counts[top] > 0.85 * FILTER_ON_PER_ML
        assert min(counts) < 1.5 * FILTER_OFF_PER_ML


def test_sensors_stay_inside_their_limits_mostly() -> None:
    samples = take(4, 2_000)
    assert all(30 < each.temperature_cel < 50 for each in samples)
    assert sum(not 30 <= each.laser_current_ma <= 73 for each in samples) < 40
    assert sum(not 4.5 <= each.photo_diode_power_v <= 4.9 for each in samples) < 40


def test_clean_oil_counts_nothing_below_zero() -> None:
    oil = OilSystem(Random(5))
    assert all(count >= 0 for count in oil.measure(elapsed_s=0, period_s=2).counts_per_ml)

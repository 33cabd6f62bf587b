"""The oil that a simulated particle counter looks at.

Wear and dust make the oil dirtier until a filter is switched on, which cleans it exponentially
until it is switched off again: a saw-tooth of about ten minutes, which is forty samples of the
default cycle. All numbers here are invented to look like a hydraulic system; none is a claim
about a device.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin, sqrt
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from random import Random

SIZES_UM: Final = (4.0, 6.0, 14.0, 21.0)
SIZE_EXPONENT: Final = -2.8

WEAR_PER_ML_S: Final = 34.0
INGRESS_INTERVAL_S: Final = 150.0
INGRESS_PER_ML: Final = (800.0, 3_500.0)
FILTER_ON_PER_ML: Final = 20_000.0
FILTER_OFF_PER_ML: Final = 2_500.0
FILTER_TIME_CONSTANT_S: Final = 40.0

FLOW_ML_PER_S: Final = 0.5
DAY_S: Final = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """What the sensors of a particle counter see in one sample.

    `counts_per_ml` are cumulative: particles above size 1, 2, 3 and 4, never increasing.
    """

    counts_per_ml: tuple[float, float, float, float]
    temperature_cel: float
    laser_current_ma: float
    photo_diode_power_v: float


class Fluid(Protocol):
    """Anything that a simulated particle counter can take a sample of."""

    def measure(self, *, elapsed_s: int, period_s: int) -> Measurement:
        """Move on by `elapsed_s` and take a sample of which the last `period_s` were counted."""


class _Wander:
    """A value that strays around its mean; one step per sample."""

    PULL: Final = 0.2

    def __init__(self, random: Random, *, mean: float, spread: float) -> None:
        self._random = random
        self._mean = mean
        self._kick = spread * sqrt(1 - (1 - self.PULL) ** 2)
        self._value = mean

    def step(self) -> float:
        self._value += self.PULL * (self._mean - self._value) + self._random.gauss(0, self._kick)
        return self._value


class OilSystem:
    """A hydraulic system with wear, ingress of dirt and an off-line filter.

    Every draw comes from `random`, so equal generators and equal calls give equal measurements.
    The laser current and the photo diode power leave their limits in well under one sample of a
    hundred.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._per_ml = random.uniform(FILTER_OFF_PER_ML, 2 * FILTER_OFF_PER_ML)
        self._is_filtering = False
        self._age_s = random.randrange(int(DAY_S))
        self._drift_cel = _Wander(random, mean=0.0, spread=0.5)
        self._laser_ma = _Wander(random, mean=52.0, spread=7.0)
        self._photo_v = _Wander(random, mean=4.70, spread=0.06)

    def measure(self, *, elapsed_s: int, period_s: int) -> Measurement:
        for _ in range(elapsed_s):
            self._live_one_second()
        return Measurement(
            counts_per_ml=self._count(FLOW_ML_PER_S * period_s),
            temperature_cel=40 + 4 * sin(2 * pi * self._age_s / DAY_S) + self._drift_cel.step(),
            laser_current_ma=self._laser_ma.step(),
            photo_diode_power_v=self._photo_v.step(),
        )

    def _live_one_second(self) -> None:
        self._age_s += 1
        self._per_ml += WEAR_PER_ML_S * self._random.uniform(0.5, 1.5)
        if self._random.random() < 1 / INGRESS_INTERVAL_S:
            self._per_ml += self._random.uniform(*INGRESS_PER_ML)
        if self._is_filtering:
            self._per_ml -= self._per_ml / FILTER_TIME_CONSTANT_S
            self._is_filtering = self._per_ml > FILTER_OFF_PER_ML
        else:
            self._is_filtering = self._per_ml > FILTER_ON_PER_ML

    def _count(self, volume_ml: float) -> tuple[float, float, float, float]:
        """Count the particles in a volume, with the scatter of counting single particles.

        The cumulative count falls as a straight line in the logarithms of count and size. The
        scatter is drawn per size range, so the sums cannot increase with size.
        """
        exact = [self._per_ml * (size / SIZES_UM[0]) ** SIZE_EXPONENT for size in SIZES_UM]
        larger = 0
        sums = []
        for above, above_next in reversed(list(zip(exact, [*exact[1:], 0.0], strict=True))):
            mean = (above - above_next) * volume_ml
            larger += max(0, round(self._random.gauss(mean, sqrt(mean))))
            sums.append(larger / volume_ml)
        return sums[3], sums[2], sums[1], sums[0]

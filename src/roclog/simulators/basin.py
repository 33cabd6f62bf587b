"""The basin that a simulated analyser looks at.

Sludge breathes the oxygen that a blower brings in, grows, and is drawn off by a pump. Both are
switched by limits: a saw-tooth of some four minutes in the oxygen, and one of about half an hour in
the solids. All numbers here are invented to look like a sewage works; none is a claim about a
device.
"""

from __future__ import annotations

from math import pi, sin
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from random import Random

BLOWER_ON_PPM: Final = 1.5
BLOWER_OFF_PPM: Final = 3.0
BLOWER_PPM_S: Final = 0.022
BREATH_PPM_S: Final = 0.010
PUMP_ON_MG_L: Final = 3_400.0
PUMP_OFF_MG_L: Final = 2_600.0
PUMP_MG_L_S: Final = 2.0
GROWTH_MG_L_S: Final = 0.6
DAY_S: Final = 86_400


class Basin:
    """What sensors in the basin measure, second by second.

    Every draw comes from `random`, so equal generators give equal basins.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._age_s = random.randrange(DAY_S)
        self._drift_cel = 0.0
        self._acid = 0.0
        self.oxygen_ppm = random.uniform(BLOWER_ON_PPM, BLOWER_OFF_PPM)
        self.solids_mg_l = random.uniform(PUMP_OFF_MG_L, PUMP_ON_MG_L)
        self.is_blown = False
        self.is_pumped = False

    @property
    def temperature_cel(self) -> float:
        return 16 + 2 * sin(2 * pi * self._age_s / DAY_S) + self._drift_cel

    @property
    def ph(self) -> float:
        return 7.1 + self._acid

    @property
    def orp_mv(self) -> float:
        """Oxidising with oxygen, reducing without."""
        return 140 * (self.oxygen_ppm - 1.9)

    def live_one_second(self) -> None:
        self._age_s += 1
        self._drift_cel += self._random.gauss(0, 0.004) - self._drift_cel / 1_000
        self._acid += self._random.gauss(0, 0.004) - self._acid / 600
        gained = BLOWER_PPM_S if self.is_blown else 0.0
        self.oxygen_ppm += gained - BREATH_PPM_S * self._random.uniform(0.5, 1.5)
        self.is_blown = self.oxygen_ppm < (BLOWER_OFF_PPM if self.is_blown else BLOWER_ON_PPM)
        drawn = PUMP_MG_L_S if self.is_pumped else 0.0
        self.solids_mg_l += GROWTH_MG_L_S - drawn + self._random.gauss(0, 2)
        self.is_pumped = self.solids_mg_l > (PUMP_OFF_MG_L if self.is_pumped else PUMP_ON_MG_L)

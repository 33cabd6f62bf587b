"""Pseudo-random sample blocks that a ROC could have produced."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from roc_map import ALARMS, FLAG, TEMPERATURE
from roc_options import rng

if TYPE_CHECKING:
    from random import Random

MOST = 250_000_000
"""2,500,000 counts/mL with two implied decimals."""

_SIZE_1 = 308
_ISO_1 = 316
_CLASSES = range(320, 326)
_TENTHS_MAX = 290


@dataclass
class Sample:
    """`registers` are 300-326; the rest is what became of the sample."""

    k: int
    registers: tuple[int, ...]
    facts: dict[str, object] = field(default_factory=dict)
    delivered: set[str] = field(default_factory=set)
    cleared: bool = False
    served: dict[bytes, str] = field(default_factory=dict)
    """Octets of 305-326 that any client was sent for it, and whether `whole` or `torn`."""


def iso_tenths(raw: int) -> int:
    """ISO 4406 by doubling: code n starts above 0.01 * 2**(n - 1) per mL; 0 is below code 1.

    So 2,500,000 per mL is 28.8 (code 28, as in the standard) and 29.0 stays for "> 28.9".
    """
    return min(_TENTHS_MAX, math.floor(10 * (math.log2(raw) + 1))) if raw else 0


def words(value: int, order: str) -> tuple[int, int]:
    octets = value.to_bytes(4, "big")
    sent = bytes(octets["ABCD".index(letter)] for letter in order)
    return int.from_bytes(sent[:2], "big"), int.from_bytes(sent[2:], "big")


def alarms(random: Random, temperature: int, iso_1: int) -> int:
    """Bits 4-7 follow temperature and code; 0-3 and 8-11 are drawn, no low with its high."""
    laser, diode = random.choice((0, 0, 1, 2)), random.choice((0, 0, 1, 2))
    bits = laser | diode << 2 | random.getrandbits(4) << 8
    bits |= (temperature < -100) << 4 | (temperature > 600) << 5  # -10.0, 60 C
    return bits | (iso_1 < 50) << 6 | (iso_1 >= 290) << 7  # codes 5.0 and 29


class SampleSource:
    """Samples 0, 1, 2, ...: a function of the seed alone. 0 is what lay there before."""

    def __init__(self, seed: int, word_order: str, period: int, identical_every: int) -> None:
        self._random = rng(seed, "samples")
        self._live = rng(seed, "live")
        self._order = word_order
        self._period = period
        self._identical_every = identical_every
        self._registers = (0,) * (TEMPERATURE + 1 - FLAG)
        self._k = -1

    def make(self) -> Sample:
        self._k += 1
        every = self._identical_every
        identical = bool(every and self._k > 1 and self._k % every == 0)
        if not identical:
            self._registers = self._draw()
        return Sample(self._k, self._registers, {"identical": True} if identical else {})

    def live(self, registers: list[int]) -> None:
        """New 306/307 and 326 into `registers` (300-326)."""
        temperature = self._temperature(self._live, registers[TEMPERATURE - FLAG])
        bits = alarms(self._live, temperature, registers[_ISO_1 - FLAG])
        registers[ALARMS - FLAG : _SIZE_1 - FLAG] = words(bits, self._order)
        registers[TEMPERATURE - FLAG] = temperature & 0xFFFF

    def _draw(self) -> tuple[int, ...]:
        random, old = self._random, self._registers
        counts, codes = self._counts(old)
        temperature = self._temperature(random, old[-1])
        bits = alarms(random, temperature, codes[0])
        classes = [self._class(address, old[address - FLAG]) for address in _CLASSES]
        values = [1, 0, 0, 0, 0, self._period, *words(bits, self._order)]
        for count in counts:
            values += words(count, self._order)
        return tuple(values + codes + classes + [temperature & 0xFFFF])

    def _counts(self, old: tuple[int, ...]) -> tuple[list[int], list[int]]:
        """Four falling counts whose low words and codes all differ from the last sample's."""
        span = slice(_SIZE_1 - FLAG, _ISO_1 - FLAG)
        code_span = slice(_ISO_1 - FLAG, _CLASSES.start - FLAG)
        low = 0 if self._order in ("CDAB", "DCBA") else 1
        while True:
            counts = [self._first_count()]
            while len(counts) < 4:  # sizes
                counts.append(int(counts[-1] * self._random.uniform(0.05, 0.9)))
            codes = [iso_tenths(count) for count in counts]
            lows = [words(count, self._order)[low] for count in counts]
            pairs = zip(lows + codes, old[span][low::2] + old[code_span], strict=True)
            if all(new != last for new, last in pairs):
                return counts, codes

    def _first_count(self) -> int:
        if self._random.random() < 0.03:
            return MOST
        return int(10 ** self._random.uniform(2, math.log10(MOST)))

    def _class(self, address: int, old: int) -> int:
        least = -1 if address < 322 else -2  # 320/321 are NAS, without class 000
        return self._random.choice([c & 0xFFFF for c in range(least, 14) if c & 0xFFFF != old])

    @staticmethod
    def _temperature(random: Random, old: int) -> int:
        """Tenths of a degree Celsius, -30.0 to 99.9."""
        while (tenths := random.randint(-300, 999)) & 0xFFFF == old:
            pass
        return tenths

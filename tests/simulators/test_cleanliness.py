"""Codes and classes against the tables that the standards print."""

from __future__ import annotations

from itertools import pairwise
from math import ceil

import pytest

from roclog.simulators.cleanliness import (
    AS4059_LIMITS,
    NAS1638_LIMITS,
    iso_code_tenths,
    nas_class,
    sae_class,
)

ISO_4406_UPPER_LIMITS = {
    # Code: particles per mL, "up to and including", as printed in ISO 4406:1999.
    1: 0.02,
    2: 0.04,
    3: 0.08,
    4: 0.16,
    5: 0.32,
    6: 0.64,
    7: 1.3,
    8: 2.5,
    9: 5,
    10: 10,
    11: 20,
    12: 40,
    13: 80,
    14: 160,
    15: 320,
    16: 640,
    17: 1_300,
    18: 2_500,
    19: 5_000,
    20: 10_000,
    21: 20_000,
    22: 40_000,
    23: 80_000,
    24: 160_000,
    25: 320_000,
    26: 640_000,
    27: 1_300_000,
    28: 2_500_000,
}


@pytest.mark.parametrize(("code", "per_ml"), ISO_4406_UPPER_LIMITS.items())
def test_iso_code_at_a_printed_limit_is_that_code_within_the_rounding_of_the_table(
    code: int, per_ml: float
) -> None:
    assert abs(iso_code_tenths(round(100 * per_ml)) / 10 - code) < 0.11


@pytest.mark.parametrize("code", range(2, 29))
def test_iso_code_between_two_printed_limits_rounds_up_to_the_printed_code(code: int) -> None:
    middle = (ISO_4406_UPPER_LIMITS[code - 1] + ISO_4406_UPPER_LIMITS[code]) / 2
    assert ceil(iso_code_tenths(round(100 * middle)) / 10) == code


@pytest.mark.parametrize(
    ("per_ml", "tenths"),
    [(0, 0), (0.01, 0), (0.02, 10), (80, 130), (1_300, 170), (2_500, 179), (4_900_000, 289)],
)
def test_iso_code_has_one_decimal_and_starts_at_one(per_ml: float, tenths: int) -> None:
    assert iso_code_tenths(round(100 * per_ml)) == tenths


def test_iso_code_above_28_9_is_29() -> None:
    assert iso_code_tenths(520_000_000) == 290
    assert iso_code_tenths(2**40) == 290


@pytest.mark.parametrize("size", range(4))
def test_sae_class_changes_just_above_each_limit(size: int) -> None:
    for index, limit in enumerate(AS4059_LIMITS[size]):
        assert sae_class(size, limit) == index - 2
        assert sae_class(size, limit + 1) == index - 1


@pytest.mark.parametrize("size_range", range(2))
def test_nas_class_changes_just_above_each_limit(size_range: int) -> None:
    for index, limit in enumerate(NAS1638_LIMITS[size_range]):
        assert nas_class(size_range, limit) == index - 1
        assert nas_class(size_range, limit + 1) == index


def test_printed_examples_of_the_standards() -> None:
    # AS4059 class 6B is 9,731 to 19,500 particles above 6 um(c).
    assert [sae_class(1, count) for count in (9_730, 9_731, 19_500, 19_501)] == [5, 6, 6, 7]
    # AS4059 7B/6C/5D: 38,900 / 3,460 / 306.
    assert [sae_class(1, 38_900), sae_class(2, 3_460), sae_class(3, 306)] == [7, 6, 5]
    # NAS 1638 class 12: 1,024,000 and 182,400.
    assert [nas_class(0, 1_024_000), nas_class(1, 182_400)] == [12, 12]


def test_each_class_allows_about_twice_the_particles_of_the_one_before() -> None:
    for row in (*AS4059_LIMITS[:3], *NAS1638_LIMITS):
        for smaller, larger in pairwise(row):
            assert 1.9 < larger / smaller < 2.1

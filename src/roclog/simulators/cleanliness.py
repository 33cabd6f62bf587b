"""Cleanliness codes and classes of hydraulic fluids, from particle counts.

Counts are integers per 100 mL, which is also a count per mL in hundredths. The four sizes of the
counter are taken as 4, 6, 14 and 21 um(c): the sizes of ISO 4406:1999 and the fourth that AS4059
adds. ISO 4406 and AS4059 look at cumulative counts (all particles above a size), NAS 1638 at the
particles between two sizes.
"""

from __future__ import annotations

from bisect import bisect_left
from math import log2
from typing import Final

ISO_BELOW_ONE: Final = 0
ISO_ONE_PER_100_ML: Final = 2
ISO_ABOVE_RANGE: Final = 290

# fmt: off
AS4059_LIMITS: Final = (
    # One row per size, 4, 6, 14 and 21 um(c); columns: class 000, 00, 0, 1 ... 12.
    (195, 390, 780, 1_560, 3_120, 6_250, 12_500, 25_000, 50_000, 100_000, 200_000, 400_000,
     800_000, 1_600_000, 3_200_000),
    (76, 152, 304, 609, 1_220, 2_430, 4_860, 9_730, 19_500, 38_900, 77_900, 156_000,
     311_000, 623_000, 1_250_000),
    (14, 27, 54, 109, 217, 432, 864, 1_730, 3_460, 6_920, 13_900, 27_700,
     55_400, 111_000, 222_000),
    (3, 5, 10, 20, 39, 76, 152, 306, 612, 1_220, 2_450, 4_900,
     9_800, 19_600, 39_200),
)

NAS1638_LIMITS: Final = (
    # One row per size range, 5-15 and 15-25 um; columns: class 00, 0, 1 ... 12.
    (125, 250, 500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 64_000, 128_000, 256_000,
     512_000, 1_024_000),
    (22, 44, 89, 178, 356, 712, 1_425, 2_850, 5_700, 11_400, 22_800, 45_600,
     91_200, 182_400),
)
# fmt: on


def iso_code_tenths(count_per_100_ml: int) -> int:
    """Give the ISO 4406:1999 code with one decimal, as the ROC reports it in 316-319.

    The upper limit of code R is 0.01 * 2**R particles per mL, hence R = log2(count / 0.01). The
    standard prints rounded limits (1,300 for code 17, 80 for 13, 2,500,000 for 28), which lie
    within 0.11 of this line.

    Returns:
        Tenths of a code, 10 to 289; 0 below code 1.0 and 290 above code 28.9.

    Source:
        ISO 4406:1999, table of scale numbers; range and limits of registers 316-319.
    """
    if count_per_100_ml < ISO_ONE_PER_100_ML:
        return ISO_BELOW_ONE
    tenths = round(10 * log2(count_per_100_ml))
    return min(tenths, ISO_ABOVE_RANGE)


def nas_class(size_range: int, count_per_100_ml: int) -> int:
    """Give the NAS 1638 class of the particles between two sizes.

    Args:
        size_range: 0 for sizes 2 to 3, 1 for sizes 3 to 4. The standard's 5, 15 and 25 um are
            6, 14 and 21 um(c) in the calibration of ISO 11171.
        count_per_100_ml: Particles in that range.

    Returns:
        -1 for class 00, 0 to 12, 13 for dirtier than class 12.

    Source:
        NAS 1638 (1964), table of maximum counts per 100 mL.
    """
    return bisect_left(NAS1638_LIMITS[size_range], count_per_100_ml) - 1


def sae_class(size: int, count_per_100_ml: int) -> int:
    """Give the AS4059 class of one size, from the cumulative table.

    Args:
        size: 0 to 3 for 4, 6, 14 and 21 um(c), which the standard calls A to D.
        count_per_100_ml: Particles larger than that size.

    Returns:
        -2 for class 000, -1 for class 00, 0 to 12, 13 for dirtier than class 12.

    Source:
        SAE AS4059, maximum cumulative counts per 100 mL.
    """
    return bisect_left(AS4059_LIMITS[size], count_per_100_ml) - 2

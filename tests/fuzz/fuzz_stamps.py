"""Any octets, zones and host times against the decoder of stamps, for as long as it is told to.

    python tests/fuzz/fuzz_stamps.py SECONDS [SEED]

Allowed is what the second decoder says too (``tests/stamps/lib/stamp_oracle.py``). Anything else
ends the run with the seed of the case. ``tests/stamps/test_fuzz_stamps.py`` runs a moment of it.
"""

from __future__ import annotations

import random
import sys
import time
from pathlib import Path
from zoneinfo import available_timezones

sys.path.insert(0, str(Path(__file__).parents[1] / "stamps/lib"))

import stamp_oracle

from roclog.stamps import Stamp, StampDecoder, encode_stamp, parse_zone, split_stamp, weekday_of
from roclog.time_flags import TimeFlag, is_trusted

NAMES = sorted(available_timezones() - {"localtime"})
SECOND = 10**9
DAY = 86400 * SECOND
END = 2**63


def some_zone(rng: random.Random) -> str:
    if rng.random() < 0.2:
        hours, minutes = rng.randrange(12), rng.randrange(60)
        return rng.choice(("UTC", f"+{hours:02}:{minutes:02}", f"-{hours:02}:{minutes:02}"))
    return rng.choice(NAMES)


def some_instant(rng: random.Random) -> int:
    """Nanoseconds UTC of whole milliseconds, more of them at the edges of hours."""
    hour = rng.randrange(48, 100 * 365 * 24) * 3600 * SECOND
    return hour + rng.choice((0, -1, 1, rng.randrange(3_600_000))) * 10**6


def bend(rng: random.Random, octets: bytes) -> bytes:
    bent = bytearray(octets)
    for _ in range(rng.choice((0, 1, 1, 2, 4))):
        bent[rng.randrange(len(bent))] = rng.choice((0, 0xFF, 0x80, rng.randrange(256)))
    return bytes(bent)


def compare(rng: random.Random, name: str, octets: bytes, read_at: int) -> Stamp:
    pivot, lenient = rng.choice((70, 70, 100, rng.randrange(70, 101))), rng.random() < 0.5
    tolerance = rng.choice((600 * SECOND, 0, rng.randrange(DAY // 2)))
    ago = rng.choice((None, SECOND, 0, -SECOND, rng.randrange(3 * DAY)))
    changed_after = None if ago is None else read_at - ago
    decoder = StampDecoder(parse_zone(name), year_pivot=pivot, lenient=lenient, tolerance=tolerance)
    found = decoder.decode(octets, read_at=read_at, changed_after=changed_after)
    device_time, flags = stamp_oracle.decode(
        octets,
        name,
        read_at=read_at,
        changed_after=changed_after,
        pivot=pivot,
        lenient=lenient,
        tolerance=tolerance,
    )
    assert found.flags == sum(stamp_oracle.NAMES[flag] for flag in flags), (found, flags)
    assert found.device_time == device_time
    assert bool(found.device_time) == is_trusted(found.flags)
    assert found.octets == octets
    return found


def octets(rng: random.Random) -> None:
    size = rng.choice((4, 7))
    name, given = some_zone(rng), rng.randbytes(size)
    compare(rng, name, given, rng.choice((0, END - 1, rng.randrange(END))))
    fields = split_stamp(given)
    assert fields.milliseconds == int.from_bytes(given[:2], "little")
    try:
        assert len(weekday_of(given)) <= 1
    except ValueError:
        return


def bent(rng: random.Random) -> None:
    name, instant = some_zone(rng), some_instant(rng)
    given = encode_stamp(instant, parse_zone(name), size=rng.choice((4, 7)), year_pivot=70)
    read_at = max(0, instant + rng.choice((0, SECOND, -SECOND, rng.randrange(-2 * DAY, 2 * DAY))))
    compare(rng, name, bend(rng, given), read_at)


def there_and_back(rng: random.Random) -> None:
    zone, instant = parse_zone(some_zone(rng)), some_instant(rng)
    given = encode_stamp(instant, zone)
    found = StampDecoder(zone).decode(given, read_at=instant, changed_after=None)
    assert found.device_time == instant or found.flags & TimeFlag.TIME_UNDECIDED


def change_of_clocks(rng: random.Random) -> None:
    """Near the next change of a zone's clocks after a random instant."""
    name, step = rng.choice(NAMES), 40 * 3600 * SECOND
    low = some_instant(rng) // SECOND * SECOND
    for _ in range(250):
        if offset(low, name) != offset(low + step, name):
            break
        low += step
    else:
        return
    high = low + step
    while high - low > SECOND:
        middle = (low + high) // 2 // SECOND * SECOND
        before = offset(middle, name) == offset(low, name)
        low, high = (middle, high) if before else (low, middle)
    if not 3 * DAY < high < 99 * 365 * DAY:
        return
    zone = parse_zone(name)
    for _ in range(20):
        instant = high + rng.randrange(-10_800_000, 10_800_000) * 10**6
        given = bytearray(encode_stamp(instant, zone, size=rng.choice((4, 7))))
        given[3] ^= rng.choice((0, 0, 0x80))
        given[2] = rng.choice((given[2], rng.randrange(60)))
        compare(rng, name, bytes(given), instant + rng.randrange(DAY // 2))


def offset(instant: int, name: str) -> object:
    return stamp_oracle.instant(instant).astimezone(stamp_oracle.zone(name)).utcoffset()


TARGETS = (octets, bent, bent, there_and_back, change_of_clocks)


def run(seconds: float, seed: int) -> int:
    """Cases done. A case is rerun alone by its number: ``one_case(number)``."""
    end = time.monotonic() + seconds
    number = seed
    while time.monotonic() < end:
        try:
            one_case(number)
        except BaseException:
            print(f"case {number}", file=sys.stderr)
            raise
        number += 1
    return number - seed


def one_case(number: int) -> None:
    rng = random.Random(number)
    TARGETS[number % len(TARGETS)](rng)


if __name__ == "__main__":
    limit = float(sys.argv[1])
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    print(f"{run(limit, first)} cases from {first}, no difference")

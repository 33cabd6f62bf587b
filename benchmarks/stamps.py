"""Stamps decoded per second, beside a plain loop over ``datetime`` that does less, in one run.

The loop turns good octets into nanoseconds and nothing else: no flag, no check of the zone. Both
results are compared, stamp by stamp, before any time is taken.
"""

from __future__ import annotations

import argparse
import json
import platform
import random
import statistics
import sys
import time
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo

from roclog.stamps import Stamp, StampDecoder, encode_stamp, parse_zone

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Answer = tuple[list[bytes], int]
    """The stamps of one answer and when it was read, ns UTC."""

ZONE = "Europe/Berlin"
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)
DAY = timedelta(days=1)
SECOND = 10**9
POINTS = {7: 34, 4: 60}
"""Stamps in the largest answer with discrete inputs."""


def by_datetime(stamps: list[bytes], read_at: int, zone: ZoneInfo) -> list[int]:
    host = datetime.fromtimestamp(read_at // SECOND, zone)
    times = []
    for octets in stamps:
        milliseconds = octets[0] | octets[1] << 8
        second, milliseconds = divmod(milliseconds, 1000)
        minute, hour = octets[2] & 0x3F, octets[3] & 0x1F
        fold = 0 if octets[3] & 0x80 else 1
        if len(octets) == 7:
            year, month, day = 2000 + (octets[6] & 0x7F), octets[5] & 0x0F, octets[4] & 0x1F
        else:
            year, month, day = host.year, host.month, host.day
        moment = datetime(
            year, month, day, hour, minute, second, milliseconds * 1000, zone, fold=fold
        )
        if len(octets) == 4 and moment > host:
            moment -= DAY
        times.append((moment - EPOCH) // MICROSECOND * 1000)
    return times


def by_roclog(stamps: list[bytes], read_at: int, decoder: StampDecoder) -> list[Stamp]:
    return decoder.decode_all(stamps, read_at=read_at, changed_after=read_at - SECOND)


def events(instants: list[int], size: int) -> list[Answer]:
    zone, count = parse_zone(ZONE), POINTS[size]
    answers = []
    for n in range(0, len(instants), count):
        some = instants[n : n + count]
        answers.append(([encode_stamp(i, zone, size=size) for i in some], max(some) + SECOND))
    return answers


def loads(count: int) -> dict[str, list[Answer]]:
    rng = random.Random(1)
    june = int(datetime(2026, 6, 1, tzinfo=UTC).timestamp()) * SECOND
    busy = [june + n * 20 * 10**6 for n in range(count)]
    year = sorted(june + rng.randrange(365 * 86_400_000) * 10**6 for _ in range(count))
    shuffled = rng.sample(year, count)
    return {
        "7 octets, 50 changes a second": events(busy, 7),
        "7 octets, any instant of a year": events(shuffled, 7),
        "4 octets, 50 changes a second": events(busy, 4),
    }


def rate(answers: list[Answer], decode: Callable[[list[bytes], int], Sequence[object]]) -> float:
    begin = time.perf_counter()
    count = 0
    for stamps, read_at in answers:
        count += len(decode(stamps, read_at))
    return count / (time.perf_counter() - begin)


def measure(answers: list[Answer], rounds: int) -> dict[str, float]:
    zone = ZoneInfo(ZONE)
    for stamps, read_at in answers:
        found = by_roclog(stamps, read_at, StampDecoder(parse_zone(ZONE)))
        if [stamp.device_time for stamp in found] != by_datetime(stamps, read_at, zone):
            raise SystemExit("the two do not decode the same times")
    ours, plain = [], []
    for _ in range(rounds):
        decoder = StampDecoder(parse_zone(ZONE))
        ours.append(rate(answers, partial(by_roclog, decoder=decoder)))
        plain.append(rate(answers, partial(by_datetime, zone=zone)))
    return {
        "roclog": statistics.median(ours),
        "datetime": statistics.median(plain),
        "ratio": statistics.median(a / b for a, b in zip(ours, plain, strict=True)),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer stamps and rounds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the figures")
    given = parser.parse_args()
    count, rounds = (20_000, 3) if given.quick else (200_000, 9)
    figures = {}
    print(f"Python {platform.python_version()}, {count} stamps, median of {rounds} rounds in turns")
    for name, answers in loads(count).items():
        found = figures[name] = measure(answers, rounds)
        print(
            f"{name:34} roclog {found['roclog']:11,.0f}/s   "
            f"datetime {found['datetime']:9,.0f}/s   ratio {found['ratio']:.2f}"
        )
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Print the last ISO codes of each counter, and what is missing: read_back.py RECORDING."""

from __future__ import annotations

import sys

import roclog


def main(path: str) -> None:
    latest: dict[str, roclog.Sample] = {}
    with roclog.open(path) as recording:
        for sample in recording.samples("/*/sample"):
            latest[sample.device] = sample
        for device, sample in latest.items():
            codes = [sample.values[f"iso_code_{n}"] for n in range(1, 5)]
            print(device, "sample", sample.seq, "ISO", *codes)
        for gap in recording.gaps():
            print(gap.device, "missed", gap.expected, "samples:", gap.reason)


if __name__ == "__main__":
    main(sys.argv[1])

"""What a line has seen."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Final

BIN_NS: Final = 10_000
LAST_BIN: Final = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """What a line has seen since it was opened.

    Args:
        baud: None on a line without wire time.
        duration_s: From opening until now or until closing.
        requests: Frames of the client. A pause of more than 1.5 characters ends a frame.
        answers: Frames of the server.
        request_octets: Octets that the client has sent.
        answer_octets: Octets that the server has sent.
        short_gaps: Requests that began sooner than the silence after the last octet on the line.
        collisions: Frames that began or went on while the other side was sending.
        garbled_octets: Octets spoilt by collisions, of both sides.
        late_answers: Answers whose device was ready only after the turnaround: they began later
            than asked for. Not counted without a turnaround.
        dropped_octets: Octets that found the terminal of a side full because nobody read there.
        busy: Character times of the octets that have crossed, as a share of the duration.
        lateness_p50_ms: Median lateness of the deliveries against the wire, in steps of 0.01 ms.
        lateness_p99_ms: The lateness that 99 of 100 deliveries kept, likewise.
        lateness_max_ms: The worst lateness.
    """

    baud: int | None
    duration_s: float
    requests: int
    answers: int
    request_octets: int
    answer_octets: int
    short_gaps: int
    collisions: int
    garbled_octets: int
    late_answers: int
    dropped_octets: int
    busy: float
    lateness_p50_ms: float
    lateness_p99_ms: float
    lateness_max_ms: float

    def to_json(self) -> str:
        """Give one line of JSON with a key for each field."""
        return json.dumps(asdict(self))

    def __str__(self) -> str:
        parts = [
            f"{self.requests} requests",
            f"{self.answers} answers",
            f"{self.short_gaps} short gaps",
            f"{self.collisions} collisions",
            f"line used {self.busy:.1%} of {self.duration_s:.1f} s",
        ]
        if self.late_answers:
            parts.append(f"{self.late_answers} answers after the turnaround")
        if self.dropped_octets:
            parts.append(f"{self.dropped_octets} octets that nobody took")
        parts.append(
            f"delivered late by {self.lateness_p50_ms:.2f} ms (median), "
            f"{self.lateness_p99_ms:.2f} ms (99 %), {self.lateness_max_ms:.2f} ms (most)"
        )
        return ", ".join(parts)


class Lateness:
    """Quantiles of any number of times in bounded memory."""

    def __init__(self) -> None:
        self._bins: Counter[int] = Counter()
        self._most_ns = 0

    def add(self, late_ns: int) -> None:
        self._bins[min(late_ns // BIN_NS, LAST_BIN)] += 1
        self._most_ns = max(self._most_ns, late_ns)

    @property
    def most_ms(self) -> float:
        return self._most_ns / 1e6

    def quantile_ms(self, share: float) -> float:
        """Give the end of the bin in which the quantile lies, at most the worst; 0 without any."""
        wanted = math.ceil(share * self._bins.total())
        for number, count in sorted(self._bins.items()):
            wanted -= count
            if wanted <= 0:
                if number == LAST_BIN:
                    break
                return min((number + 1) * BIN_NS, self._most_ns) / 1e6
        return self.most_ms

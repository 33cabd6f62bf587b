"""The samples of a recording, read by the official MCAP and protobuf packages, not by roclog."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

if TYPE_CHECKING:
    from pathlib import Path


@dataclass
class Recorded:
    """asked: monotonic nanoseconds by device. others: messages that are no samples, by channel.

    broken: samples whose number or whose count from the device does not follow the one before.
    """

    asked: dict[str, list[int]] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)
    broken: int = 0
    octets: int = 0

    @property
    def samples(self) -> int:
        return sum(len(instants) for instants in self.asked.values())


def read(folder: Path, block: str) -> Recorded:
    """Everything below ``folder``."""
    found = Recorded()
    last: dict[str, tuple[int, int]] = {}
    for path in sorted(folder.rglob("*.mcap")):
        found.octets += path.stat().st_size
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages():
                _, device, *rest = channel.topic.split("/")
                if rest != [block]:
                    found.others[rest[0] if rest else device] += 1
                    continue
                before = last.get(device)
                seq, count = last[device] = (message.seq, message.count)
                found.broken += before is not None and (seq, count) != (
                    before[0] + 1,
                    before[1] + 1,
                )
                monotonic = message.read_at_monotonic - message.read_at
                found.asked.setdefault(device, []).append(message.asked_at + monotonic)
    return found

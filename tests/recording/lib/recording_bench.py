"""A writer on a folder, with clocks that stand still until told otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from roclog.clock import Instant
from roclog.devices import PROFILES
from roclog.handshake import Memory, News, Seen
from roclog.recording.directory import Directory, Inheritance
from roclog.recording.entries import LOG_CHANNEL, Entry, block_channel, plain_channel
from roclog.recording.sealer import Sealer
from roclog.recording.writer import Limits, Writer
from roclog.register_map import WordOrder
from roclog.samples import Reading, SampleMaker
from roclog.schema import CLEAR, GAP, Origin

if TYPE_CHECKING:
    from pathlib import Path

PROFILE = PROFILES["hiac-roc"]
BLOCK = PROFILE.block("sample")
MAKER = SampleMaker("roc1", PROFILE.name, BLOCK, WordOrder.ABCD, b"e" * 16)
CHANNELS = [
    LOG_CHANNEL,
    block_channel("roc1", PROFILE.name, BLOCK, MAKER.kind),
    plain_channel("roc1", "clear", CLEAR, clears=MAKER.topic),
    plain_channel("roc1", "gap", GAP),
]
START = 1_795_000_000 * 10**9


@dataclass
class ManualClock:
    """Both clocks, set by the test."""

    utc: int = START
    monotonic: int = 10**9

    def now(self) -> Instant:
        return Instant(self.utc, self.monotonic)

    def pause(self, nanoseconds: int) -> None:
        self.advance(nanoseconds)

    def advance(self, nanoseconds: int) -> None:
        self.utc += nanoseconds
        self.monotonic += nanoseconds


def sample(number: int, clock: ManualClock, asked: Instant | None = None) -> Entry:
    """Sample ``number``; its first count is number / 100."""
    words = [1, 0, 0, 0, 0, 10, 0, 0, 0, number, *([0] * 17)]
    reading = Reading(tuple(words), asked or clock.now(), clock.now(), clock.now(), 0)
    payload = reading.raw[10:12] + reading.raw[16:52]
    seen = Seen(flag=True, payload=payload, reading=reading)
    memory = Memory(seq=number, payload=payload, cleared=False, restarted=False)
    return MAKER.sample(News(seen, number, Origin.FLAG), reading, memory)


@dataclass
class Bench:
    """Everything of one recording directory."""

    root: Path
    clock: ManualClock
    directory: Directory
    inheritance: Inheritance
    sealer: Sealer
    writer: Writer
    told: list[str]

    def commit(self, number: int) -> None:
        self.clock.advance(10**9)
        self.writer.commit([sample(number, self.clock)]).result(10)

    def close(self) -> None:
        self.writer.close()
        self.sealer.close()
        self.directory.release()


def open_bench(root: Path, clock: ManualClock, limits: Limits | None = None) -> Bench:
    directory = Directory(root)
    leftover = directory.hot_segments()
    inheritance = directory.inherit()
    told: list[str] = []
    sealer = Sealer(root, None, lambda _, text: told.append(text))
    for path in leftover:
        sealer.seal(path)

    def facts(number: int) -> dict[str, str]:
        return {
            "number": str(number),
            "logger": inheritance.logger,
            "run": "r",
            "boot_id": "b",
            "version": "0",
            "opened_at": str(clock.now().utc),
            "opened_at_monotonic": str(clock.now().monotonic),
        }

    writer = Writer(
        directory=directory,
        inheritance=inheritance,
        channels=CHANNELS,
        limits=limits or Limits(duration=3600 * 10**9, size=2**26),
        clock=clock,
        segment_facts=facts,
        sealer=sealer,
    )
    return Bench(root, clock, directory, inheritance, sealer, writer, told)

"""The offset of a device's clock: recorded, read back, and shown beside the device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import roclog
from roclog.clock import Instant
from roclog.info import summarize
from roclog.polling.clock_watch import ClockWatch
from roclog.recording.entries import plain_channel
from roclog.recording.segment import HotSegment
from roclog.schema import CLOCK_OFFSET

if TYPE_CHECKING:
    from pathlib import Path

    from roclog.recording.entries import Entry

SECOND = 10**9
UTC = 1_795_000_000 * SECOND


class Outbox:
    def __init__(self) -> None:
        self.notes: list[Entry] = []
        self.events: list[str] = []

    def note(self, entry: Entry) -> None:
        self.notes.append(entry)

    def event(self, level: str, kind: str, text: str) -> None:
        self.events.append(f"{level} {kind}: {text}")


def at(seconds: float) -> Instant:
    return Instant(UTC + int(seconds * SECOND), int(seconds * SECOND))


def test_nothing_is_recorded_before_the_first_stamp() -> None:
    outbox = Outbox()
    ClockWatch("msx1", outbox).report(at(60))  # type: ignore[arg-type]
    assert not outbox.notes


def test_a_clock_3_s_ahead_is_found_between_request_and_answer(tmp_path: Path) -> None:
    outbox = Outbox()
    watch = ClockWatch("msx1", outbox)  # type: ignore[arg-type]
    watch.note(UTC + 103 * SECOND, at(99.9), at(100.1))
    watch.report(at(100.1))
    channel = plain_channel("msx1", "clock_offset", CLOCK_OFFSET)
    hot = HotSegment(tmp_path / "00000001.mcap", "roclog test", [channel], {})
    hot.append(outbox.notes, sync=True)
    hot.close()
    with roclog.open(tmp_path / "00000001.mcap") as recording:
        info = summarize(recording)
    found: dict[str, Any] = info.clocks["msx1"].values
    assert abs(found["offset"] - 3) <= found["uncertainty"] < 0.11
    assert found["drift"] != found["drift"]  # NaN: one stamp says nothing about it
    assert info.samples.count == 0
    assert not outbox.events


def test_a_clock_that_stands_still_is_told() -> None:
    outbox = Outbox()
    watch = ClockWatch("msx1", outbox)  # type: ignore[arg-type]
    for second in range(30):
        watch.note(UTC + 5 * SECOND, at(second), at(second + 0.01))
    assert any("stands still" in text for text in outbox.events)

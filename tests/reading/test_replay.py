"""The pace of the recording, and lines for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mcapfiles as files
import pytest
from mcapfiles import SECOND, T0

from roclog.recording.reader import open_recording
from roclog.replay import Lines, paced

if TYPE_CHECKING:
    from pathlib import Path

    from roclog.recording.records import Record


class FakeTime:
    def __init__(self) -> None:
        self.now = 100.0
        self.waits: list[float] = []

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.waits.append(round(seconds, 6))
        self.now += seconds


def records(tmp_path: Path, *seconds: float) -> list[Record]:
    items = [
        files.sample(n, at=T0 + int(second * SECOND)) for n, second in enumerate(seconds, start=1)
    ]
    return list(open_recording(files.write_sealed(tmp_path / "a.mcap", items)).records())


@pytest.mark.parametrize(
    ("speed", "waits"),
    [(1, [1.0, 9.5, 0.25]), (10, [0.1, 0.95, 0.025]), (0.5, [2.0, 19.0, 0.5]), (None, [])],
)
def test_waits_are_the_differences_of_log_time(
    tmp_path: Path, speed: float | None, waits: list[float]
) -> None:
    time = FakeTime()
    found = records(tmp_path, 0, 1, 10.5, 10.75)
    assert list(paced(found, speed, time.clock, time.sleep)) == found
    assert time.waits == waits


def test_a_step_back_of_the_wall_clock_is_not_waited_for(tmp_path: Path) -> None:
    time = FakeTime()
    list(paced(records(tmp_path, 10, 11, 5, 6), 1, time.clock, time.sleep))
    assert time.waits == [1.0, 1.0]


def test_slow_printing_does_not_add_up(tmp_path: Path) -> None:
    time = FakeTime()
    for _ in paced(records(tmp_path, 0, 1, 2, 3), 1, time.clock, time.sleep):
        time.now += 0.4
    assert time.waits == [0.6, 0.6, 0.6]


def test_what_a_sample_has_is_shown_whatever_the_map_was_before(tmp_path: Path) -> None:
    old = files.message_class("test.Old", f"{files.SIGNATURE}, level 16 double, flow 17 double")
    new = files.message_class("test.New", f"{files.SIGNATURE}, flow 16 double, speed 17 double")
    for number, (kind, values) in enumerate(
        [(old, {"level": 1.5, "flow": 2.0}), (new, {"flow": 3.0, "speed": 4.0})]
    ):
        topic = files.Topic("/m/s", kind, {"device": "m", "block": "s"})
        at = T0 + number * SECOND
        data = kind(seq=number + 1, epoch=files.EPOCH, read_at=at, **values).SerializeToString()
        item = files.Item("/m/s", at, data, number + 1, at)
        files.write_sealed(tmp_path / f"{number}.mcap", [item], topics=[topic])
    recording = open_recording(tmp_path)
    lines = Lines(recording.channels)
    first, second = (lines.line(record).split("  ", 1)[1] for record in recording.records())
    assert ("level" in first, "flow" in first, "speed" in first) == (True, True, False)
    assert ("level" in second, "flow" in second, "speed" in second) == (False, True, True)


def test_lines_stand_below_each_other(tmp_path: Path) -> None:
    items = [
        files.event(T0),
        files.sample(1, count_1=5.0, laser_low=False),
        files.sample(
            1234, at=T0 + 2 * SECOND, doubtful=1, redelivered=True, alarms=1, laser_low=True
        ),
        files.gap(T0 + 3 * SECOND, T0, T0 + SECOND),
    ]
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", items))
    lines = Lines(recording.channels)
    assert [lines.line(record) for record in recording.records()] == [
        "2026-11-18T11:06:40.000Z  roc1  info  baseline: first block",
        "2026-11-18T11:06:41.000Z  roc1  sample  ISO 15.5  count 5.0 0.01 /mL  temperature 25.1 °C",
        (
            "2026-11-18T11:06:42.000Z  roc1  sample  ISO 15.5  count 1234.25?    12.34 /mL"
            "  temperature 25.1 °C  laser_low redelivered"
        ),
        (
            "2026-11-18T11:06:43.000Z  roc1  gap     from 2026-11-18T11:06:40Z"
            "  to 2026-11-18T11:06:41Z  expected 2  reason downtime"
        ),
    ]

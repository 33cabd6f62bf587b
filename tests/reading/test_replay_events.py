"""Time-stamped inputs as a sequence of events: by the devices' own clocks, a line for each change.

The messages are made with the official protobuf library from the documented field numbers.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import mcapfiles as files
import pytest
from click.testing import CliRunner
from mcapfiles import SECOND, T0

from roclog.cli import cli
from roclog.plot import _gather
from roclog.recording.reader import open_recording
from roclog.replay import Lines, happened_at, paced

if TYPE_CHECKING:
    from pathlib import Path

MS = 10**6
TOPIC = "/rtu7/discrete_inputs"
INPUTS = files.message_class(
    "roclog.mei_timestamped.DiscreteInputs",
    files.SIGNATURE
    + """, address 16 fixed32, value 17 fixed32,
    change 18 Change:NONE|BASELINE|MOVED|RESTAMPED|VALUE_WITHOUT_STAMP,
    hidden 19 fixed32, time_octets 20 bytes""",
)
FACTS = {"device": "rtu7", "block": "discrete_inputs", "profile": "mei-timestamped"}
TOPICS = (*files.TOPICS, files.Topic(TOPIC, INPUTS, FACTS))
BASELINE, MOVED, RESTAMPED = 1, 2, 3
IV, INFERRED = 4, 1024


def change(seq: int, at: int, device_time: int, **values: Any) -> files.Item:
    fields = {
        "seq": seq, "epoch": files.EPOCH, "origin": 2, "asked_at": at, "read_at": at,
        "device_time": device_time, "address": 196, "change": MOVED, "raw": bytes(8),
        "time_octets": bytes(7),
    }  # fmt: skip
    return files.Item(TOPIC, at, INPUTS(**fields | values).SerializeToString(), seq)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Five changes of which each read shows the later one first, and a sample of a counter."""
    items = [
        change(1, T0, T0 - 30 * SECOND, address=217, change=BASELINE),
        change(2, T0 + SECOND, T0 + 900 * MS, address=203, value=1),
        change(3, T0 + SECOND, T0 + 899 * MS, address=204, value=1, time_flags=INFERRED),
        files.sample(1, at=T0 + SECOND + MS, device_time=T0 + 899 * MS + 1),
        change(4, T0 + 2 * SECOND, 0, address=203, time_flags=IV),
        change(5, T0 + 2 * SECOND, T0 + 1_100 * MS, address=204, value=1, change=3, hidden=1),
    ]
    return files.write_sealed(tmp_path / "a.mcap", items, topics=TOPICS)


def replay(*arguments: object) -> list[str]:
    result = CliRunner().invoke(cli, ["replay", "--speed", "max", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout.splitlines()


def test_the_sequence_of_events(recording: Path) -> None:
    assert replay(recording, "--order", "device-time", "--channel", "/rtu7/*") == [
        "2026-11-18T11:06:10.000Z  rtu7  discrete_inputs    217 = 0  baseline",
        "2026-11-18T11:06:40.899Z  rtu7  discrete_inputs    204 = 1  moved     date_inferred",
        "2026-11-18T11:06:40.900Z  rtu7  discrete_inputs    203 = 1  moved",
        (
            "2026-11-18T11:06:41.100Z  rtu7  discrete_inputs    204 = 1  restamped"
            "  went away and came back unseen"
        ),
        "2026-11-18T11:06:42.000Z  rtu7  discrete_inputs    203 = 0  moved      host time: iv",
    ]


def test_without_an_order_host_and_device_time_stand_side_by_side(recording: Path) -> None:
    lines = replay(recording, "--channel", TOPIC)
    assert lines[2] == (
        "2026-11-18T11:06:41.000Z  rtu7  discrete_inputs    204 = 1  moved   "
        "  device 2026-11-18T11:06:40.899Z  date_inferred"
    )
    assert lines[3].endswith("203 = 0  moved     no device time                   iv")
    assert [line[:24] for line in lines] == sorted(line[:24] for line in lines)


def test_devices_are_merged_by_their_own_time(recording: Path) -> None:
    found = [json.loads(line) for line in replay(recording, "--order", "device-time", "--json")]
    assert [(one["device"], one["seq"]) for one in found] == [
        ("rtu7", 1), ("rtu7", 3), ("roc1", 1), ("rtu7", 2), ("rtu7", 5), ("rtu7", 4),
    ]  # fmt: skip
    assert sorted(replay(recording, "--json")) == sorted(
        replay(recording, "--order", "device-time", "--json")
    )


def test_the_range_goes_by_log_time(recording: Path) -> None:
    lines = replay(recording, "--order", "device-time", "--from", "2026-11-18T11:06:42Z")
    assert [line[11:24] for line in lines] == ["11:06:41.100Z", "11:06:42.000Z"]


def test_the_pace_is_that_of_the_shown_times(recording: Path) -> None:
    waits: list[float] = []
    records = sorted(open_recording(recording).records([TOPIC]), key=happened_at)
    found = paced(records, 2, lambda: sum(waits), waits.append, happened_at)
    assert list(found) == records
    assert waits == pytest.approx([15.4495, 0.0005, 0.1, 0.45])


def test_a_sample_without_device_time_says_so(tmp_path: Path) -> None:
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", [files.sample(1)]))
    lines = Lines(recording.channels, happened_at)
    assert [lines.line(record).endswith("host time") for record in recording.records()] == [True]


def test_the_plot_leaves_changes_of_inputs_out(recording: Path) -> None:
    opened = open_recording(recording)
    panels, _ = _gather(opened.records(), opened.channels)
    assert {panel.device for panel in panels} == {"roc1"}

"""info, replay, export and verify as a shell sees them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import mcapfiles as files
import pytest
from click.testing import CliRunner
from mcapfiles import SECOND, T0

from roclog.cli import cli

if TYPE_CHECKING:
    from pathlib import Path

GOOD = [files.event(T0), *(files.sample(seq) for seq in range(1, 4)), files.link(T0 + 9 * SECOND)]


def run(*arguments: object) -> Any:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


@pytest.fixture
def good(tmp_path: Path) -> Path:
    files.write_sealed(tmp_path / "r" / "a.mcap", GOOD)
    return tmp_path / "r"


def test_info_as_text_and_as_json(good: Path) -> None:
    text = run("info", good)
    assert text.exit_code == 0
    assert text.stdout.startswith("3 samples in 1 segment from 2026-11-18T11:06:41Z to")
    for word in ("/roc1/sample", "serial_number  1234", "baseline", "sealed"):
        assert word in text.stdout
    found = json.loads(run("info", good, "--json").stdout)
    assert found["schema"] == "roclog.info/1"
    assert found["samples"]["count"] == 3
    assert found["segments"][0]["number"] == 1
    assert {c["topic"]: c["count"] for c in found["channels"]}["/roc1/sample"] == 3
    assert found["devices"]["roc1"]["identity"]["manufacturer"] == "HIAC"
    assert found["events"] == [{"device": "roc1", "kind": "baseline", "level": "info", "count": 1}]


def test_info_shows_every_message_type_of_a_channel(tmp_path: Path) -> None:
    """A channel of an analyser that got another sensor between two runs."""
    other = files.message_class("roclog.test_device.Other", "state 1 fixed32")
    topics = (replace(files.TOPICS[1], kind=other),)
    item = files.Item("/roc1/sample", T0 + SECOND, other(state=3).SerializeToString())
    files.write_sealed(tmp_path / "a.mcap", GOOD)
    files.write_sealed(tmp_path / "b.mcap", [item], topics=topics, metadata=files.facts(number=2))
    text = run("info", tmp_path).stdout
    assert "roclog.test_device.Sample, roclog.test_device.Other" in text
    found = json.loads(run("info", tmp_path, "--json").stdout)["channels"]
    (types,) = (c["message_types"] for c in found if c["topic"] == "/roc1/sample")
    assert types == ["roclog.test_device.Sample", "roclog.test_device.Other"]


def test_info_tells_of_gaps_copies_conflicts_and_damage(tmp_path: Path) -> None:
    items = [*GOOD, files.sample(3), files.sample(2, raw=b"\0\0\0\0\0\0"), files.sample(9)]
    files.write_sealed(tmp_path / "a.mcap", [*items, files.gap(T0 + 9 * SECOND, T0, T0 + 5)])
    (tmp_path / "b.mcap").write_bytes(b"junk")
    found = json.loads(run("info", tmp_path, "--json").stdout)
    assert found["copies_dropped"] == 1
    assert [c["seq"] for c in found["conflicts"]] == [2]
    assert [(m["first_seq"], m["last_seq"]) for m in found["missing"]] == [(4, 8)]
    assert found["gaps"] == [
        {
            "device": "roc1",
            "block": "",
            "reason": "downtime",
            "possible": False,
            "count": 1,
            "expected": 2,
        }
    ]
    assert [d["reason"] for d in found["damage"]] == ["not an MCAP file"]
    text = run("info", tmp_path).stdout
    assert "samples 4 to 8 of /roc1/sample are missing" in text
    assert "1 copy of a sample left out" in text


def test_verify_says_whether_everything_is_there(good: Path) -> None:
    result = run("verify", good)
    assert (result.exit_code, result.stdout) == (
        0,
        "3 samples in 1 segment: complete and undamaged\n",
    )
    assert json.loads(run("verify", good, "--json").stdout)["good"] is True


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ([files.gap(T0 + 9 * SECOND, T0, T0 + SECOND)], "gap: roc1: 2026-11-18T11:06:40Z to"),
        ([files.sample(7)], "missing: /roc1/sample: samples 4 to 6 are not in the files"),
        ([files.sample(5)], "missing: /roc1/sample: sample 4 is not in the files"),
        ([files.sample(3, raw=b"\1\1\1\1\1\1")], "conflict: /roc1/sample: two different samples 3"),
    ],
)
def test_verify_exits_with_5(tmp_path: Path, more: list[files.Item], line: str) -> None:
    files.write_sealed(tmp_path / "a.mcap", [*GOOD, *more])
    result = run("verify", tmp_path)
    assert result.exit_code == 5
    assert line in result.stdout
    found = json.loads(run("verify", tmp_path, "--json").stdout)
    assert found["good"] is False


def test_whose_samples_are_missing(tmp_path: Path) -> None:
    gaps = [files.gap_of_block(T0 + 9 * SECOND, T0, T0 + SECOND, name) for name in ("sample", "")]
    files.write_sealed(tmp_path / "a.mcap", [*GOOD, *gaps], topics=files.WITH_BLOCKS)
    lines = run("verify", tmp_path).stdout.splitlines()
    assert [line.split(": ")[1] for line in lines if line.startswith("gap")] == [
        "roc1/sample",
        "roc1",
    ]
    found = json.loads(run("info", tmp_path, "--json").stdout)
    assert [gap["block"] for gap in found["gaps"]] == ["", "sample"]
    shown = run("replay", tmp_path, "--speed", "max", "--channel", "*/gap").stdout.splitlines()
    assert [line.endswith("reason storage  block sample") for line in shown] == [True, False]


def test_verify_checks_what_no_chunk_protects(tmp_path: Path) -> None:
    path = files.write_sealed(tmp_path / "a.mcap", GOOD)
    octets = path.read_bytes()
    for at in (octets.rindex(b"roclog.device.roc1"), octets.index(b"roclog 0.1")):
        path.write_bytes(octets[:at] + b"x" + octets[at + 1 :])
        result = run("verify", path)
        assert result.exit_code == 5
        assert "checksum is wrong" in result.stdout


def test_verify_leaves_everything_as_it_is(good: Path) -> None:
    before = [(path, path.read_bytes(), path.stat().st_mtime_ns) for path in good.iterdir()]
    run("verify", good)
    assert [(path, path.read_bytes(), path.stat().st_mtime_ns) for path in good.iterdir()] == before


@pytest.mark.parametrize("command", ["info", "verify", "replay", "export"])
def test_wrong_paths(tmp_path: Path, command: str) -> None:
    more = ["--format", "csv", "--out", tmp_path / "out"] if command == "export" else []
    for path in (tmp_path / "nothing", tmp_path, tmp_path / "*.mcap"):
        result = run(command, path, *more)
        assert result.exit_code == 2
        assert str(path) in result.stderr
    (tmp_path / "text.mcap").write_text("text")
    result = run(command, tmp_path / "text.mcap", *more)
    assert result.exit_code == 5
    assert result.stderr == f"roclog: {tmp_path}/text.mcap: not an MCAP file at offset 0\n"


@pytest.mark.parametrize("command", ["info", "verify", "replay", "export"])
def test_help_has_an_example(command: str) -> None:
    result = run(command, "--help")
    assert f"roclog {command} recordings" in result.stdout


def test_replay_as_lines_and_as_json(good: Path) -> None:
    result = run("replay", good, "--speed", "max")
    assert [line.split()[:3] for line in result.stdout.splitlines()] == [
        [f"2026-11-18T11:06:4{n}.000Z", "roc1", "sample"] for n in (1, 2, 3)
    ]
    result = run("replay", good, "--speed", "max", "--json", "--channel", "*", "--from", T0 + 1)
    assert result.exit_code == 2
    start = "2026-11-18T11:06:43Z"
    result = run("replay", good, "--speed", "max", "--json", "--channel", "*", "--from", start)
    objects = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(o["kind"], o["log_time"]) for o in objects] == [
        ("sample", T0 + 3 * SECOND),
        ("link", T0 + 9 * SECOND),
    ]


@pytest.mark.parametrize("speed", ["0", "-1", "fast", "nan", "inf"])
def test_speeds_that_are_none(good: Path, speed: str) -> None:
    assert run("replay", good, f"--speed={speed}").exit_code == 2


def test_replay_does_not_obey_control_characters(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", [files.event(T0, message="\x1b[2Jgone\u202e")])
    result = run("replay", tmp_path, "--speed", "max", "--channel", "/log")
    assert "\\x1b[2Jgone\\x202e" in result.stdout


def test_export_says_what_it_wrote(good: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("export", good, "--format", "csv", "--out", out, "--channel", "/roc1/sample")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == f"{out}/roc1.sample.csv: 3 records\n"
    again = run("export", good, "--format", "csv", "--out", out, "--channel", "/roc1/sample")
    assert again.exit_code == 2
    assert "exists already" in again.stderr
    assert run("export", good, "--format", "csv", "--out", out, "--force").exit_code == 0
    missing = run("export", good, "--format", "csv", "--out", out, "--channel", "/x")
    assert missing.exit_code == 2
    assert "/roc1/sample" in missing.stderr


def process(*arguments: object, **options: Any) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "roclog", *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, **options)


def test_replay_into_a_pipe_that_closes_is_quiet(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "a.mcap", [files.sample(seq) for seq in range(1, 20_000)])
    with process("replay", tmp_path, "--speed", "max", "--json") as replay:
        assert replay.stdout is not None
        assert replay.stderr is not None
        replay.stdout.readline()
        replay.stdout.close()
        assert replay.stderr.read() == b""
        assert replay.wait(20) == 128 + signal.SIGPIPE


def test_ctrl_c_ends_a_replay_cleanly(tmp_path: Path) -> None:
    items = [files.sample(1), files.sample(2, at=T0 + 3600 * SECOND)]
    files.write_sealed(tmp_path / "a.mcap", items)
    with process("replay", tmp_path, env={**os.environ, "PYTHONUNBUFFERED": "1"}) as replay:
        assert replay.stdout is not None
        assert replay.stderr is not None
        assert b"sample" in replay.stdout.readline()
        time.sleep(0.2)
        replay.send_signal(signal.SIGINT)
        assert replay.stdout.read() == b""
        assert replay.stderr.read() == b""
        assert replay.wait(20) == 0

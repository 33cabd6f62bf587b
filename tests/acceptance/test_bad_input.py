"""Bad input through the command line: one line saying what and where, and the documented code."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from bench.peer import Roc
from bench.recorder import Recorder, roclog
from bench.recording import items

from roclog.devices.hiac_roc import REGISTER_MAP
from roclog.errors import RegisterMapError
from roclog.map_check import check_register_map

if TYPE_CHECKING:
    import subprocess
    from pathlib import Path

GOOD = """
[recording]
directory = "recordings"
[connections.line]
transport = "tcp"
host = "127.0.0.1"
port = 1
[devices.roc1]
profile = "hiac-roc"
connection = "line"
unit = 138
poll = "100ms"
"""
SERIAL = GOOD.replace(
    'transport = "tcp"\nhost = "127.0.0.1"\nport = 1', 'transport = "rtu"\nport = "/dev/null/none"'
)
TWO = GOOD + GOOD[GOOD.index("[devices.roc1]") :].replace("roc1", "roc2")


def one_line(done: subprocess.CompletedProcess[str], *words: str) -> None:
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0], done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD.replace("poll =", "pol ="), ["devices.roc1", "pol"]),
        (GOOD.replace('"100ms"', "100"), ["devices.roc1.poll"]),
        (GOOD.replace("unit = 138", 'unit = "138"'), ["devices.roc1.unit"]),
        (SERIAL.replace("138", "0"), ["devices.roc1.unit", "247"]),
        (SERIAL.replace("138", "248"), ["devices.roc1.unit", "247"]),
        (TWO, ["roc2", "roc1"]),
        (GOOD.replace('"line"\nunit', '"lin"\nunit'), ["devices.roc1.connection", "lin"]),
        (GOOD.replace("[recording]", "[recording"), ["line 2"]),
        (GOOD.replace('"hiac-roc"', '"hiac"'), ["devices.roc1.profile", "hiac"]),
    ],
)
@pytest.mark.parametrize("command", ["check", "record"])
def test_configuration(tmp_path: Path, text: str, words: list[str], command: str) -> None:
    config = tmp_path / "roclog.toml"
    config.write_text(text)
    done = roclog(command, config)
    assert done.returncode == 3, done.stderr
    one_line(done, "roclog.toml", *words)
    assert not (tmp_path / "recordings").exists()


def test_a_configuration_that_is_a_directory_or_not_there(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.toml"):
        for command in ("check", "record"):
            done = roclog(command, path)
            assert done.returncode in (2, 3), done.stderr
            assert str(path) in done.stderr
            assert "Traceback" not in done.stderr


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    config = tmp_path / "roclog.toml"
    for text, place in ((GOOD, "127.0.0.1:1"), (SERIAL, "/dev/null/none")):
        config.write_text(text)
        for command in (["check", config, "--probe"], ["read", config, "roc1"]):
            done = roclog(*command)
            assert done.returncode == 4, done.stderr
            assert place in done.stderr + done.stdout
            assert "Traceback" not in done.stderr


def test_record_keeps_trying_a_port_that_is_not_there(tmp_path: Path) -> None:
    with Roc(tmp_path, "early", samples=1) as roc:
        port = roc.address  # free again once it has ended
    config = f'[connections.line]\ntransport = "tcp"\nhost = "127.0.0.1"\nport = {port}\n'
    recorder = Recorder(tmp_path, config + GOOD[GOOD.index("[devices.roc1]") :])
    with recorder.start() as child:
        child.while_it_runs(lambda: "cannot be opened" in child.talk(), "a complaint")
        recorder.wait_for_hot(child)
        assert child.stop() == 0
        assert child.talk().count("cannot be opened") == 1
    assert [item.values.name for item in items(recorder.directory, "/log")] == ["roc1.link"]


def test_an_address_beyond_the_last() -> None:
    block = replace(REGISTER_MAP.samples[0], address=65520)
    with pytest.raises(RegisterMapError, match="65520"):
        check_register_map(replace(REGISTER_MAP, samples=(block,)))


def test_a_directory_that_cannot_be_written(tmp_path: Path) -> None:
    config = tmp_path / "roclog.toml"
    config.write_text(GOOD)
    (tmp_path / "recordings").write_text("a file in the way")
    done = roclog("record", config, "--quiet")
    assert done.returncode == 6
    one_line(done, str(tmp_path / "recordings"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recorder:
    folder: Path = tmp_path_factory.mktemp("recording")
    with Roc(folder, samples=10**6) as roc:
        recorder = Recorder(folder, roc.toml(device='poll = "50ms"\ncycle = "200ms"'))
        with recorder.start() as child:
            child.while_it_runs(lambda: len(roc.truth.cleared) > 5, "some clears")
            child.stop()
    return recorder


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.99])
def test_a_truncated_segment(tmp_path: Path, recording: Recorder, part: float) -> None:
    whole = recording.sealed()[0].read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(len(whole) * part)])
    done = roclog("verify", cut)
    assert done.returncode == 5, done
    assert "cut.mcap" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    done = roclog("export", cut, "--format", "csv", "--out", tmp_path / "csv")
    assert done.returncode in (0, 5), done
    assert "cut.mcap" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("command", ["info", "verify", "replay", "export"])
def test_a_file_that_is_not_mcap(tmp_path: Path, command: str) -> None:
    path = tmp_path / "notes.mcap"
    path.write_text("these are notes\n" * 20)
    more = ["--format", "csv", "--out", tmp_path / "csv"] if command == "export" else []
    done = roclog(command, path, *more)
    assert done.returncode == 5, done
    one_line(done, "notes.mcap", "not an MCAP file")


def test_a_topic_that_is_not_there(tmp_path: Path, recording: Recorder) -> None:
    more = ["--format", "csv", "--out", tmp_path / "csv", "--channel", "/roc7/*"]
    done = roclog("export", recording.directory, *more)
    assert done.returncode == 2, done
    assert "/roc7/*" in done.stderr
    assert "Traceback" not in done.stderr

"""Who is there: the real command against independent devices, which tell what they were asked."""

from __future__ import annotations

import json
import signal
import socket
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bench.msx import Msx
from bench.peer import Roc
from bench.process import Child
from bench.recorder import ROCLOG, Recorder, roclog
from bench.stamped import Mei
from bench.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Iterator

CROWD = Path(__file__).parents[1] / "peers/crowd.py"
BAUD = 38400
REPORT_SERVER_ID, ENCAPSULATED = "11", "2b0e0100"
IDENTITY = "HIAC, ROC, "


def scan(config: Path, name: str, *arguments: str) -> dict[str, Any]:
    done = roclog("scan", config, "--connection", name, "--json", *arguments)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    assert found["schema"] == "roclog.scan/1"
    return found


def there(found: dict[str, Any]) -> list[int]:
    return [unit["unit"] for unit in found["units"] if unit["state"] == "answers"]


def unit(found: dict[str, Any], number: int) -> dict[str, Any]:
    (wanted,) = (unit for unit in found["units"] if unit["unit"] == number)
    return dict(wanted)


def requests(truth: Truth) -> list[str]:
    """What arrived for a ROC, as it tells: PDUs; of reads, which it served, the first address."""
    own = {"made", "start", "overwritten", "ignored", "babble", "summary"}
    events = [line for line in truth.lines if line["event"] not in own]
    return [
        str(line["address"]) if line["event"] == "read" else str(line["request"]) for line in events
    ]


@contextmanager
def crowd(folder: Path, *who: str) -> Iterator[Path]:
    """A configuration of devices on one line: units 3 (there), 7 (dead) and 138 (nobody)."""
    line = [sys.executable, "-m", "roclog.simulators.serial_line", "--baud", str(BAUD)]
    line += ["--link-a", str(folder / "client"), "--link-b", str(folder / "server")]
    line += ["--turnaround", "2500us", "--silence", f"{round(3.5e7 / BAUD)}us"]
    units = [sys.executable, str(CROWD), "--port", str(folder / "server"), "--truth", str(folder)]
    units += ["--character", str(10 / BAUD), "--cycle", "0.2", *who]
    config = folder / "roclog.toml"
    text = f'[connections.line]\ntransport = "rtu"\nport = "{folder / "client"}"\n'
    text += f'baudrate = {BAUD}\nsilence = "5 chars"\n'
    for number in (3, 7, 138):
        text += f'[devices.roc{number}]\nprofile = "hiac-roc"\nconnection = "line"\n'
        text += f"unit = {number}\n"
    config.write_text(text)
    with Child(line, folder / "line", listens=True) as wire:
        wire.while_it_runs(lambda: wire.said().count("\n") == 2, "the line")
        with Child(units, folder / "crowd") as peers:
            peers.while_it_runs(peers.said, "the crowd")
            yield config


def flags(folder: Path, number: int) -> Truth:
    return Truth(folder / f"u{number}.truth.jsonl")


def test_a_crowd_on_one_line(tmp_path: Path) -> None:
    who = ("--healthy", "3-5", "--dead", "7", "--babbling", "11", "--babble", "1000")
    with crowd(tmp_path, *who) as config:
        found = scan(config, "line", "--units", "1-12,138", "--timeout", "150ms")
    assert found["asked"] == [*range(1, 13), 138]
    assert found["problem"] == ""
    assert set(there(found)) - {11} == {3, 4, 5}
    assert unit(found, 11)["state"] in ("answers", "unclear")  # it may happen to be intact
    assert unit(found, 3)["identity"].startswith(IDENTITY)
    assert unit(found, 3)["devices"] == ["roc3"]
    assert (unit(found, 4)["exception"], unit(found, 4)["devices"]) == (1, [])
    for number in (7, 138):
        assert (unit(found, number)["state"], unit(found, number)["devices"]) == (
            "silent",
            [f"roc{number}"],
        )
    assert {found["unit"] for found in found["units"]} == {3, 4, 5, 7, 11, 138}
    assert requests(flags(tmp_path, 3)) == ["0"]
    for number in (4, 5):
        assert requests(flags(tmp_path, number)) == [REPORT_SERVER_ID, ENCAPSULATED]
    assert set(requests(flags(tmp_path, 11))) <= {REPORT_SERVER_ID, ENCAPSULATED}
    assert flags(tmp_path, 7).count("ignored") == 1


def test_the_table_and_the_talk(tmp_path: Path) -> None:
    with crowd(tmp_path, "--healthy", "3-4", "--dead", "7") as config:
        given = ("--units", "3-4,7", "--timeout", "150ms")
        done = roclog("scan", config, "--connection", "line", *given)
    assert done.returncode == 0
    title, headings, *rows = done.stdout.strip().splitlines()
    assert title == "units on line"
    assert headings.split() == ["unit", "answer", "what", "it", "is", "configured", "as"]
    assert [row.split()[0] for row in rows] == ["3", "4", "7"]
    assert IDENTITY in rows[0]
    assert rows[0].endswith("roc3")
    assert "exception 1 (illegal function)" in rows[1]
    assert rows[2].split() == ["7", "none", "roc7"]
    assert f"line (rtu {tmp_path / 'client'}, {BAUD} Bd): asking 3 units, up to " in done.stderr
    assert "2 of 3 units answer" in done.stderr
    assert "configured and silent: roc7" in done.stderr


def test_a_pipe_gets_answers_whole(tmp_path: Path) -> None:
    """Also those that are none, as here."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        config = tmp_path / "roclog.toml"
        config.write_text(
            '[connections.net]\ntransport = "udp"\nhost = "127.0.0.1"\n'
            f"port = {peer.getsockname()[1]}\n"
            '[devices.x]\nprofile = "hiac-roc"\nconnection = "net"\nunit = 1\n'
        )
        given = ("--units", "8-9", "--timeout", "5s")
        command = [*ROCLOG, "scan", str(config), "--connection", "net", *given]
        with Child(command, tmp_path / "scan") as child:
            peer.settimeout(20)
            for _ in range(4):  # each unit twice
                request, address = peer.recvfrom(300)
                peer.sendto(request[:2] + bytes(30), address)
            assert child.wait() == 4
    octets = " ".join(["00"] * 30)
    assert f"not one answer (octets 00 02 {octets})" in child.said()
    assert f"not one answer (octets 00 04 {octets})" in child.said()
    assert "unclear and not counted: units 8-9; " in child.talk()


def test_a_raised_flag_stays(tmp_path: Path) -> None:
    """And its sample with it: recorded afterwards as if nobody had looked."""
    with Roc(tmp_path, cycle=0.3, samples=3, linger=60) as roc:
        config = tmp_path / "scan.toml"
        config.write_text(roc.toml())
        first = roclog("read", config, "roc1", "--json")  # its clock starts with this
        assert first.returncode == 0, first.stderr
        roc.wait_for("made", 3)
        before = len(roc.truth.lines)
        found = scan(config, "roc1_line", "--units", "0-3,138,255", "--timeout", "100ms")
        assert there(found) == [138]
        told = roc.truth.lines[before:]
        assert [line["event"] for line in told if line["event"] != "ignored"] == ["read"]
        assert [line["unit"] for line in told if line["event"] == "ignored"] == [0, 1, 2, 3, 255]
        blocks = json.loads(roclog("read", config, "roc1", "--json").stdout)["blocks"]
        assert blocks["sample"]["registers"] == [1, *roc.truth.made[3]["registers"][1:]]
        truth = roc.end()
    assert truth.count("clear") == truth.count("write") == truth.count("exception") == 0


@pytest.mark.parametrize(("late_by", "answer"), [(0.25, "identity"), (0.45, "too late, when")])
def test_an_answer_that_comes_late(tmp_path: Path, late_by: float, answer: str) -> None:
    """Time-out 200 ms, and nothing is sent for as long again."""
    with Roc(tmp_path, line="pty", late=1.0, late_by=late_by) as roc:
        config = tmp_path / "roclog.toml"
        config.write_text(roc.toml())
        found = scan(config, "roc1_line", "--units", "137-140", "--timeout", "200ms")
        truth = roc.end()
    assert there(found) == [138]
    assert unit(found, 138)["answer"].startswith(answer)
    assert requests(truth) == ["0"]


@pytest.mark.parametrize("line", ["tcp", "pty"])
def test_a_device_with_stamps(tmp_path: Path, line: str) -> None:
    """It knows function 43, and not this MEI type."""
    with Mei(tmp_path, line=line, unit=9) as mei:
        config = tmp_path / "roclog.toml"
        where = f'transport = "rtu"\nport = "{mei.address}"'
        if line == "tcp":
            where = f'transport = "tcp"\nhost = "127.0.0.1"\nport = {mei.address}'
        config.write_text(
            f'[connections.line]\n{where}\n[devices.x]\nprofile = "hiac-roc"\n'
            'connection = "line"\nunit = 1\n'
        )
        found = scan(config, "line", "--units", "8-10", "--timeout", "150ms")
        truth = mei.end()
    assert there(found) == [9]
    assert unit(found, 9)["exception"] == 1
    asked = [line["request"] for line in truth.of("exception")]
    assert asked == [REPORT_SERVER_ID, ENCAPSULATED]
    assert truth.count("answer") == 0


@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_an_msx_is_not_asked(tmp_path: Path, transport: str) -> None:
    with Msx(tmp_path, transport) as module:
        config = tmp_path / "roclog.toml"
        config.write_text(module.toml())
        done = roclog("scan", config, "--connection", "lab")
        before = [line["event"] for line in module.truth.lines]
        assert done.returncode == 2
        assert "msx1 (msx-e3317) is there, whose registers are functions" in done.stderr
        assert done.stdout == ""
        truth = module.end()
    assert set(before) <= {"start"}
    assert {line["event"] for line in truth.lines} <= {"start", "end", "summary"}


def test_nobody_answers(tmp_path: Path) -> None:
    with Roc(tmp_path, unit=138) as roc:
        config = tmp_path / "roclog.toml"
        config.write_text(roc.toml())
        given = ("--connection", "roc1_line", "--units", "1-6", "--timeout", "50ms")
        done = roclog("scan", config, *given)
        assert done.returncode == 4
        assert "roc1_line: no unit answered" in done.stderr
        roc.end()
    done = roclog("scan", config, *given)
    assert done.returncode == 4
    assert "cannot be opened" in done.stderr


def test_a_port_that_a_recording_has(tmp_path: Path) -> None:
    with Roc(tmp_path, line="pty") as roc:
        recorder = Recorder(tmp_path, roc.toml())
        with recorder.start() as child:
            roc.wait_for("read")
            reads = roc.truth.count("exception")
            done = roclog("scan", recorder.config, "--connection", "roc1_line")
            assert done.returncode == 4
            assert "cannot be opened: another program has it open" in done.stderr
            assert child.stop() == 0
        assert roc.end().count("exception") == reads == 0


def test_ctrl_c_prints_what_was_found(tmp_path: Path) -> None:
    with crowd(tmp_path, "--healthy", "3-4") as config:
        command = [*ROCLOG, "scan", str(config), "--connection", "line", "--json"]
        with Child(command, tmp_path / "scan") as child:
            arrived = lambda: flags(tmp_path, 4).count("exception")  # noqa: E731
            child.while_it_runs(arrived, "unit 4 to be asked")
            assert child.stop(signal.SIGINT) == 130
            found = json.loads(child.said())
            assert "Traceback" not in child.talk()
    assert found["problem"] == "interrupted"
    assert 3 in there(found)
    assert found["asked"] in ([1, 2, 3], [1, 2, 3, 4], [1, 2, 3, 4, 5])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--connection", "lime"), "has no connection 'lime'; it has line, did you mean"),
        (("--connection", "line", "--units", "0-3"), "0-3 is not possible"),
        (("--connection", "line", "--units", "248"), "units there are 1-247"),
        (("--connection", "line", "--units", "9-3"), "9-3 ends before it begins"),
        (("--connection", "line", "--units", "1,,2"), "'' is neither a unit nor a range"),
        (("--connection", "line", "--units", "1-"), "'1-' is neither a unit nor a range"),
        (("--connection", "line", "--timeout", "0ms"), "is less than 1ms"),
        (("--connection", "line", "--timeout", "fast"), "'fast' is not a duration"),
        ((), "Missing option '--connection'"),
    ],
)
def test_wrong_usage(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    config = tmp_path / "roclog.toml"
    config.write_text(
        '[connections.line]\ntransport = "rtu"\nport = "/dev/null"\n'
        '[devices.x]\nprofile = "hiac-roc"\nconnection = "line"\nunit = 1\n'
    )
    done = roclog("scan", config, *arguments)
    assert done.returncode == 2
    assert words in " ".join(done.stderr.split())
    assert done.stdout == ""

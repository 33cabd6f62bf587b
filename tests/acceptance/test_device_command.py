"""`roclog device` against the independent ROC: what is asked, what is there, what is told."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Self

import pytest
from bench.msx import STATUS, TYPE, Msx
from bench.peer import Roc
from bench.process import Child, until
from bench.recorder import ROCLOG, Recorder, roclog

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from subprocess import CompletedProcess

    from bench.truth import Line

    Make = Callable[..., "Bench"]

FAST: Final = 'timeout = "200ms"'
REQUESTS: Final = ("read", "write", "reset", "clear", "refused", "exception", "ignored")
NONE: Final = 0xFFFD
"""-3 as a word: no limit."""


class Bench:
    """One device and its configuration."""

    def __init__(self, folder: Path, line: str, unit: int | None, **options: Any) -> None:
        settled = {"cycle": 0.2, "samples": 10**6, **options}
        self.roc = Roc(folder, line=line, **settled)
        text = self.roc.toml(FAST)
        if unit is not None:
            text = text.replace(f"unit = {options.get('unit', 138)}", f"unit = {unit}")
        self.recorder = Recorder(folder, text)
        self.config = self.recorder.config

    def do(self, what: str, *arguments: str) -> CompletedProcess[str]:
        return roclog("device", what, self.config, "roc1", *arguments)

    def settings(self) -> dict[str, int]:
        """The words, as the device says them."""
        done = self.do("get", "--json")
        assert done.returncode == 0, done.stderr
        return {s["name"]: s["raw"] for s in json.loads(done.stdout)["settings"]}

    def lines(self, *events: str) -> list[Line]:
        return [line for line in self.roc.truth.lines if line["event"] in events]

    def writes(self) -> list[tuple[int, int, list[int]]]:
        """Function, register, values of everything that was asked to be written."""
        found = self.lines("write", "reset", "clear")
        return [(w["function"], w.get("address", 300), w.get("values", [0])) for w in found]

    def power_cycle(self) -> None:
        number = self.roc.truth.count("power")
        self.roc.child.send(signal.SIGUSR1)
        self.roc.wait_for("power", number + 2)


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    made: list[Bench] = []

    def start(line: str = "tcp", unit: int | None = None, **options: Any) -> Bench:
        made.append(Bench(tmp_path, line, unit, **options))
        return made[-1]

    yield start
    for bench in made:
        bench.roc.child.kill()


LINES = pytest.mark.parametrize("line", ["tcp", "pty"])


@LINES
def test_what_is_set_is_in_the_device(make: Make, line: str) -> None:
    bench = make(line)
    before = bench.settings()
    wanted = ["sample_period=1min", "hold_period=01:05", "alarm_trigger=iso", "alarm_direction=0"]
    done = bench.do("set", *wanted, "alarm_logic=ActiveOpen", "limit_1=180", "limit_4=0", "--yes")
    assert done.returncode == 0, done.stderr
    assert bench.writes() == [
        (6, 105, [0x0100]),
        (6, 106, [0x0105]),
        (6, 107, [1]),
        (6, 108, [0]),
        (6, 109, [1]),
        (6, 110, [180]),
        (6, 113, [0]),
    ]
    assert bench.settings() == before | {
        "sample_period": 0x0100,
        "hold_period": 0x0105,
        "alarm_trigger": 1,
        "alarm_direction": 0,
        "alarm_logic": 1,
        "limit_1": 180,
        "limit_4": 0,
    }
    rows = [row.split() for row in done.stdout.splitlines()]
    assert ["105", "sample_period", "00:10", "01:00", "0100"] in rows
    assert "7 written and read back; the others are what they were" in done.stdout
    assert "not saved: after a loss of power or a reset the old values are back" in done.stderr
    assert f"`roclog device save {bench.config} roc1`" in done.stderr


def test_both_readings_of_a_limit_are_shown(make: Make) -> None:
    bench = make()
    assert bench.do("set", "alarm_trigger=1", "limit_1=180", "limit_2=29", "--yes").returncode == 0
    done = bench.do("get", "limit_1", "limit_2", "limit_3")
    rows = {line.split()[2]: line for line in done.stdout.splitlines() if " limit_" in line}
    assert "180 in whole numbers, out of range, or 18.0 in tenths" in rows["limit_1"]
    assert "29 in whole numbers or 2.9 in tenths" in rows["limit_2"]
    assert "FFFD  limit_3  -3" in rows["limit_3"]
    assert '"0-29" and "1-digit implied decimal"' in done.stderr
    assert "alarm_trigger (107) says which" in done.stderr
    found = {s["name"]: s for s in json.loads(bench.do("get", "--json").stdout)["settings"]}
    assert [(r["value"], r["inside"]) for r in found["limit_1"]["readings"]] == [
        (180, False),
        (18.0, True),
    ]
    assert found["limit_3"]["meaning"] == "none"


def test_identify(make: Make) -> None:
    bench = make("pty")
    done = bench.do("identify")
    assert done.returncode == 0, done.stderr
    rows = [line.split(maxsplit=2) for line in done.stdout.splitlines()]
    assert any(row[1:2] == ["serial_number"] and "1203270042" in row[2] for row in rows)
    found = json.loads(bench.do("identify", "--json").stdout)
    assert found["schema"] == "roclog.device.identify/1"
    assert found["identity"]["model"] == "ROC"
    assert found["identity"]["firmware_version"] == 1.04
    assert found["identity"]["firmware_number"] == "2089263-1 RevC"
    assert bench.writes() == []


def test_wrong_settings_are_refused_before_a_byte_is_sent(make: Make) -> None:
    bench = make()
    wrong = {
        "node_id=248": "node_id: 248 is not 1 to 247",
        "sample_period=4s": "sample_period: 00:04 is not 00:05 to 59:59",
        "hold_period=1h": "hold_period: 60:00 is not 00:02 to 59:59",
        "alarm_logic=shut": "alarm_logic: 'shut' is not a whole number, nor one of active closed",
        "limit_1=291": "limit_1: 291 is not one of -3, 0 to 290 (ISO)",
        "sample=10s": "sample: no such setting; there is node_id,",
        "date_year=1999": "date_year: 1999 is not 2000 to 2100",
        "alarm_direction": "'alarm_direction': write NAME=VALUE",
    }
    done = bench.do("set", *wrong, "alarm_trigger=ISO", "--save", "--yes")
    assert done.returncode == 2
    for text in wrong.values():
        assert text in done.stderr
    assert bench.do("set", "sample_period=3s").returncode == 2
    assert bench.do("get", "sample_period", "nonsense").returncode == 2
    assert bench.lines(*REQUESTS) == []


def test_a_limit_without_a_range_is_refused_before_anything_is_written(make: Make) -> None:
    """Under which of ISO, NAS and SAE it would count only the device can tell."""
    bench = make()
    done = bench.do("set", "limit_1=18", "sample_period=20s", "--yes")
    assert done.returncode == 2
    assert "limit_1: the document gives no range while alarm_trigger is system" in done.stderr
    assert bench.writes() == []
    assert bench.settings()["limit_1"] == NONE


@pytest.mark.parametrize("what", [("set", "sample_period=20s"), ("save",), ("reset",)])
def test_without_a_terminal_nobody_can_agree(make: Make, what: tuple[str, ...]) -> None:
    bench = make()
    for more in ((), ("--json",)):
        done = bench.do(*what, *more)
        assert done.returncode == 2
        assert "add --yes" in done.stderr
    assert bench.lines(*REQUESTS) == []


class Asked:
    """A command at a terminal, up to its question."""

    def __init__(self, *arguments: str) -> None:
        self._master, slave = pty.openpty()
        command = [*ROCLOG, "device", *arguments]
        self._process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)
        self.said = b""

    def __enter__(self) -> Self:
        until(self._hears, "the question")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._master)

    def answer(self, answer: str | signal.Signals) -> int:
        """The exit code. What it says meanwhile must not stop it."""
        if isinstance(answer, str):
            os.write(self._master, answer.encode())
        else:
            self._process.send_signal(answer)
        until(lambda: self._hears() or self._process.poll() is not None, "its end")
        return self._process.wait(20)

    def _hears(self) -> bool:
        before = self.said.count(b"[y/N]")
        with suppress(OSError):  # its end is closed
            if select.select([self._master], [], [], 0.05)[0]:
                self.said += os.read(self._master, 4096)
        return self.said.count(b"[y/N]") > before


STOPPED: Final = "roc1: interrupted; nothing was"
"""What who stops it at the question is told: nothing was sent, or written."""


@pytest.mark.parametrize(
    ("answer", "code", "told"),
    [
        ("n\n", 0, "roc1: nothing was sent\r\n"),
        ("\n", 0, "roc1: nothing was sent\r\n"),
        ("\x04", 130, STOPPED),
        (signal.SIGINT, 130, STOPPED),
        (signal.SIGTERM, 143, STOPPED),
        ("y\n", 0, "1 written and read back"),
    ],
    ids=["no", "enter", "ctrl-d", "ctrl-c", "sigterm", "yes"],
)
def test_the_question_at_a_terminal(
    make: Make, answer: str | signal.Signals, code: int, told: str
) -> None:
    bench = make()
    with Asked("set", str(bench.config), "roc1", "sample_period=20s") as asked:
        assert bench.writes() == []
        assert b"sample_period" in asked.said
        assert b"00:20" in asked.said
        assert asked.answer(answer) == code
        assert told in asked.said.decode()
        assert b"unexpected" not in asked.said
    assert bench.writes() == ([(6, 105, [20])] if answer == "y\n" else [])


def test_what_changed_while_the_question_stood_is_not_written_over(make: Make) -> None:
    """Somebody agreed to what was shown, and that is not what is there any more."""
    bench = make()
    assert bench.do("set", "sample_period=20s", "--yes").returncode == 0
    with Asked("save", str(bench.config), "roc1") as asked:
        bench.power_cycle()
        assert asked.answer("y\n") == 1
    assert b"is not as it was shown any more (register 105); nothing was written" in asked.said
    assert bench.writes() == [(6, 105, [20])]


def test_a_unit_that_somebody_has_is_not_taken(tmp_path: Path) -> None:
    """Two simulated devices behind one address, of which the configuration knows one."""
    served = [*ROCLOG, "simulate", "hiac-roc:138", "hiac-roc:17", "--tcp", "127.0.0.1:0"]
    with Child(served, tmp_path / "served") as child:
        talk = child.while_it_runs(lambda: re.search(r"127\.0\.0\.1:(\d+)", _all(child)), "a port")
        assert talk is not None
        config = tmp_path / "roclog.toml"
        config.write_text(
            f'[connections.net]\ntransport = "tcp"\nhost = "127.0.0.1"\nport = {talk[1]}\n'
            '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "net"\n'
        )
        done = roclog("device", "set", config, "roc1", "node_id=17", "--yes")
        assert done.returncode == 1
        assert "cannot become unit 17: another device answers there; nothing was" in done.stderr
        done = roclog("device", "set", config, "roc1", "node_id=18", "--yes", "--json")
        assert done.returncode == 0, done.stderr
        assert [step["new"] for step in json.loads(done.stdout)["wanted"]] == [18]


def _all(child: Child) -> str:
    return child.said() + child.talk()


@pytest.mark.parametrize("line", ["tcp", "pty"])
@pytest.mark.parametrize("effect", ["lose", "deaf"])
def test_an_unanswered_write_is_looked_into_and_not_repeated(
    make: Make, effect: str, line: str
) -> None:
    bench = make(line, settings=effect, settings_from=2)
    done = bench.do("set", "sample_period=20s", "hold_period=10s", "alarm_logic=1", "--yes")
    if effect == "lose":
        assert done.returncode == 0, done.stderr
        assert "the device has taken the value all the same" in done.stderr
        assert [address for _, address, _ in bench.writes()] == [105, 106, 109]
    else:
        assert done.returncode == 1
        assert "register 106 (hold_period): " in done.stderr
        assert "not written, and not tried again" in done.stderr
        assert [address for _, address, _ in bench.writes()] == [105, 106]
    found = bench.settings()
    assert (found["sample_period"], found["hold_period"]) == (20, 10 if effect == "lose" else 5)


def test_a_refused_write_ends_it(make: Make) -> None:
    bench = make(settings="refuse", settings_from=2)
    done = bench.do(
        "set", "sample_period=20s", "hold_period=10s", "alarm_logic=1", "--save", "--yes"
    )
    assert done.returncode == 1
    assert "register 106 (hold_period): the device refused" in done.stderr
    assert "exception 3" in done.stderr
    assert "nothing was saved" in done.stderr
    assert "written all the same, and not saved: sample_period 00:20\n" in done.stderr
    assert bench.writes() == [(6, 105, [20]), (6, 106, [10])]


def test_what_does_not_read_back_is_told_and_not_saved(make: Make) -> None:
    bench = make(settings="ignore")
    done = bench.do("set", "sample_period=20s", "--save", "--yes", "--json")
    assert done.returncode == 1
    text = "register 105 (sample_period): wanted 00:20, found 00:10, the old value"
    assert text in done.stderr
    found = json.loads(done.stdout)
    assert text in found["problems"][0]
    assert found["saved"] is False
    assert [address for _, address, _ in bench.writes()] == [105]


@LINES
def test_power_fails_between_set_and_save(make: Make, line: str) -> None:
    """The old values are back, people see them, and `set --save` does not save them."""
    bench = make(line)
    assert bench.do("set", "sample_period=20s", "hold_period=10s", "--yes").returncode == 0
    bench.power_cycle()
    done = bench.do("save", "--yes")
    assert done.returncode == 0
    shown = {row[2]: row[3] for row in map(str.split, done.stdout.splitlines()) if len(row) > 3}
    assert (shown["sample_period"], shown["hold_period"]) == ("00:10", "00:05")


@LINES
def test_power_fails_before_it_could_be_saved(make: Make, line: str) -> None:
    bench = make(line, power_fails_after=2)
    done = bench.do("set", "sample_period=20s", "hold_period=10s", "--save", "--yes")
    assert done.returncode == 1
    assert "register 105 (sample_period): wanted 00:20, found 00:10, the old value" in done.stderr
    assert "nothing was saved" in done.stderr
    assert [address for _, address, _ in bench.writes()] == [105, 106]


def test_what_is_known_is_told_when_something_fails_later(make: Make) -> None:
    bench = make(settings="lose", power_fails_after=2)
    done = bench.do("set", "sample_period=20s", "hold_period=10s", "--yes")
    assert done.returncode == 1
    assert "register 105 (sample_period): " in done.stderr
    assert "the device has taken the value all the same" in done.stderr
    assert "register 106 (hold_period): " in done.stderr
    assert "not written, and not tried again" in done.stderr


def test_a_save_without_an_answer_is_not_known(make: Make) -> None:
    """It may have been done: that it was not must not be claimed."""
    bench = make(lose_command=1102)
    done = bench.do("set", "sample_period=20s", "--save", "--yes", "--json")
    assert done.returncode == 4
    assert "whether the values are saved is not known" in done.stderr
    assert "written all the same, and perhaps saved: sample_period 00:20\n" in done.stderr
    assert "not saved" not in done.stderr
    assert "nothing was saved" not in done.stderr
    assert json.loads(done.stdout)["saved"] is None
    assert bench.writes() == [(6, 105, [20]), (6, 1102, [0x5A])]


@pytest.mark.parametrize(("code", "took"), [(4, True), (5, True), (5, False), (6, False)])
def test_an_acknowledge_to_a_save_is_not_known(make: Make, code: int, *, took: bool) -> None:
    """The standard: 5 is accepted and at work still, 6 is busy, 4 went wrong on the way."""
    bench = make(refuse_command=1102, refuse_with=code, refuse_done=took)
    done = bench.do("set", "sample_period=20s", "--save", "--yes", "--json")
    assert done.returncode == 1
    assert f"roc1: register 1102 (save): exception {code} " in done.stderr
    assert "perhaps saved; whether the values are saved is not known" in done.stderr
    assert "save once more" in done.stderr
    assert "written all the same, and perhaps saved: sample_period 00:20\n" in done.stderr
    assert "refused" not in done.stderr
    assert "nothing was saved" not in done.stderr
    assert json.loads(done.stdout)["saved"] is None
    bench.power_cycle()
    assert bench.settings()["sample_period"] == (20 if took else 10)


@LINES
def test_a_write_that_is_acknowledged_and_done_later(make: Make, line: str) -> None:
    """Exception 5 is no refusal: what is read back is what counts."""
    bench = make(line, settings="acknowledge", settings_with=5, settings_from=2)
    done = bench.do("set", "sample_period=20s", "hold_period=10s", "--save", "--yes")
    assert done.returncode == 0, done.stderr
    text = "register 106 (hold_period): exception 5 (acknowledge) to function 6; the device has"
    assert text in done.stderr
    assert bench.writes() == [(6, 105, [20]), (6, 106, [10]), (6, 1102, [0x5A])]


@pytest.mark.parametrize("code", [4, 6])
def test_a_write_that_stays_open_is_not_written(make: Make, code: int) -> None:
    bench = make(settings="refuse", settings_with=code)
    done = bench.do("set", "sample_period=20s", "--save", "--yes", "--json")
    assert done.returncode == 1
    assert f"register 105 (sample_period): exception {code} " in done.stderr
    assert "not written so far, and not tried again" in done.stderr
    assert "nothing was saved" in done.stderr
    assert json.loads(done.stdout)["saved"] is False
    assert bench.writes() == [(6, 105, [20])]


def test_old_values_that_were_saved_by_bad_luck(make: Make) -> None:
    """The power failed for a moment between the read and the save."""
    bench = make(save_finds_old=True)
    done = bench.do("set", "sample_period=20s", "--save", "--yes", "--json")
    assert done.returncode == 1
    assert "register 105 (sample_period) after saving: wanted 00:20, found 00:10" in done.stderr
    text = "what is read back from 105 now, the old values, is perhaps what it has saved"
    assert f"roc1: register 1102 (save): saving was acknowledged, but {text}" in done.stderr
    assert json.loads(done.stdout)["saved"] is None
    bench.power_cycle()
    assert bench.settings()["sample_period"] == 10


@pytest.mark.parametrize(
    ("number", "code", "more"),
    [(signal.SIGINT, 130, ()), (signal.SIGTERM, 143, ()), (signal.SIGTERM, 143, ("--json",))],
)
def test_who_stops_it_is_told_what_has_left(
    make: Make, number: int, code: int, more: tuple[str, ...]
) -> None:
    bench = make(settings="deaf", settings_from=2)
    slow = bench.config.read_text().replace(FAST, 'timeout = "20s"')
    bench.config.write_text(slow)
    command = [*ROCLOG, "device", "set", str(bench.config), "roc1", "--yes", *more]
    wanted = ["sample_period=20s", "hold_period=10s", "alarm_logic=1"]
    with Child([*command, *wanted], bench.config.parent / "set") as child:
        child.while_it_runs(lambda: len(bench.writes()) == 2, "the second write")
        assert child.stop(number) == code
        told, said = child.talk(), child.said()
    if more:
        problems = json.loads(said)["problems"]
        assert "roc1: interrupted; sent, and not read back: sample_period" in problems[0]
    assert "interrupted; sent, and not read back: sample_period 00:20, hold_period 00:10;" in told
    assert f"`roclog device get {bench.config} roc1` shows what it holds" in told
    assert "Traceback" not in told


def test_a_device_that_is_gone_after_a_write(make: Make) -> None:
    """Nothing is claimed that was not read."""
    bench = make(cycle=60, power_fails_after=1)
    done = bench.do("set", "alarm_logic=1", "alarm_direction=0", "--save", "--yes", "--json")
    assert done.returncode == 4
    assert "what the device holds now is not known, it cannot be read" in done.stderr
    assert "roc1: sent, and not read back: alarm_direction 0" in done.stderr
    assert "nothing was saved" in done.stderr
    found = json.loads(done.stdout)
    assert (found["saved"], found["settings"], found["unit"]) == (False, None, None)
    assert len(bench.writes()) == 1


@pytest.mark.parametrize("at_once", [True, False])
def test_saved_settings_survive_a_loss_of_power(make: Make, at_once: bool) -> None:
    bench = make()
    more = ["--save"] if at_once else []
    done = bench.do("set", "sample_period=20s", *more, "--yes", "--json")
    assert json.loads(done.stdout)["saved"] is at_once
    assert ("not saved" in done.stderr) is not at_once
    if not at_once:
        assert bench.do("save", "--yes").returncode == 0
    assert bench.writes() == [(6, 105, [20]), (6, 1102, [0x5A])]
    bench.power_cycle()
    assert bench.settings()["sample_period"] == 20


def test_a_refused_save(make: Make) -> None:
    bench = make(refuse_command=1102)
    done = bench.do("save", "--yes")
    assert done.returncode == 1
    assert "register 1102 (save): the device refused to save: exception 3" in done.stderr
    assert "nothing was saved" in done.stderr
    assert bench.writes() == [(6, 1102, [0x5A])]


@LINES
def test_a_reset_without_an_answer(make: Make, line: str) -> None:
    bench = make(line, reset_takes=1.5)
    assert bench.do("set", "sample_period=20s", "--yes").returncode == 0
    done = bench.do("reset", "--yes")
    assert done.returncode == 0, done.stderr
    assert "roc1 was reset, and says that it is the same device" in done.stdout
    assert "register 105 (sample_period) is 00:10 again: 00:20 was not saved" in done.stderr
    assert bench.writes()[1:] == [(6, 1101, [0x55])]


def test_a_device_that_was_silent_was_reset(make: Make) -> None:
    """Nothing was unsaved: that it was gone for a while is all there is to see."""
    bench = make(reset_takes=1.5)
    found = json.loads(bench.do("reset", "--yes", "--json").stdout)
    assert (found["schema"], found["done"]) == ("roclog.device.reset/1", True)
    assert re.fullmatch(r"it did not answer for \d\.\d s", found["remarks"][0])
    assert bench.writes() == [(6, 1101, [0x55])]


@LINES
def test_a_reset_that_was_not_heard_is_not_claimed(make: Make, line: str) -> None:
    """It never stopped to answer, so nobody knows, and what would tell is named."""
    bench = make(line, deaf_command=1101)
    assert bench.do("set", "sample_period=20s", "--yes").returncode == 0
    done = bench.do("reset", "--yes")
    assert done.returncode == 0, done.stderr
    assert "was reset, " not in done.stdout
    assert "answers again" not in done.stdout
    assert "roc1 answers, and says that it is the same device; whether it was" in done.stdout
    assert "it answered all the time" in done.stderr
    assert "One that was not saved would have fallen back: if there was one, it" in done.stderr
    found = json.loads(bench.do("reset", "--yes", "--json").stdout)
    assert found["done"] is None
    assert "register 1101 (reset) has no answer" in found["remarks"][0]
    assert len(bench.lines("reset")) == 0
    assert bench.settings()["sample_period"] == 20


@pytest.mark.parametrize("took", [True, False])
def test_an_acknowledge_to_a_reset(make: Make, *, took: bool) -> None:
    """Exception 5: it is at it still, or not; what it does then tells."""
    bench = make(refuse_command=1101, refuse_with=5, refuse_done=took)
    assert bench.do("set", "sample_period=20s", "--yes").returncode == 0
    done = bench.do("reset", "--yes", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["done"] is (True if took else None)
    assert "register 1101 (reset): exception 5 (acknowledge)" in found["remarks"][0]
    assert "perhaps it resets all the same" in found["remarks"][0]


def test_a_refused_reset(make: Make) -> None:
    bench = make(refuse_command=1101)
    done = bench.do("reset", "--yes")
    assert done.returncode == 1
    assert "roc1: register 1101 (reset): the device refused to reset: exception 3" in done.stderr
    found = json.loads(bench.do("reset", "--yes", "--json").stdout)
    assert (bool(found["problems"]), found["done"]) == (True, False)


def test_a_gateway_that_passes_nothing_on_has_reset_nothing(make: Make) -> None:
    bench = make(refuse_command=1101, refuse_with=10)
    done = bench.do("reset", "--yes")
    assert done.returncode == 4
    assert "refused to reset: exception 10 (gateway path unavailable)" in done.stderr
    assert "answers" not in done.stdout


def test_a_device_that_does_not_come_back(make: Make) -> None:
    bench = make(reset_takes=60)
    done = bench.do("reset", "--yes", "--wait", "1s")
    assert done.returncode == 4
    assert "roc1: it did not come back within 1 s after the reset" in done.stderr
    assert len(bench.writes()) == 1


def test_a_unit_that_was_not_touched_is_not_mentioned(make: Make) -> None:
    """Behind many TCP servers any unit will do, whatever register 100 says."""
    bench = make()
    done = bench.do("set", "node_id=17", "--yes")
    assert "then set unit = 17 of [devices.roc1]" in done.stderr
    done = bench.do("set", "hold_period=9s", "--yes")
    assert done.returncode == 0, done.stderr
    assert "set unit" not in done.stderr
    assert bench.settings()["node_id"] == 17


@LINES
def test_a_new_node_id_after_save_and_reset(make: Make, line: str) -> None:
    bench = make(line)
    done = bench.do("set", "node_id=17", "hold_period=9s", "--save", "--yes")
    assert done.returncode == 0, done.stderr
    assert bench.writes() == [(6, 106, [9]), (6, 100, [17]), (6, 1102, [0x5A])]
    assert "answers to unit 138 still, maybe to 17" in done.stderr
    done = bench.do("reset", "--yes")
    assert done.returncode == 0, done.stderr
    assert "roc1 answers to unit 17 from now on: set unit = 17 of [devices.roc1]" in done.stderr
    assert bench.do("get").returncode == 4
    bench.config.write_text(bench.config.read_text().replace("unit = 138", "unit = 17"))
    assert bench.settings()["hold_period"] == 9


@LINES
def test_a_node_id_that_counts_at_once(make: Make, line: str) -> None:
    bench = make(line, node_id_now=True)
    done = bench.do("set", "node_id=17", "--save", "--yes")
    assert done.returncode == 0, done.stderr
    assert "answers to unit 17 from now on" in done.stderr
    assert bench.writes() == [(6, 100, [17]), (6, 1102, [0x5A])]


def test_a_node_id_that_another_device_of_the_configuration_has(make: Make) -> None:
    bench = make()
    other = '\n[devices.roc2]\nprofile = "hiac-roc"\nconnection = "roc1_line"\nunit = 17\n'
    bench.config.write_text(bench.config.read_text() + other)
    done = bench.do("set", "node_id=17", "--yes")
    assert done.returncode == 2
    assert "node_id: 17 is the unit of roc2 on the same line" in done.stderr
    assert bench.lines(*REQUESTS) == []
    shared = bench.config.read_text().replace("unit = 17\n", "unit = 138\nacknowledge = false\n")
    bench.config.write_text(shared)
    done = bench.do("set", "node_id=138", "--yes")
    assert done.returncode == 0, done.stderr
    assert "node_id is 138 already, and is not written" in done.stdout


def test_a_clock_without_a_zone_is_said_to_be_utc(make: Make) -> None:
    bench = make()
    text = "clock: 2027-02-03T04:05:06 names no zone, it is taken as UTC"
    done = bench.do("set", "clock=2027-02-03T04:05:06", "--yes")
    assert done.returncode == 0, done.stderr
    assert f"roclog: note: {text}\n" in done.stderr
    assert bench.settings()["time_hour"] == 4
    done = bench.do("set", "clock=2027-02-03T04:05:06", "--yes", "--json")
    assert text in json.loads(done.stdout)["remarks"]
    done = bench.do("set", "clock=2027-02-03T04:05:06+02:00", "--yes")
    assert "names no zone" not in done.stderr
    assert bench.settings()["time_hour"] == 2


def test_notes_of_the_document_come_where_they_are_asked_for(make: Make) -> None:
    bench = make()
    for names, notes in {
        (): (),
        ("sample_period",): (),
        ("time_hour",): ("clock, unused",),
        ("limit_2",): ("both readings",),
    }.items():
        told = bench.do("get", *names).stderr
        assert [n for n in ("clock, unused", "both readings") if n in told] == list(notes)
    assert "note" not in bench.do("save", "--yes").stderr
    assert bench.do("set", "alarm_trigger=1", "limit_1=180", "--yes").returncode == 0
    assert "both readings" in bench.do("get").stderr


@LINES
def test_refused_reads_are_told_at_once_with_their_registers(make: Make, line: str) -> None:
    bench = make(line, refuse_read=100)
    done = bench.do("get", "--json")
    assert done.returncode == 4
    text = "roc1: holding registers 100 to 113 (configuration): exception 2 (illegal data address)"
    assert text in done.stderr
    found = json.loads(done.stdout)
    assert (found["schema"], found["device"]) == ("roclog.device.get/1", "roc1")
    assert text in found["problems"][0]
    assert bench.roc.truth.count("exception") == 1


def test_every_error_is_an_object_too(make: Make) -> None:
    """As `check --json` does it: who reads stdout as JSON is never left with nothing."""
    bench = make(unit=17)
    for what, code in {
        ("identify",): 4,
        ("get", "nonsense"): 2,
        ("set", "sample_period=1s", "hold_period=1s", "--yes"): 2,
        ("save",): 2,
        ("reset", "--yes"): 4,
    }.items():
        done = bench.do(*what, "--json")
        assert done.returncode == code, done.stderr
        found = json.loads(done.stdout)
        assert found["schema"] == f"roclog.device.{what[0]}/1"
        assert all(problem in done.stderr for problem in found["problems"])
        assert len(found["problems"]) == (2 if "hold_period=1s" in what else 1)
    bench.config.write_text(bench.config.read_text() + "bogus = 1\n")
    done = bench.do("get", "--json")
    assert done.returncode == 3
    assert "bogus" in json.loads(done.stdout)["problems"][0]


def test_a_refused_function_says_why(tmp_path: Path) -> None:
    """As `check --probe` and `read` do: the status text, asked for at once."""
    config = tmp_path / "roclog.toml"
    with Msx(tmp_path, fail=f"{TYPE}:-100:5:no EEPROM") as module:
        config.write_text(module.toml())
        done = roclog("device", "identify", config, "msx1")
        truth = module.end()
    assert done.returncode == 4
    assert f"msx1: function {TYPE} (module_type): exception 9" in done.stderr
    assert "status of the last call: returned -100, errno 5: no EEPROM" in done.stderr
    assert [c["register"] for c in truth.of("call")] == [TYPE, STATUS]


def test_the_clock_is_set_and_called_unused(make: Make) -> None:
    bench = make()
    done = bench.do("set", "clock=2027-02-03T04:05:06Z", "--yes")
    assert done.returncode == 0, done.stderr
    assert "clock, unused: it may not run" in done.stderr
    found = bench.settings()
    names = ("date_year", "date_day", "time_hour", "time_minute")
    assert [found[name] for name in names] == [2027, 0x0203, 4, 0x0506]


def test_nothing_is_written_where_nothing_changes(make: Make) -> None:
    bench = make()
    done = bench.do("set", "sample_period=10s", "--yes")
    assert done.returncode == 0
    assert "sample_period is 00:10 already, and is not written" in done.stdout
    found = json.loads(bench.do("set", "sample_period=10s", "--yes", "--json").stdout)
    assert (found["schema"], found["unit"]) == ("roclog.device.set/1", 138)
    assert (found["already"], found["wanted"]) == (["sample_period"], [])
    assert len(found["settings"]) == 14
    assert bench.writes() == []


def test_a_recorder_keeps_its_serial_port(make: Make) -> None:
    bench = make("pty")
    with bench.recorder.start() as child:
        bench.recorder.wait_for_hot(child)
        done = bench.do("set", "sample_period=20s", "--yes")
        assert child.stop() == 0
    assert done.returncode == 4
    assert "another program has it open" in done.stderr
    assert "if that is `roclog record`, stop it first" in done.stderr
    assert all(address == 300 for _, address, _ in bench.writes())


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_a_bad_line(make: Make, seed: int) -> None:
    """Every write leaves once; where its answer is lost, what the device holds is what counts."""
    bench = make("pty", seed=seed, drop=0.1, corrupt=0.1, garbage=0.1, late=0.1, late_by=0.3)
    done = bench.do("set", "sample_period=20s", "hold_period=10s", "alarm_logic=1", "--yes")
    assert done.returncode == 0, done.stderr
    assert bench.writes() == [(6, 105, [20]), (6, 106, [10]), (6, 109, [1])]
    lost = [write for write in bench.lines("write") if write["fate"] in ("dropped", "corrupt")]
    assert lost
    assert done.stderr.count("the device has taken the value all the same") >= len(lost)


def test_nobody_there(make: Make) -> None:
    bench = make("pty", unit=17)
    done = bench.do("set", "sample_period=20s", "--yes")
    assert done.returncode == 4
    assert re.search(r"roclog: roc1: .*: no answer within 200 ms", done.stderr)


def test_a_plan_that_nobody_sees_is_not_asked_about(make: Make) -> None:
    """stdin is a terminal, and stdout a file."""
    bench = make()
    master, slave = pty.openpty()
    command = [*ROCLOG, "device", "save", str(bench.config), "roc1"]
    done = subprocess.run(command, stdin=slave, capture_output=True, text=True, check=False)
    os.close(master)
    os.close(slave)
    assert done.returncode == 2
    assert "there is no terminal: add --yes" in done.stderr
    assert bench.lines(*REQUESTS) == []


def test_a_function_is_called_once_to_identify(tmp_path: Path) -> None:
    """Where a register is a function, a lost answer is no reason to call it again."""
    config = tmp_path / "roclog.toml"
    for lost in (0.0, 1.0):
        (folder := tmp_path / str(lost)).mkdir()
        with Msx(folder, "udp", drop=lost) as module:
            config.write_text(module.toml())
            done = roclog("device", "identify", config, "msx1")
            truth = module.end()
        assert done.returncode == (4 if lost else 0), done.stderr
        assert ("a function is called once only: try again" in done.stderr) is bool(lost)
        assert lost or "MSX-E3317-8" in done.stdout
        assert len([line for line in truth.lines if line.get("register") == TYPE]) == 1


OTHERS: Final = (
    '[connections.net]\ntransport = "tcp"\nhost = "127.0.0.1"\nport = 1\n'
    '[devices.msx]\nprofile = "msx-e3317"\nconnection = "net"\n'
    '[connections.net2]\ntransport = "tcp"\nhost = "127.0.0.1"\nport = 2\n'
    '[devices.rtu]\nprofile = "mei-timestamped"\nconnection = "net2"\nunit = 1\n'
    'points = [{ kind = "discrete_inputs", stamp = 7, address = 0, count = 2 }]\n'
    '[devices.flow]\nprofile = "registers"\nconnection = "net2"\nunit = 9\n'
    '[[devices.flow.blocks]]\nname = "flow"\ntable = "holding_registers"\naddress = 0\ncount = 1\n'
    'points = [{ name = "rate", offset = 0, type = "uint16" }]\n'
)


@pytest.mark.parametrize("name", ["msx", "rtu", "flow"])
def test_other_families_have_nothing_to_set(tmp_path: Path, name: str) -> None:
    config = tmp_path / "roclog.toml"
    config.write_text(OTHERS)
    for what in (["get"], ["set", "a=1"], ["save"], ["reset"]):
        done = roclog("device", what[0], config, name, *what[1:])
        assert done.returncode == 2, done.stderr
        assert "declares no settings and no commands: nothing can be changed" in done.stderr
    done = roclog("device", "get", config, "nobody")
    assert (done.returncode, "has no device 'nobody'; it has msx, rtu, flow" in done.stderr) == (
        2,
        True,
    )

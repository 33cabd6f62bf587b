"""Commands against a device that says what no device of the document says."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from bus_fakes import MS, TCP, FakeLink, VirtualClock, run
from wire import mbap_frame

from roclog.bus.bus import Bus
from roclog.commanding.change import Outcome, reset
from roclog.commanding.talk import Target, look, neighbour, read_identity
from roclog.config import load
from roclog.errors import NoAnswer

if TYPE_CHECKING:
    from pathlib import Path

CONFIG = """
[connections.net]
transport = "tcp"
host = "plant"
[devices.roc1]
profile = "hiac-roc"
connection = "net"
"""
SETTINGS = [138, 2026, 0x0B17, 6, 0x0000, 10, 5, 0, 1, 0, *[0xFFFD] * 4]
"""Registers 100-113; the clock is at 06:00:00."""


class Device:
    """It answers whatever unit it is asked for. runs: its clock, a second from read to read.

    silent_for: as many questions, from a write on, stay unanswered; without_write: from the start.
    forgets: the settings that it has after a write.
    """

    def __init__(
        self,
        silent_for: int = 0,
        *,
        without_write: bool = False,
        forgets: list[int] | None = None,
    ) -> None:
        self.link = FakeLink(self._hear)
        self.settings = list(SETTINGS)
        self.runs = False
        self.asked: list[int] = []
        self._silent_for = silent_for
        self._wrote = without_write
        self._forgets = forgets

    def _hear(self, adu: bytes) -> None:
        unit, pdu = adu[6], adu[7:]
        self.asked.append(unit)
        self._wrote |= pdu[0] == 6
        if pdu[0] == 6 and self._forgets:
            self.settings = self._forgets
        if self._wrote and self._silent_for:
            self._silent_for -= 1
            return
        first, count = int.from_bytes(pdu[1:3]), int.from_bytes(pdu[3:5])
        words = [0] * count if first == 0 else self.settings
        data = b"".join(word.to_bytes(2) for word in words)
        answer = bytes([3, len(data)]) + data
        self.link.say(mbap_frame(int.from_bytes(adu[:2]), unit, answer), 5 * MS)
        self.settings[4] += self.runs and first == 100


def target(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch, timeout: int = TCP.timeout
) -> Target:
    timing = replace(TCP, timeout=timeout)
    (tmp_path / "roclog.toml").write_text(CONFIG)
    settings = load(tmp_path / "roclog.toml")
    monkeypatch.setattr(
        "roclog.commanding.talk.make_bus",
        lambda _connection, _devices, clock, writes: Bus(device.link, timing, clock, writes),
    )
    return Target(settings, settings.devices["roc1"], VirtualClock())


def test_a_register_100_that_is_no_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device(silent_for=3)
    device.settings[0] = 300

    async def main() -> None:
        one, outcome = target(tmp_path, device, monkeypatch), Outcome()
        await reset(one, await look(one), outcome, 10_000 * MS)
        assert (outcome.problems, outcome.done) == ([], True)
        assert outcome.state is not None

    run(main())
    assert set(device.asked) == {138}


def reset_of(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> Outcome:
    outcome = Outcome()

    async def main() -> None:
        one = target(tmp_path, device, monkeypatch)
        await reset(one, await look(one), outcome, 10_000 * MS)

    run(main())
    return outcome


def test_a_single_lost_answer_is_no_reset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bad line loses that much; the write itself is never answered."""
    for lost, done in {1: None, 2: None, 3: True}.items():
        outcome = reset_of(tmp_path, Device(silent_for=lost), monkeypatch)
        assert (outcome.done, outcome.problems) == (done, [])
        said = ("it answered all the time", "it left a single question unanswered", "it did not")
        assert said[lost - 1] in outcome.remarks[0]
    assert outcome.remarks == ["it did not answer for 1.9 s"]  # 3 times 0.5 s, 2 pauses of 0.2 s


def test_a_clock_that_went_back_shows_a_reset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To what its document gives as default, or only by an hour; forwards shows nothing."""
    default = [138, 0, 0, 0, *SETTINGS[4:]]
    earlier = [138, 2026, 0x0B17, 5, *SETTINGS[4:]]
    later = [138, 2026, 0x0B17, 9, *SETTINGS[4:]]
    for found, done in ((default, True), (earlier, True), (later, None)):
        device = Device(silent_for=1, forgets=found)
        outcome = reset_of(tmp_path, device, monkeypatch)
        assert (outcome.done, outcome.problems) == (done, [])
        assert ("its clock went back" in outcome.remarks) is bool(done)
    assert outcome.remarks[0] == "register 103 (time_hour) is 9, and was 6"


def test_two_lost_answers_do_not_make_a_device_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reads are asked three times, however long a time-out is."""

    async def identified(one: Target) -> None:
        assert await read_identity(one) == [(0,) * 48]

    for timeout in (900 * MS, 5000 * MS):
        device = Device(silent_for=2, without_write=True)
        run(identified(target(tmp_path, device, monkeypatch, timeout)))
        assert len(device.asked) == 3
    device = Device(silent_for=3, without_write=True)
    with pytest.raises(NoAnswer):
        run(identified(target(tmp_path, device, monkeypatch, timeout)))
    assert len(device.asked) == 3


def test_a_clock_that_runs_makes_no_neighbour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = Device()
    device.runs = True

    async def main() -> None:
        one = target(tmp_path, device, monkeypatch)
        before = await look(one)
        assert await neighbour(one, before, 17) == ""
        device.settings[5] += 1
        assert await neighbour(one, before, 17) == "another device answers there"

    run(main())
    assert set(device.asked) == {138, 17}

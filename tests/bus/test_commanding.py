"""Commands against a device that says what no device of the document says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bus_fakes import MS, TCP, FakeLink, VirtualClock, run
from wire import mbap_frame

from roclog.bus.bus import Bus
from roclog.commanding.change import Outcome, reset
from roclog.commanding.talk import Target, look, neighbour
from roclog.config import load

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

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

    silent_for: as many questions, from a write on, stay unanswered.
    """

    def __init__(self, silent_for: int = 0) -> None:
        self.link = FakeLink(self._hear)
        self.settings = list(SETTINGS)
        self.runs = False
        self.asked: list[int] = []
        self._silent_for = silent_for
        self._wrote = False

    def _hear(self, adu: bytes) -> None:
        unit, pdu = adu[6], adu[7:]
        self.asked.append(unit)
        self._wrote |= pdu[0] == 6
        if self._wrote and self._silent_for:
            self._silent_for -= 1
            return
        first, count = int.from_bytes(pdu[1:3]), int.from_bytes(pdu[3:5])
        words = [0] * count if first == 0 else self.settings
        data = b"".join(word.to_bytes(2) for word in words)
        answer = bytes([3, len(data)]) + data
        self.link.say(mbap_frame(int.from_bytes(adu[:2]), unit, answer), 5 * MS)
        self.settings[4] += self.runs and first == 100


def target(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> Target:
    (tmp_path / "roclog.toml").write_text(CONFIG)
    settings = load(tmp_path / "roclog.toml")
    monkeypatch.setattr(
        "roclog.commanding.talk.make_bus",
        lambda _connection, _devices, clock, writes: Bus(device.link, TCP, clock, writes),
    )
    return Target(settings, settings.devices["roc1"], VirtualClock())


def test_a_register_100_that_is_no_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device(silent_for=3)
    device.settings[0] = 300

    async def main() -> None:
        one, outcome = target(tmp_path, device, monkeypatch), Outcome()
        await reset(one, await look(one), outcome, 10_000 * MS)
        assert (outcome.problems, outcome.remarks) == ([], [])
        assert outcome.state is not None

    run(main())
    assert set(device.asked) == {138}


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

"""The serial link and the bus over pseudo-terminals, in real time, against a scripted peer."""

from __future__ import annotations

import asyncio
import errno
import os
import termios
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import pytest
import serial
from serial_peer import SerialPeer, late_in_a_tenth, registers

from roclog.bus.bus import Answer, Bus
from roclog.bus.serial_port import SerialLink
from roclog.bus.tally import Tally
from roclog.bus.timing import Framing, Timing
from roclog.clock import SystemClock
from roclog.errors import LinkDown, NoAnswer
from roclog.modbus.request import ReadRegisters, words

MS = 1_000_000
CHARACTER = 1_041_667
SILENCE = 5 * CHARACTER
READ = ReadRegisters(3, 300, 27)
TIMING = Timing(framing=Framing.RTU, timeout=500 * MS, late_answer=600 * MS, silence=MS)
WIRE = replace(TIMING, silence=SILENCE, character=CHARACTER)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "port"


def make(path: Path, timing: Timing = TIMING) -> Bus:
    return Bus(SerialLink(str(path), 9600, 8, "N", 1), timing, SystemClock(), frozenset())


def silent(_: bytes) -> list[tuple[float, bytes]]:
    return []


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def ignore(_: object) -> None:
    pass


@pytest.mark.parametrize(
    ("bytesize", "parity", "stopbits", "bits"), [(8, "N", 1, 10), (8, "E", 1, 11), (8, "O", 2, 12)]
)
def test_bits_of_a_character(bytesize: int, parity: str, stopbits: int, bits: int) -> None:
    assert SerialLink("/dev/null", 9600, bytesize, parity, stopbits).character_bits == bits


def test_silence_as_the_peer_sees_it(path: Path) -> None:
    async def main() -> None:
        bus = make(path, WIRE)
        for _ in range(40):
            await bus.transact(1, READ, Tally())
        bus.close()

    with SerialPeer(path) as peer:
        asyncio.run(main())
    assert len(peer.asked) == 40
    for answered, asked in zip(peer.answered, peer.asked[1:], strict=False):
        assert asked - answered >= SILENCE


def test_silence_after_a_request_that_nobody_answers(path: Path) -> None:
    timing = replace(WIRE, timeout=10 * MS, late_answer=20 * MS)

    async def main() -> None:
        bus = make(path, timing)
        begun.append(time.monotonic_ns())
        for _ in range(10):
            with pytest.raises(NoAnswer):
                await bus.transact(1, READ, Tally())
        bus.close()

    begun: list[int] = []
    with SerialPeer(path, silent) as peer:
        asyncio.run(main())
    request = 8 * CHARACTER
    assert peer.asked[-1] - begun[0] >= 9 * max(20 * MS, request + 10 * MS, request + SILENCE)


@pytest.mark.parametrize("deaf", [False, True])
def test_no_late_answer_is_taken_for_another(path: Path, *, deaf: bool) -> None:
    # 0 wrong of 250 is exact in test_bus.py; here the same over a real descriptor in real time.
    async def main() -> None:
        bus = make(path, replace(TIMING, timeout=12 * MS))
        for index in range(250):
            request = ReadRegisters(3, 64 * index, 27)
            with suppress(NoAnswer):
                answer = await bus.transact(1, request, tally)
                if words(answer.pdu) != tuple(range(64 * index, 64 * index + 27)):
                    wrong.append(index)
        bus.close()

    tally = Tally()
    wrong: list[int] = []
    with SerialPeer(path, late_in_a_tenth(7, 0.02, 0.06), deaf):
        asyncio.run(main())
    assert wrong == []
    assert tally.requests == 250
    assert tally.late_answers > 15


def test_octets_one_by_one_with_noise_around(path: Path) -> None:
    def answerer(adu: bytes) -> list[tuple[float, bytes]]:
        [(_, octets)] = registers(adu)
        return [(0.0005, bytes([octet])) for octet in b"\x00\xff" + octets + b"\x00"]

    async def main() -> None:
        bus = make(path)
        assert words((await bus.transact(1, READ, Tally())).pdu) == tuple(range(300, 327))
        bus.close()

    with SerialPeer(path, answerer):
        asyncio.run(main())


def test_a_port_that_goes_away_fails_the_pending_request_at_once(path: Path) -> None:
    async def main() -> None:
        pending = asyncio.create_task(make(path).transact(1, READ, tally))
        await asyncio.sleep(0.05)
        peer.hang_up()
        begun = time.monotonic()
        with pytest.raises(LinkDown):
            await pending
        assert time.monotonic() - begun < 0.25  # it takes no time; a busy machine does

    tally = Tally()
    with SerialPeer(path, silent) as peer:
        asyncio.run(main())
    assert (tally.requests, tally.timeouts, tally.link_losses) == (1, 0, 1)


def test_a_port_that_comes_back_as_another_one_under_its_name(path: Path) -> None:
    async def ask() -> None:
        assert words((await bus.transact(1, READ, tally)).pdu)[0] == 300

    async def refuse(match: str | None) -> None:
        with pytest.raises(LinkDown, match=match):
            await bus.transact(1, READ, tally)

    async def closed() -> None:
        bus.close()

    tally = Tally()
    with asyncio.Runner() as runner:
        bus = make(path)
        with SerialPeer(path):
            runner.run(ask())
            first = path.readlink()
            keeps_its_number = os.open(first, os.O_RDWR | os.O_NOCTTY)
        runner.run(refuse(None))
        path.unlink()
        runner.run(asyncio.sleep(0.5))
        runner.run(refuse("cannot be opened: No such file or directory"))
        runner.run(asyncio.sleep(0.5))
        with SerialPeer(path):
            os.close(keeps_its_number)
            assert path.readlink() != first
            runner.run(ask())
            runner.run(ask())
            runner.run(closed())
    assert tally.answers == 3


def test_a_port_belongs_to_one(path: Path) -> None:
    async def main() -> None:
        first, second = (SerialLink(str(path), 9600, 8, "N", 1) for _ in range(2))
        await first.open(ignore, ignore)
        with pytest.raises(OSError, match="another program has it open"):
            await second.open(ignore, ignore)
        first.close()
        await second.open(ignore, ignore)
        second.close()

    with SerialPeer(path):
        asyncio.run(main())


def test_ports_that_cannot_be_opened(tmp_path: Path) -> None:
    plain = tmp_path / "file"
    plain.touch()

    async def opened(port: Path, baudrate: int = 9600) -> None:
        link = SerialLink(str(port), baudrate, 8, "N", 1)
        try:
            await link.open(ignore, ignore)
        finally:
            link.close()

    before = descriptors()
    with pytest.raises(OSError, match="No such file or directory") as caught:
        asyncio.run(opened(tmp_path / "missing"))
    assert caught.value.errno == errno.ENOENT
    for port in (plain, Path("/dev/null")):
        with pytest.raises(OSError, match="is not a serial port"):
            asyncio.run(opened(port))
    with pytest.raises(OSError, match="Is a directory"):
        asyncio.run(opened(tmp_path))
    with SerialPeer(tmp_path / "port") as peer, pytest.raises(OSError, match="baud"):
        asyncio.run(opened(peer.link, -1))
    assert descriptors() == before


@pytest.mark.parametrize(
    "error",
    [
        termios.error(5, "Input/output error"),
        serial.SerialException("device disconnected"),
        serial.SerialException(errno.EIO, "could not open port"),
    ],
)
def test_whatever_a_vanishing_port_raises_is_a_lost_link(
    path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def vanish(*_: object, **__: object) -> NoReturn:
        raise error

    async def main() -> None:
        with pytest.raises(LinkDown, match=r"Input/output error|disconnected"):
            await make(path).transact(1, READ, Tally())

    monkeypatch.setattr(serial, "Serial", vanish)
    with SerialPeer(path):
        asyncio.run(main())


def refusal(link: SerialLink) -> str:
    with pytest.raises(OSError, match=r"the port took [0-9]+ of 1000000 octets") as caught:
        link.send(bytes(1_000_000))
    return str(caught.value)


def test_a_port_that_takes_only_a_part(path: Path) -> None:
    async def main() -> None:
        link = SerialLink(str(path), 9600, 8, "N", 1)
        with pytest.raises(OSError, match="closed"):
            link.send(b"1")
        await link.open(ignore, ignore)
        with pytest.raises(OSError, match="of 1000000 octets"):
            link.send(bytes(1_000_000))
        refused = [refusal(link) for _ in range(100)]
        assert refused[-1] == "the port took 0 of 1000000 octets"
        link.close()
        link.close()

    with SerialPeer(path) as peer:
        peer.stop_listening()
        asyncio.run(main())


def test_no_descriptor_is_left_behind(path: Path) -> None:
    async def main() -> None:
        link = SerialLink(str(path), 9600, 8, "N", 1)
        bus = Bus(link, TIMING, SystemClock(), frozenset())
        await bus.transact(1, READ, Tally())
        before = descriptors()
        for _ in range(200):
            bus.close()
            assert isinstance(await bus.transact(1, READ, Tally()), Answer)
        for _ in range(50):
            await link.open(ignore, ignore)  # without closing first
        assert descriptors() == before
        missing = SerialLink(str(path) + "-missing", 9600, 8, "N", 1)
        for _ in range(50):
            with pytest.raises(OSError):
                await missing.open(ignore, ignore)
        assert descriptors() == before
        bus.close()

    with SerialPeer(path):
        asyncio.run(main())

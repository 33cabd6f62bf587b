"""What is asked of a serial driver, octet by octet, and what is made of its answers."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import re
import termios
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import pytest
from fake_driver import (
    NOT_THERE,
    TIOCGICOUNT,
    TIOCGRS485,
    TIOCGSERIAL,
    TIOCSRS485,
    TIOCSSERIAL,
    FakeDriver,
)
from serial_peer import SerialPeer

from roclog.bus import serial_driver
from roclog.bus.bus import Bus
from roclog.bus.link import LineErrors
from roclog.bus.serial_driver import Rs485
from roclog.bus.serial_port import SerialLink
from roclog.bus.tally import Tally
from roclog.bus.timing import Framing, Timing
from roclog.clock import SystemClock
from roclog.errors import LinkDown
from roclog.modbus.request import ReadRegisters

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator
    from pathlib import Path


@pytest.fixture
def peer(tmp_path: Path) -> Iterator[SerialPeer]:
    with SerialPeer(tmp_path / "port") as peer:
        yield peer


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    return FakeDriver(monkeypatch)


@asynccontextmanager
async def opened(link: SerialLink) -> AsyncIterator[SerialLink]:
    await link.open(lambda _: None, lambda _: None)
    try:
        yield link
    finally:
        link.close()


def make(
    peer: SerialPeer,
    parity: str = "N",
    stopbits: int = 1,
    *,
    baudrate: int = 9600,
    low_latency: bool = False,
    rs485: Rs485 | None = None,
    tty_class: Path | None = None,
) -> SerialLink:
    return SerialLink(
        str(peer.link),
        baudrate,
        8,
        parity,
        stopbits,
        low_latency=low_latency,
        rs485=rs485,
        tty_class=tty_class or peer.link.parent,
    )


def facts(link: SerialLink) -> dict[str, str]:
    async def main() -> None:
        async with opened(link):
            pass

    asyncio.run(main())
    return dict(link.describe())


def refusal(link: SerialLink) -> OSError:
    with pytest.raises(OSError) as caught:
        facts(link)
    return caught.value


def test_low_latency_changes_one_bit(peer: SerialPeer, driver: FakeDriver) -> None:
    before = bytes(driver.serial)
    driver.serial[16:20] = bytes.fromhex("40 00 00 90")
    assert facts(make(peer, low_latency=True))["low_latency"] == "set"
    assert driver.serial[16:20] == bytes.fromhex("40 20 00 90")  # ASYNC_LOW_LATENCY 0x2000
    assert driver.serial[:16] + driver.serial[20:] == before[:16] + before[20:]
    assert [r for r in driver.asked if r != TIOCGICOUNT] == [TIOCGSERIAL, TIOCSSERIAL, TIOCGSERIAL]


def test_low_latency_that_is_set_already_is_not_set_again(
    peer: SerialPeer, driver: FakeDriver
) -> None:
    driver.serial[16:20] = bytes.fromhex("00 20 00 00")
    assert facts(make(peer, low_latency=True))["low_latency"] == "set before"
    assert TIOCSSERIAL not in driver.asked


@pytest.mark.parametrize(
    ("refuses", "text"),
    [
        ({TIOCGSERIAL: errno.ENOTTY}, "not known to the driver"),
        ({TIOCGSERIAL: errno.EINVAL}, "not known to the driver"),
        ({TIOCSSERIAL: errno.ENOTTY}, "not known to the driver"),
        ({TIOCSSERIAL: errno.EPERM}, "refused: Operation not permitted"),
    ],
)
def test_a_port_without_low_latency_opens(
    peer: SerialPeer, driver: FakeDriver, refuses: dict[int, int], text: str
) -> None:
    driver.serial[16:20] = bytes(4)
    driver.refuses = refuses
    assert facts(make(peer, low_latency=True))["low_latency"] == text


def test_a_driver_that_ignores_low_latency(peer: SerialPeer, driver: FakeDriver) -> None:
    def forget() -> None:
        driver.serial[16:20] = bytes(4)

    driver.serial[16:20] = bytes(4)
    driver.on_set = forget
    assert facts(make(peer, low_latency=True))["low_latency"] == "ignored by the driver"


def test_what_is_not_asked_for_is_not_touched(peer: SerialPeer, driver: FakeDriver) -> None:
    assert set(facts(make(peer))) == {"device"}
    assert set(driver.asked) == {TIOCGICOUNT}


@pytest.mark.parametrize(
    ("wanted", "octets"),
    [
        (Rs485(), "03 00 00 00  00 00 00 00  00 00 00 00"),
        (
            Rs485(delay_before_send=1, delay_after_send=100),
            "03 00 00 00  01 00 00 00  64 00 00 00",
        ),
        (
            Rs485(rts_on_send=False, rts_after_send=True, delay_after_send=2),
            "05 00 00 00  00 00 00 00  02 00 00 00",
        ),
    ],
)
def test_direction_control(
    peer: SerialPeer, driver: FakeDriver, wanted: Rs485, octets: str
) -> None:
    assert facts(make(peer, rs485=wanted))["rs485"] == "set"
    assert driver.rs485[:12] == bytes.fromhex(octets)
    assert driver.rs485[12:] == bytes(range(50, 70))
    assert driver.asked.count(TIOCSRS485) == 1


def test_direction_control_leaves_other_flags_alone(peer: SerialPeer, driver: FakeDriver) -> None:
    """SER_RS485_RX_DURING_TX 0x10 and SER_RS485_TERMINATE_BUS 0x20 stay, old levels go."""
    driver.rs485[:12] = bytes.fromhex("35 00 00 00  09 00 00 00  08 00 00 00")
    facts(make(peer, rs485=Rs485()))
    assert driver.rs485[:12] == bytes.fromhex("33 00 00 00  00 00 00 00  00 00 00 00")


def test_a_driver_that_makes_something_else_of_it(peer: SerialPeer, driver: FakeDriver) -> None:
    def shorten() -> None:
        driver.rs485[4:8] = bytes.fromhex("0a 00 00 00")

    driver.on_set = shorten
    error = refusal(make(peer, rs485=Rs485(delay_before_send=50)))
    assert str(error).endswith(
        "rs485: the driver made { rts_on_send = true, rts_after_send = false, "
        'delay_before_send = "10ms", delay_after_send = "0ms" } of '
        "{ rts_on_send = true, rts_after_send = false, "
        'delay_before_send = "50ms", delay_after_send = "0ms" }'
    )


def test_a_driver_that_makes_nothing_of_it(peer: SerialPeer, driver: FakeDriver) -> None:
    def forget() -> None:
        driver.rs485[:12] = bytes(12)

    driver.on_set = forget
    error = refusal(make(peer, rs485=Rs485()))
    assert "rs485: the driver made nothing of { rts_on_send = true" in str(error)


@pytest.mark.parametrize(
    ("refuses", "text"),
    [
        ({TIOCGRS485: errno.ENOTTY}, "has no direction control; leave the key out for an adapter"),
        ({TIOCSRS485: errno.EINVAL}, "has no direction control; leave the key out for an adapter"),
        ({TIOCSRS485: errno.EPERM}, "the driver refused it: Operation not permitted"),
    ],
)
def test_no_direction_control(
    peer: SerialPeer, driver: FakeDriver, refuses: dict[int, int], text: str
) -> None:
    driver.refuses = refuses
    error = refusal(make(peer, rs485=Rs485()))
    assert "rs485: " in str(error)
    assert text in str(error)


def test_nothing_is_sent_without_direction_control(peer: SerialPeer) -> None:
    """A pseudo-terminal really has none. The message has port and key; the port is free again."""

    async def main() -> None:
        timing = Timing(framing=Framing.RTU, timeout=10**8, late_answer=10**8, silence=10**6)
        bus = Bus(make(peer, rs485=Rs485()), timing, SystemClock(), frozenset())
        with pytest.raises(LinkDown, match=f"{re.escape(str(peer.link))} cannot .* rs485: "):
            await bus.transact(1, ReadRegisters(3, 0, 1), Tally())
        async with opened(make(peer)):
            pass

    asyncio.run(main())
    assert peer.asked == []


@pytest.mark.parametrize(
    ("wanted", "level"),
    [(Rs485(), False), (Rs485(rts_on_send=False, rts_after_send=True), True), (None, True)],
)
def test_rts_at_opening_leaves_the_line_alone(
    peer: SerialPeer, driver: FakeDriver, wanted: Rs485 | None, *, level: bool
) -> None:
    """RTS has the level of between frames before the driver knows of direction control."""
    facts(make(peer, rs485=wanted))
    assert driver.rts == [level]


def test_errors_are_counted_from_the_opening_on(peer: SerialPeer, driver: FakeDriver) -> None:
    async def main() -> None:
        link = make(peer)
        assert link.line_errors() is None
        driver.count(rx=5, frame=10, overrun=20, parity=30, brk=40, buf_overrun=50)
        async with opened(link):
            assert link.line_errors() == LineErrors()
            driver.count(rx=99, frame=11, overrun=22, parity=33, brk=44, buf_overrun=55)
            assert link.line_errors() == LineErrors(frame=1, overrun=7, parity=3, breaks=4)
            driver.count(frame=12)
        driver.count(frame=1000)
        assert link.line_errors() == LineErrors(frame=2, overrun=7, parity=3, breaks=4)
        async with opened(link):
            driver.count(frame=1001)
            assert link.line_errors() == LineErrors(frame=3, overrun=7, parity=3, breaks=4)

    asyncio.run(main())


def test_counters_that_begin_anew_at_32_bits(peer: SerialPeer, driver: FakeDriver) -> None:
    async def main() -> None:
        driver.count(frame=0xFFFF_FFFE)
        async with opened(make(peer)) as link:
            driver.count(frame=3)
            errors = link.line_errors()
            assert errors is not None
            assert errors.frame == 5

    asyncio.run(main())


def test_counts_of_a_port_that_is_gone(peer: SerialPeer, driver: FakeDriver) -> None:
    async def main() -> None:
        async with opened(make(peer)) as link:
            driver.count(brk=int.from_bytes(driver.counts[36:40], "little") + 2)
            assert link.line_errors() == LineErrors(breaks=2)
            driver.refuses = {TIOCGICOUNT: errno.EIO}
            assert link.line_errors() == LineErrors(breaks=2)
        assert link.line_errors() == LineErrors(breaks=2)
        driver.refuses = NOT_THERE
        async with opened(link):
            assert link.line_errors() is None

    asyncio.run(main())


def test_a_refused_adapter_adds_nothing(peer: SerialPeer, driver: FakeDriver) -> None:
    async def main() -> None:
        link = make(peer, rs485=Rs485())
        async with opened(link):
            pass
        driver.count(frame=0, overrun=0, parity=0, brk=0, buf_overrun=0)  # another adapter
        driver.refuses = {TIOCSRS485: errno.EINVAL}
        with pytest.raises(OSError, match="rs485"):
            await link.open(lambda _: None, lambda _: None)
        assert link.line_errors() == LineErrors()

    asyncio.run(main())


def test_a_pseudo_terminal_counts_nothing(peer: SerialPeer) -> None:
    async def main() -> None:
        async with opened(make(peer)) as link:
            assert link.line_errors() is None

    asyncio.run(main())


@pytest.mark.parametrize(
    ("parity", "stopbits", "control"),
    [("N", 1, 0), ("E", 1, 0o400), ("O", 1, 0o1400), ("N", 2, 0o100), ("E", 2, 0o500)],
)
def test_format_of_characters(
    peer: SerialPeer, monkeypatch: pytest.MonkeyPatch, parity: str, stopbits: int, control: int
) -> None:
    """<asm-generic/termbits.h>: CSTOPB 0100, PARENB 0400, PARODD 01000, CMSPAR 010000000000."""
    told = []
    true = termios.tcsetattr

    def note(fd: int, when: int, attributes: list[int]) -> None:
        told.append(attributes[2] & 0o10000001500)
        true(fd, when, attributes)  # type: ignore[arg-type]

    monkeypatch.setattr(termios, "tcsetattr", note)
    known = facts(make(peer, parity, stopbits))
    assert told[0] == control
    refused = f"the driver did not take parity {parity}, stop bits {stopbits}"
    # Linux' pseudo-terminals clear PARENB whatever they are told.
    assert known.get("warning") == (refused if parity != "N" else None)


@pytest.mark.parametrize(("parity", "input_flags"), [("N", 0), ("E", 0o20), ("O", 0o20)])
def test_damaged_characters_are_not_taken_for_data(
    peer: SerialPeer, parity: str, input_flags: int
) -> None:
    """IGNBRK 01, BRKINT 02, IGNPAR 04, PARMRK 010, INPCK 020: INPCK alone reads them as 0.

    Whatever another program has left behind.
    """
    terminal = os.open(peer.link, os.O_RDWR | os.O_NOCTTY)
    attributes = termios.tcgetattr(terminal)
    attributes[0] |= 0o37
    termios.tcsetattr(terminal, termios.TCSANOW, attributes)
    facts(make(peer, parity))
    assert termios.tcgetattr(terminal)[0] & 0o37 == input_flags
    os.close(terminal)


def test_an_unusual_baud_rate_stays(peer: SerialPeer) -> None:
    """TCGETS2 0x802c542a, struct termios2: c_ispeed at 36, c_ospeed at 40."""

    async def main() -> None:
        terminal = os.open(peer.link, os.O_RDWR | os.O_NOCTTY)
        async with opened(make(peer, "E", baudrate=12_345)):
            found = fcntl.ioctl(terminal, 0x802C542A, bytes(44))
        os.close(terminal)
        assert int.from_bytes(found[40:44], "little") == 12_345

    asyncio.run(main())


def describe_port(peer: SerialPeer, tty_class: Path, timer: str | None) -> Path:
    """As /sys/class/tty has it."""
    name = peer.link.resolve().name
    (tty_class / "drivers/ftdi_sio").mkdir(parents=True)
    (tty_class / name / "device").mkdir(parents=True)
    (tty_class / name / "device/driver").symlink_to("../../drivers/ftdi_sio")
    path = tty_class / name / "device/latency_timer"
    if timer is not None:
        path.write_text(timer)
    return path


def test_an_adapter_with_a_latency_timer(
    peer: SerialPeer, driver: FakeDriver, tmp_path: Path
) -> None:
    """ftdi_sio shows 1 once it has ASYNC_LOW_LATENCY."""

    def show_one() -> None:
        path.write_text("1\n")

    path = describe_port(peer, tmp_path / "tty", "16\n")
    driver.serial[16:20] = bytes(4)
    driver.on_set = show_one
    assert facts(make(peer, low_latency=True, tty_class=tmp_path / "tty")) == {
        "device": str(peer.link.resolve()),
        "driver": "ftdi_sio",
        "low_latency": "set",
        "latency_timer": "1 ms",
    }


def test_a_latency_timer_that_stays_long(peer: SerialPeer, tmp_path: Path) -> None:
    path = describe_port(peer, tmp_path / "tty", "16\n")
    known = facts(make(peer, low_latency=True, tty_class=tmp_path / "tty"))
    assert (known["low_latency"], known["latency_timer"]) == ("not known to the driver", "16 ms")
    assert known["warning"] == (
        "the adapter may keep octets for 16 ms, its latency timer: "
        f"write 1 to {path} or add a udev rule that does"
    )


def test_a_latency_timer_that_the_user_wants(peer: SerialPeer, tmp_path: Path) -> None:
    describe_port(peer, tmp_path / "tty", "16\n")
    known = facts(make(peer, tty_class=tmp_path / "tty"))
    assert known["latency_timer"] == "16 ms"
    assert not known.keys() & {"warning", "low_latency"}


@pytest.mark.parametrize("timer", [None, "", "soon\n", "-1\n", "²\n"])
def test_no_latency_timer(peer: SerialPeer, tmp_path: Path, timer: str | None) -> None:
    describe_port(peer, tmp_path / "tty", timer)
    known = facts(make(peer, low_latency=True, tty_class=tmp_path / "tty"))
    assert set(known) == {"device", "driver", "low_latency"}


def test_facts_are_of_the_last_opening(peer: SerialPeer, tmp_path: Path) -> None:
    link = make(peer)
    assert link.describe() == {}
    assert facts(link) == {"device": str(peer.link.resolve())}
    peer.hang_up()
    refusal(link)
    assert link.describe() == {}


def test_other_systems_go_without(peer: SerialPeer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_driver, "LINUX", False)

    async def main() -> None:
        async with opened(make(peer, low_latency=True)) as link:
            assert link.describe()["low_latency"] == "only on Linux"
            assert link.line_errors() is None
            with pytest.raises(OSError, match="another program has it open"):
                await make(peer).open(lambda _: None, lambda _: None)

    asyncio.run(main())
    assert "rs485: only on Linux" in str(refusal(make(peer, rs485=Rs485())))

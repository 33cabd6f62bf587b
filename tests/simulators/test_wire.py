"""The line as arithmetic, on a clock that the test sets. Times are from paper, not from the code:
at 9600 Bd 8N1 a character is 10 / 9600 s = 1.0417 ms.
"""

from __future__ import annotations

from typing import Any

import pytest

from roclog.simulators.serial_line.statistics import Lateness
from roclog.simulators.serial_line.wire import LineSettings, Side, Wire

MS = 1_000_000
START = 5_000 * MS
CLIENT, SERVER = Side.CLIENT, Side.SERVER
REQUEST = bytes(range(8))
ANSWER = bytes(range(59))


class Line:
    """A wire that begins at 0 ms, with its octets and the times at which they come out."""

    def __init__(self, **settings: Any) -> None:
        self.wire = Wire(LineSettings(**settings), START)
        self.now = 0.0

    def send(self, side: Side, octets: bytes, at: float) -> None:
        self.until(at)
        self.now = at
        self.wire.send(side, octets, START + round(at * MS))

    def until(self, end: float) -> list[tuple[float, Side, bytes]]:
        """Milliseconds, side and octets of everything that arrives up to then."""
        arrived: list[tuple[float, Side, bytes]] = []
        while (due := self.wire.next_due()) is not None and due <= START + end * MS:
            taken = [(side, self.wire.receive(side, due)) for side in Side]
            arrived += [((due - START) / MS, side, octets) for side, octets in taken if octets]
        return arrived

    def statistics(self, at: float = 1000) -> Any:
        return self.wire.statistics(START + round(at * MS))


def octets_of(arrived: list[tuple[float, Side, bytes]], side: Side) -> bytes:
    return b"".join(octets for _, at, octets in arrived if at is side)


@pytest.mark.parametrize(
    ("baud", "bits", "last_ms"),
    [(9600, 10, 8.3333), (9600, 11, 9.1667), (19200, 10, 4.1667), (115200, 10, 0.6944)],
)
def test_every_octet_takes_a_character_time(baud: int, bits: int, last_ms: float) -> None:
    line = Line(baud=baud, character_bits=bits)
    line.send(CLIENT, REQUEST, 100)
    arrived = line.until(1000)
    assert [octets for _, _, octets in arrived] == [bytes((octet,)) for octet in REQUEST]
    assert {side for _, side, _ in arrived} == {SERVER}
    for number, (at, _, _) in enumerate(arrived, start=1):
        assert at - 100 == pytest.approx(number * last_ms / 8, abs=0.001)


def test_read_of_27_registers() -> None:
    line = Line(baud=9600, turnaround_ns=10 * MS)
    line.send(CLIENT, REQUEST, 0)
    line.send(SERVER, ANSWER, 9)
    arrived = line.until(1000)
    assert octets_of(arrived, CLIENT) == ANSWER
    assert arrived[0][0] == pytest.approx(8.333 + 10 + 1.042, abs=0.001)
    assert arrived[-1][0] == pytest.approx(8.333 + 10 + 61.458, abs=0.001)
    seen = line.statistics(at=100)
    assert (seen.requests, seen.answers, seen.short_gaps, seen.collisions) == (1, 1, 0, 0)
    assert (seen.request_octets, seen.answer_octets) == (8, 59)
    assert seen.busy == pytest.approx(0.698, abs=0.001)


def test_device_that_needs_longer_than_the_turnaround() -> None:
    line = Line(baud=9600, turnaround_ns=10 * MS)
    line.send(CLIENT, REQUEST, 0)
    line.send(SERVER, b"x", 30)
    assert line.until(1000)[-1][0] == pytest.approx(31.042, abs=0.001)
    assert line.statistics().late_answers == 1


def test_answer_written_in_parts_is_held_once() -> None:
    line = Line(baud=9600, turnaround_ns=10 * MS)
    line.send(CLIENT, REQUEST, 0)
    for at in (9, 10, 11):
        line.send(SERVER, b"xy", at)
    assert line.until(1000)[-1][0] == pytest.approx(8.333 + 10 + 6 * 1.0417, abs=0.001)
    assert line.statistics().answers == 1


@pytest.mark.parametrize(
    ("settings", "silence_ms"),
    [
        ({"baud": 9600}, 3.646),
        ({"baud": 9600, "character_bits": 11}, 4.010),
        ({"baud": 9600, "silence_characters": 5}, 5.208),
        ({"baud": 9600, "silence_ns": 7 * MS}, 7),
        ({"baud": 38400}, 1.75),
        ({"baud": 115200}, 1.75),
        ({"baud": None, "silence_ns": 7 * MS}, 7),
    ],
)
def test_silence(settings: dict[str, Any], silence_ms: float) -> None:
    for gap, short in ((silence_ms - 0.01, 1), (silence_ms + 0.01, 0)):
        line = Line(**settings)
        line.send(CLIENT, REQUEST, 0)
        line.send(SERVER, ANSWER, 20)
        end = 20 if settings["baud"] is None else line.until(1000)[-1][0]
        line.send(CLIENT, REQUEST, end + gap)
        assert line.statistics().short_gaps == short


def test_silence_counts_from_the_client_itself_too() -> None:
    line = Line(baud=9600)
    line.send(CLIENT, REQUEST, 0)
    line.send(CLIENT, REQUEST, 8.334 + 3)
    line.send(CLIENT, REQUEST, 100)
    seen = line.statistics()
    assert (seen.requests, seen.short_gaps) == (3, 1)


def test_first_request_has_no_gap() -> None:
    line = Line(baud=9600)
    line.send(CLIENT, REQUEST, 0)
    assert line.statistics().short_gaps == 0


@pytest.mark.parametrize(("pause_ms", "frames"), [(0, 1), (1.5, 1), (1.6, 2)])
def test_pause_of_one_and_a_half_characters_ends_a_frame(pause_ms: float, frames: int) -> None:
    line = Line(baud=9600)
    line.send(CLIENT, b"1234", 0)
    line.send(CLIENT, b"5678", 4.166667 + pause_ms)
    seen = line.statistics()
    assert (seen.requests, seen.short_gaps) == (frames, frames - 1)


def test_octets_written_during_a_frame_follow_it() -> None:
    line = Line(baud=9600)
    line.send(CLIENT, b"1234", 0)
    line.send(CLIENT, b"5678", 1)
    assert line.until(1000)[-1][0] == pytest.approx(8.333, abs=0.001)
    assert line.statistics().requests == 1


def test_collision_garbles_what_overlaps_and_nothing_else() -> None:
    line = Line(baud=9600)
    line.send(SERVER, bytes(20), 0)
    arrived = line.until(5.3)
    line.send(CLIENT, bytes(4), 5.3)
    arrived += line.until(1000)
    received = octets_of(arrived, CLIENT)
    assert octets_of(arrived, SERVER) == b"\x55" * 4
    # Octet 5 is on the line from 5.21 ms on, octet 9 from 9.38 ms; the request ends at 9.47 ms.
    assert received == bytes(5) + b"\x55" * 5 + bytes(10)
    seen = line.statistics()
    assert (seen.collisions, seen.garbled_octets, seen.short_gaps) == (1, 9, 0)


def test_client_that_does_not_await_the_answer_collides_with_it() -> None:
    line = Line(baud=9600, turnaround_ns=10 * MS)
    line.send(CLIENT, REQUEST, 0)
    line.send(SERVER, ANSWER, 9)
    line.send(CLIENT, REQUEST, 15)
    arrived = line.until(1000)
    assert octets_of(arrived, CLIENT) != ANSWER
    assert line.statistics().collisions == 1


def test_request_between_request_and_answer_does_not_collide() -> None:
    line = Line(baud=9600, turnaround_ns=100 * MS)
    line.send(CLIENT, REQUEST, 0)
    line.send(SERVER, ANSWER, 9)
    line.send(CLIENT, REQUEST, 15)
    assert octets_of(line.until(1000), CLIENT) == ANSWER
    assert line.statistics().collisions == 0


def test_one_collision_for_each_frame_not_for_each_write() -> None:
    line = Line(baud=9600)
    line.send(SERVER, bytes(100), 0)
    for at in (10, 11, 12):
        line.send(CLIENT, b"12", at)
    line.send(CLIENT, b"12", 60)
    line.until(1000)
    seen = line.statistics()
    assert (seen.collisions, seen.requests) == (2, 2)


def test_octet_hit_twice_is_garbled_once() -> None:
    line = Line(baud=9600)
    line.send(SERVER, bytes(2), 0)
    line.send(CLIENT, b"\0\0", 0.5)
    assert octets_of(line.until(1000), CLIENT) == b"\x55\x55"


def test_usb_adapter_gives_octets_at_ticks() -> None:
    line = Line(baud=9600, usb_latency_ns=16 * MS)
    line.send(CLIENT, REQUEST, 0)
    assert line.until(20)[0][0] == pytest.approx(1.042, abs=0.001)
    line.send(SERVER, ANSWER, 20)
    arrived = line.until(1000)
    assert sorted(at for at, _, _ in arrived) == [32, 48, 64, 80, 96]
    assert octets_of(arrived, CLIENT) == ANSWER


def test_fifo_delivers_in_groups() -> None:
    line = Line(baud=115200, fifo=16)
    line.send(SERVER, ANSWER, 0)
    arrived = line.until(1000)
    assert [len(octets) for _, _, octets in arrived] == [16, 16, 16, 11]
    assert arrived[-1][0] == pytest.approx(59 / 11.52, abs=0.001)
    assert octets_of(arrived, CLIENT) == ANSWER


def test_collision_in_a_fifo_garbles_single_octets() -> None:
    line = Line(baud=9600, fifo=16)
    line.send(SERVER, bytes(16), 0)
    line.send(CLIENT, b"\0", 3.5)
    assert octets_of(line.until(1000), CLIENT) == bytes(3) + b"\x55\x55" + bytes(11)


def test_without_baud_nothing_takes_time() -> None:
    line = Line()
    line.send(CLIENT, REQUEST, 1)
    line.send(SERVER, ANSWER, 1)
    line.send(CLIENT, REQUEST, 1)
    assert {at for at, _, _ in line.until(1000)} <= {1}
    seen = line.statistics()
    assert (seen.short_gaps, seen.collisions, seen.busy) == (0, 0, 0)


def test_sender_waits_when_its_buffer_is_full() -> None:
    wire = Wire(LineSettings(baud=9600), 0)
    assert wire.has_room(CLIENT, 0)
    wire.send(CLIENT, bytes(5000), 0)
    assert not wire.has_room(CLIENT, 0)
    assert wire.has_room(SERVER, 0)
    assert wire.has_room(CLIENT, 1000 * MS)


def test_lateness() -> None:
    wire = Wire(LineSettings(baud=9600), 0)
    for number in range(99):
        wire.send(CLIENT, b"x", number * 10 * MS)
        due = wire.next_due()
        assert due is not None
        wire.receive(SERVER, due + 100_000)
    wire.send(CLIENT, b"x", 1000 * MS)
    wire.receive(SERVER, 1100 * MS)
    seen = wire.statistics(2000 * MS)
    assert seen.lateness_p50_ms == pytest.approx(0.1, abs=0.011)
    assert seen.lateness_p99_ms == pytest.approx(0.1, abs=0.011)
    assert seen.lateness_max_ms == pytest.approx(98.958, abs=0.001)


def test_quantiles() -> None:
    lateness = Lateness()
    assert (lateness.quantile_ms(0.5), lateness.most_ms) == (0, 0)
    lateness.add(5_000 * MS)
    assert lateness.quantile_ms(0.5) == 5_000
    for late_us in range(1, 1000):
        lateness.add(late_us * 1000)
    assert lateness.quantile_ms(0.5) == pytest.approx(0.5, abs=0.011)
    assert lateness.quantile_ms(0.99) == pytest.approx(0.99, abs=0.011)


@pytest.mark.parametrize(
    "settings",
    [
        {"baud": 0},
        {"baud": -9600},
        {"character_bits": 6},
        {"fifo": 0},
        {"turnaround_ns": -1},
        {"usb_latency_ns": -1},
        {"silence_ns": -1},
        {"silence_characters": -1},
    ],
)
def test_settings_that_no_line_has(settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        LineSettings(**settings)

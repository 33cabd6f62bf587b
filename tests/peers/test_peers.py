"""The test device against raw octets: document frames, hand-made MBAP, and every fault."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from roc import RocDevice
from roc_disk import Disk
from roc_map import configuration
from roc_options import WORD_ORDERS, Options, parse_options
from roc_samples import MOST, Sample, SampleSource, iso_tenths, words
from wire import MbapFramer, Read, Request, RtuFramer, StreamError, crc16, octets_of, parse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

Line = dict[str, Any]

PATIENCE = 5.0
RTU_READ = bytes.fromhex("8A 03 01 2C 00 1B DB 4F")
RTU_CLEAR = bytes.fromhex("8A 06 01 2C 00 00 57 44")
RTU_IDENTITY = bytes.fromhex("8A 03 00 00 00 30 5B 65")
TCP_READ = bytes.fromhex("00 01 00 00 00 06 8A 03 01 2C 00 1B")
TCP_READ_2 = bytes.fromhex("00 02 00 00 00 06 8A 03 01 2C 00 1B")
TCP_CLEAR = bytes.fromhex("00 07 00 00 00 06 8A 06 01 2C 00 00")
RTU_ANSWER = 59
TCP_ANSWER = 63


class Client:
    """Octets out, octets in, for a socket as for a serial line."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def send(self, octets: bytes) -> None:
        os.write(self._handle, octets)

    def receive(self, most: int, patience: float = PATIENCE) -> bytes:
        got = b""
        while len(got) < most and select.select([self._handle], [], [], patience)[0]:
            part = os.read(self._handle, most - len(got))
            if not part:
                break
            got += part
        return got

    def ask(self, octets: bytes, most: int) -> bytes:
        self.send(octets)
        return self.receive(most)

    def block(self) -> list[int]:
        answer = self.ask(TCP_READ, TCP_ANSWER)
        assert answer[:9].hex() == "0001000000398a0336"
        return registers_of(answer[9:])

    def clear(self) -> None:
        assert self.ask(TCP_CLEAR, 12) == TCP_CLEAR


def registers_of(data: bytes) -> list[int]:
    return [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]


@contextmanager
def tcp(device: RocDevice) -> Iterator[Client]:
    with socket.create_connection(("127.0.0.1", int(device.address)), PATIENCE) as sock:
        sock.setblocking(True)
        yield Client(sock.fileno())


@contextmanager
def serial(link: str) -> Iterator[Client]:
    handle = os.open(link, os.O_RDWR | os.O_NOCTTY)
    try:
        yield Client(handle)
    finally:
        os.close(handle)


def roc(**settings: Any) -> RocDevice:
    if "pty" not in settings:
        settings["tcp"] = "127.0.0.1:0"
    return RocDevice(Options(**settings))


def lines(device: RocDevice, event: str) -> list[Line]:
    return [line for line in list(device.truth.lines) if line["event"] == event]


def until(true: Callable[[], object], what: str = "") -> None:
    limit = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < limit, f"waited in vain: {what}"
        time.sleep(0.002)


def wait_for(device: RocDevice, event: str, number: int = 1) -> Line:
    until(lambda: len(lines(device, event)) >= number, event)
    return lines(device, event)[number - 1]


# -- octets ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "frame",
    [
        "CC 04 00 00 00 7D 20 36",
        "01 01 05 10 00 01 FC C3",
        "0A 81 02 B0 53",
        "01 10 30 03 00 01 02 00 01 57 A0",
        "01 2B 84 00 08 00 02 FD C6",
        "01 AB 84 02 92 F9",
        "8A 03 01 2C 00 1B DB 4F",
        "8A 06 01 2C 00 00 57 44",
        "8A 03 00 00 00 30 5B 65",
    ],
)
def test_crc_of_published_frames(frame: str) -> None:
    octets = bytes.fromhex(frame)
    assert crc16(octets[:-2]) == int.from_bytes(octets[-2:], "little")


def test_crc_of_misprinted_frame() -> None:
    assert crc16(bytes.fromhex("0A 04 04 00 00 08 4D")) == 0xB186


def test_rtu_framer_by_length() -> None:
    framer = RtuFramer()
    many = bytes.fromhex("01 10 30 03 00 01 02 00 01 57 A0")
    stream = RTU_READ + many + RTU_CLEAR
    got = [request for at in range(len(stream)) for request in framer.feed(stream[at : at + 1])]
    assert got == [
        Request(0x8A, RTU_READ[1:-2]),
        Request(1, many[1:-2]),
        Request(0x8A, RTU_CLEAR[1:-2]),
    ]
    assert not framer
    assert len(RtuFramer().feed(stream)) == len(got)


def test_rtu_framer_by_gap() -> None:
    framer = RtuFramer()
    unknown = bytes.fromhex("01 2B 84 00 08 00 02 FD C6")
    assert framer.feed(unknown) == []
    assert framer.idle() == ([Request(1, unknown[1:-2])], b"")
    bad = RTU_READ[:-1] + b"\0"
    assert framer.feed(bad + RTU_READ) == []
    assert framer.idle() == ([], bad + RTU_READ)
    assert framer.feed(RTU_READ) == [Request(0x8A, RTU_READ[1:-2])]


def test_mbap_framer() -> None:
    framer = MbapFramer()
    assert framer.feed(TCP_READ[:5]) == []
    assert framer.feed(TCP_READ[5:] + TCP_READ_2) == [
        Request(0x8A, TCP_READ[7:], 1),
        Request(0x8A, TCP_READ_2[7:], 2),
    ]
    with pytest.raises(StreamError):
        framer.feed(bytes.fromhex("00 01 00 01 00 06 8A"))


def test_parse() -> None:
    assert parse(bytes.fromhex("03 01 2C 00 1B")) == Read(300, 27)


# -- samples --------------------------------------------------------------------------------


def some_samples(number: int) -> list[Sample]:
    source = SampleSource(1, "ABCD", 0x000A, 0)
    return [source.make() for _ in range(number)]


def values_32(sample: Sample) -> list[int]:
    high, low = sample.registers[8:16:2], sample.registers[9:16:2]
    return [h << 16 | w for h, w in zip(high, low, strict=True)]


def test_samples_are_plausible() -> None:
    samples = some_samples(400)
    for sample in samples:
        counts = values_32(sample)
        assert counts == sorted(counts, reverse=True)
        assert list(sample.registers[16:20]) == [iso_tenths(count) for count in counts]
        assert sample.registers[1:7] == (0, 0, 0, 0, 10, 0)
        assert sample.registers[7] < 1 << 12
    assert any(values_32(sample)[0] == MOST for sample in samples)
    assert {sample.registers[20] for sample in samples} == {0xFFFF, *range(14)}
    assert {sample.registers[22] for sample in samples} == {0xFFFE, 0xFFFF, *range(14)}
    assert any(sample.registers[26] >= 0x8000 for sample in samples)


def test_samples_differ_nearly_everywhere() -> None:
    samples = some_samples(400)
    for last, sample in pairwise(samples):
        pairs = list(zip(last.registers[8:26], sample.registers[8:26], strict=True))
        assert sum(old != new for old, new in pairs) >= 14
        assert last.registers[26] != sample.registers[26]


@pytest.mark.parametrize(
    ("raw", "tenths"), [(0, 0), (1, 10), (2, 20), (3, 25), (1000, 109), (MOST, 288)]
)
def test_iso_code(raw: int, tenths: int) -> None:
    assert iso_tenths(raw) == tenths


def test_word_orders() -> None:
    got = {order: octets_of(words(0x0A0B0C0D, order)).hex() for order in WORD_ORDERS}
    assert got == {"ABCD": "0a0b0c0d", "CDAB": "0c0d0a0b", "BADC": "0b0a0d0c", "DCBA": "0d0c0b0a"}


@pytest.mark.parametrize(
    ("cycle", "periods"), [(0.2, (0x000A, 0x0005)), (7, (5, 2)), (15, (10, 5)), (90, (0x0100, 30))]
)
def test_periods(cycle: float, periods: tuple[int, int]) -> None:
    registers = configuration(138, cycle)
    assert (registers[105], registers[106]) == periods


# -- the device without faults ----------------------------------------------------------------


def test_serial_line(tmp_path: Path) -> None:
    link = str(tmp_path / "roc")
    with roc(pty=link, cycle=0.05) as device:
        wait_for(device, "made")
        with serial(link) as client:
            answer = client.ask(RTU_READ, RTU_ANSWER)
        assert answer[:3].hex() == "8a0336"
        assert crc16(answer[:-2]) == int.from_bytes(answer[-2:], "little")
        read = wait_for(device, "read")
        assert (read["fate"], read["address"], read["count"]) == ("ok", 300, 27)
        made = lines(device, "made")[read["k"] - 1]
        assert registers_of(answer[3:-2]) == made["registers"]
        with serial(link) as client:  # the line survived the client's leaving
            assert client.ask(RTU_CLEAR, 8) == RTU_CLEAR
            identity = client.ask(RTU_IDENTITY, 101)[3:-2]
        assert identity[:30] == b"HIAC".ljust(30, b"\0")
        assert identity[82:] == b"2089263-1 RevC"
        assert wait_for(device, "clear")["k"] is not None


def test_serial_silence_and_noise(tmp_path: Path) -> None:
    link = str(tmp_path / "roc")
    with roc(pty=link, samples=0) as device, serial(link) as client:
        client.send(bytes.fromhex("CC 04 00 00 00 7D 20 36"))
        assert wait_for(device, "ignored")["unit"] == 0xCC
        client.send(RTU_READ[:-1])
        assert wait_for(device, "noise")["octets"] == RTU_READ[:-1].hex(" ")
        assert client.ask(RTU_CLEAR, 8) == RTU_CLEAR
        assert not client.receive(1, 0.0)
        assert lines(device, "clear")[0]["idle_ms"] > 0


@pytest.mark.parametrize(
    ("request_pdu", "answer_pdu"),
    [
        ("04 01 2C 00 1B", "84 01"),
        ("2B 0E 01 00", "AB 01"),
        ("03 01 2C 00 1C", "83 02"),
        ("03 00 30 00 01", "83 02"),
        ("03 00 C8 00 01", "83 02"),
        ("03 04 4D 00 01", "83 02"),
        ("03 01 2C 00 00", "83 03"),
        ("06 01 2C 00 01", "86 03"),
        ("06 01 2D 00 00", "86 02"),
        ("06 00 00 00 00", "86 02"),
        ("10 01 2C 00 02 04 00 00 00 00", "90 02"),
        ("10 01 2C 00 01 04 00 00", "90 03"),
        ("10 01 2C 00 01 02 00 00", "10 01 2C 00 01"),
        ("06 00 69 00 04", "86 03"),
        ("06 00 69 00 3C", "86 03"),
        ("06 00 69 00 3B", "06 00 69 00 3B"),
        ("06 00 66 0C 1F", "06 00 66 0C 1F"),
        ("06 00 6E FF FC", "86 03"),
        ("06 00 6E FF FD", "06 00 6E FF FD"),
        ("06 04 4D 00 01", "86 03"),
        ("06 04 4E 00 5A", "06 04 4E 00 5A"),
        ("03 00 64 00 0E", "03 1C 008A 0000 0000 0000 0000 000A 0005 0000 0001 0000" + "FFFD" * 4),
    ],
)
def test_answers(request_pdu: str, answer_pdu: str) -> None:
    pdu, expected = bytes.fromhex(request_pdu), bytes.fromhex(answer_pdu)
    with roc(samples=0) as device, tcp(device) as client:
        header = b"\x12\x34\0\0" + (len(pdu) + 1).to_bytes(2, "big") + b"\x8a"
        answer = client.ask(header + pdu, 7 + len(expected))
    assert answer[:4] == b"\x12\x34\0\0"
    assert answer[6:].hex(" ") == (b"\x8a" + expected).hex(" ")
    exceptions = lines(device, "exception")
    assert [line["code"] for line in exceptions] == [expected[1]] * (expected[0] >> 7)
    is_clear = pdu[:5] == bytes.fromhex("10 01 2C 00 01") and not exceptions
    assert len(lines(device, "clear")) == is_clear


def test_any_other_write_is_in_the_truth() -> None:
    with roc(samples=0) as device, tcp(device) as client:
        client.ask(bytes.fromhex("00 01 00 00 00 06 8A 06 00 6B 00 02"), 12)
        client.ask(bytes.fromhex("00 01 00 00 00 06 8A 06 01 2C 00 01"), 9)
    accepted, refused = lines(device, "write")
    assert (accepted["address"], accepted["values"], accepted["accepted"]) == (107, [2], True)
    assert (refused["address"], refused["accepted"], refused["code"]) == (300, False, 3)


def test_reset_has_no_answer() -> None:
    with roc(cycle=0.1) as device, tcp(device) as client:
        wait_for(device, "made")
        client.send(bytes.fromhex("00 01 00 00 00 06 8A 06 00 6B 00 02"))
        client.send(bytes.fromhex("00 01 00 00 00 06 8A 06 04 4D 00 55"))
        assert client.receive(12)[7:] == bytes.fromhex("06 00 6B 00 02")
        assert client.block() == [0] * 27
        trigger = client.ask(bytes.fromhex("00 01 00 00 00 06 8A 03 00 6B 00 01"), 11)
        assert trigger[9:] == b"\0\0"
        assert wait_for(device, "reset")["address"] == 1101
        assert wait_for(device, "made", len(lines(device, "made")) + 1)["k"] >= 2


PERIOD_20 = bytes.fromhex("00 01 00 00 00 06 8A 06 00 69 00 14")
PERIOD = bytes.fromhex("00 01 00 00 00 06 8A 03 00 69 00 01")
SAVE = bytes.fromhex("00 01 00 00 00 06 8A 06 04 4E 00 5A")
RESET = bytes.fromhex("00 01 00 00 00 06 8A 06 04 4D 00 55")


@pytest.mark.parametrize(
    ("fault", "answer", "period"),
    [
        (None, "06 00 69 00 14", 20),
        ("refuse", "86 03", 10),
        ("ignore", "06 00 69 00 14", 10),
        ("lose", "", 20),
        ("deaf", "", 10),
    ],
)
def test_what_becomes_of_a_setting(fault: str | None, answer: str, period: int) -> None:
    with roc(cycle=0.2, settings=fault) as device, tcp(device) as client:
        client.send(PERIOD_20)
        size = 7 + len(bytes.fromhex(answer))
        if answer:
            assert client.receive(size)[7:] == bytes.fromhex(answer)
        assert client.ask(PERIOD, 11)[9:] == bytes([0, period])


def test_only_what_was_saved_survives_a_reset() -> None:
    with roc(cycle=0.2, reset_takes=0.1) as device, tcp(device) as client:

        def answer() -> bytes:
            client.send(PERIOD)
            return client.receive(11, 0.05)[9:]

        assert client.ask(PERIOD_20, 12) == PERIOD_20
        client.send(RESET)
        wait_for(device, "reset")
        assert answer() == b""
        until(lambda: answer() == bytes([0, 10]), "the old period")
        assert client.ask(PERIOD_20, 12) == PERIOD_20
        assert client.ask(SAVE, 12) == SAVE
        client.send(RESET)
        wait_for(device, "reset", 2)
        until(lambda: answer() == bytes([0, 20]), "the new period")


def test_power_fails_after_a_setting() -> None:
    with roc(cycle=0.05, power_fails_after=1) as device:
        with tcp(device) as client:
            client.send(PERIOD_20)
            wait_for(device, "power", 2)
        with tcp(device) as client:
            assert client.ask(PERIOD, 11)[9:] == bytes([0, 10])


@pytest.mark.parametrize(("register", "request_"), [(1101, RESET), (1102, SAVE)])
def test_a_command_that_is_refused(register: int, request_: bytes) -> None:
    with roc(refuse_command=register) as device, tcp(device) as client:
        assert client.ask(request_, 9)[7:] == bytes.fromhex("86 03")


@pytest.mark.parametrize("now", [True, False])
def test_when_a_node_id_counts(now: bool) -> None:
    with roc(node_id_now=now) as device, tcp(device) as client:
        node_17 = bytes.fromhex("00 01 00 00 00 06 8A 06 00 64 00 11")
        assert client.ask(node_17, 12) == node_17
        assert device.model.unit == (17 if now else 138)
        if not now:
            assert client.ask(SAVE, 12) == SAVE
            assert device.model.unit == 138
            client.send(RESET)
            wait_for(device, "reset")
        assert device.model.unit == 17


def test_schedule_does_not_drift() -> None:
    with roc(cycle=0.03, samples=20, linger=0.0) as device:
        device.wait()
    start = lines(device, "start")[0]["mono_ns"]
    off = [line["mono_ns"] - start - line["k"] * 30e6 for line in lines(device, "made")]
    assert len(off) == 20
    assert min(off) > -2e6
    assert min(off[10:]) < 10e6  # the least loaded of the later ones is on time
    summary = lines(device, "summary")[0]
    assert (summary["made"], summary["delivered_ok"]) == (20, 0)
    assert summary["never_delivered"] == list(range(1, 21))
    assert summary["events"]["overwritten"] == 19


def test_state_is_shared_by_connections() -> None:
    with roc(cycle=0.5) as device, tcp(device) as one, tcp(device) as two:
        assert one.block()[0] == 0
        assert wait_for(device, "read")["k"] == 0
        wait_for(device, "made")
        assert one.block() == two.block() == lines(device, "made")[0]["registers"]
        one.clear()
        assert two.block()[0] == 0
        assert lines(device, "clear")[0]["k"] == 1
        assert {line["link"] for line in lines(device, "read")} == {1, 2}


def test_overwritten() -> None:
    with roc(cycle=0.1, samples=3) as device, tcp(device) as client:
        wait_for(device, "made", 2)
        client.block()
        wait_for(device, "made", 3)
    [line] = lines(device, "overwritten")
    assert (line["k"], line["by"]) == (1, 2)
    assert (line["delivered_ok"], line["delivered_late"], line["cleared"]) == (False, False, False)


# -- faults -----------------------------------------------------------------------------------


def test_late_queue() -> None:
    with roc(cycle=0.15, late=1.0, late_by=0.2) as device, tcp(device) as client:
        wait_for(device, "made")
        began = time.monotonic()
        client.send(TCP_READ + TCP_READ_2)
        first = client.receive(TCP_ANSWER)
        assert time.monotonic() - began >= 0.199
        assert first[:2] == b"\0\1"
        assert client.receive(TCP_ANSWER)[:2] == b"\0\2"
        read = wait_for(device, "read", 2)
        assert (lines(device, "read")[0]["k"], lines(device, "read")[0]["stale"]) == (1, True)
        assert read["fate"] == "late"
        assert lines(device, "overwritten")[0]["delivered_late"] is False


def test_late_write_has_its_effect_at_once() -> None:
    with roc(cycle=5, samples=0, late=1.0, late_by=0.2) as device, tcp(device) as client:
        client.send(TCP_CLEAR)
        clear = wait_for(device, "clear")
        assert clear["mono_ns"] - clear["request_mono_ns"] < 0.15e9
        assert client.receive(12) == TCP_CLEAR
        assert clear["fate"] == "late"


def test_late_deaf() -> None:
    options = {"samples": 0, "late": 1.0, "late_by": 0.15, "busy": "deaf"}
    with roc(**options) as device, tcp(device) as client:
        client.send(TCP_READ + TCP_CLEAR)
        assert client.receive(TCP_ANSWER)[:2] == b"\0\1"
        assert wait_for(device, "ignored")["why"] == "deaf"
        assert client.ask(TCP_READ_2, TCP_ANSWER)[:2] == b"\0\2"
        assert not lines(device, "clear")


def test_late_answer_of_a_closed_connection() -> None:
    with roc(samples=0, late=1.0, late_by=0.5) as device:
        with tcp(device) as client:
            client.send(TCP_READ)
            until(lambda: not lines(device, "read"))
        read = wait_for(device, "read")
        assert (read["fate"], read["why"]) == ("dropped", "link lost")


def test_corrupt_on_a_line(tmp_path: Path) -> None:
    link = str(tmp_path / "roc")
    with roc(pty=link, cycle=0.2, corrupt=1.0) as device, serial(link) as client:
        made = wait_for(device, "made")
        answer = client.ask(RTU_READ, RTU_ANSWER)
        assert crc16(answer[:-2]) != int.from_bytes(answer[-2:], "little")
        good = bytes.fromhex("8A0336") + octets_of(made["registers"])
        good += crc16(good).to_bytes(2, "little")
        flipped = int.from_bytes(answer, "big") ^ int.from_bytes(good, "big")
        assert flipped.bit_count() == 1
        assert client.ask(RTU_CLEAR, 8) != RTU_CLEAR
        assert wait_for(device, "clear")["k"] == 1
        assert lines(device, "read")[0]["fate"] == "corrupt"


def test_corrupt_tcp_spares_what_nothing_guards() -> None:
    with roc(cycle=5, corrupt=1.0) as device, tcp(device) as client:
        good = octets_of([int(x) for x in device.model.block])
        for _ in range(20):
            answer = client.ask(TCP_READ, TCP_ANSWER)
            assert answer[9:] == good
            head = int.from_bytes(answer[:9], "big") ^ 0x0001000000398A0336
            assert head.bit_count() == 1


def test_drop() -> None:
    with roc(cycle=0.2, drop=1.0) as device, tcp(device) as client:
        wait_for(device, "made")
        client.send(TCP_READ + TCP_CLEAR)
        assert wait_for(device, "clear")["k"] == 1
        assert wait_for(device, "read")["fate"] == "dropped"
        assert not client.receive(1, 0.02)
        assert wait_for(device, "overwritten")["cleared"] is True


def test_garbage(tmp_path: Path) -> None:
    link = str(tmp_path / "roc")
    with roc(pty=link, samples=0, garbage=1.0) as device, serial(link) as client:
        client.send(RTU_CLEAR)
        wait_for(device, "clear")
        answer = client.receive(8 + 9, 0.05)
        assert answer.endswith(RTU_CLEAR)
        assert 1 <= len(answer) - 8 <= 8


def test_shares_are_kept_and_repeatable() -> None:
    def fates(seed: int) -> list[str]:
        with roc(samples=0, drop=0.3, seed=seed) as device, tcp(device) as client:
            client.send(TCP_READ * 200)
            wait_for(device, "read", 200)
        return [line["fate"] for line in lines(device, "read")]

    first = fates(5)
    assert 40 <= first.count("dropped") <= 80
    assert first == fates(5)
    assert first != fates(6)


def test_race() -> None:
    with roc(cycle=0.3, race_every=2, samples=3) as device, tcp(device) as client:
        wait_for(device, "made")
        first = client.block()
        client.clear()
        second = client.block()
        assert (first[0], second[0]) == (1, 0)
        assert first[8:] != second[8:]
        clear = lines(device, "clear")[0]
        assert (clear["k"], clear["arrived_k"], clear["raced"]) == (2, 1, True)
        client.clear()
        third = wait_for(device, "made", 3)
        made = lines(device, "made")[1]
        assert made["raced"] is True
        assert third["mono_ns"] - made["mono_ns"] == pytest.approx(0.3e9, abs=0.1e9)
        assert (lines(device, "clear")[1]["k"], third["k"]) == (None, 3)


def test_zeros_at_start() -> None:
    with roc(cycle=0.2, zeros_at_start=True) as device, tcp(device) as client:
        assert client.block() == [0] * 27
        assert lines(device, "read")[0]["k"] is None
        assert wait_for(device, "made")["mono_ns"] - lines(device, "start")[0]["mono_ns"] > 0.19e9


def test_reboot() -> None:
    with roc(cycle=0.1, reboot_at=2) as device:
        with tcp(device) as client:
            wait_for(device, "power")
            with pytest.raises(ConnectionResetError):
                client.receive(1)
        with pytest.raises(ConnectionError), tcp(device) as client:
            client.ask(TCP_READ, 1)
        wait_for(device, "power", 2)
        with tcp(device) as client:
            assert client.block() == [0] * 27
        third = wait_for(device, "made", 3)
    off, on = lines(device, "power")
    assert third["k"] == 3
    assert on["mono_ns"] - off["mono_ns"] >= 0.199e9
    assert third["mono_ns"] - on["mono_ns"] >= 0.099e9
    lost = lines(device, "overwritten")[1]
    assert (lost["k"], lost["by"]) == (2, None)


def test_live() -> None:
    with roc(cycle=0.2, live=True, samples=1) as device, tcp(device) as client:
        made = wait_for(device, "made")
        until(lambda: [line["k"] for line in lines(device, "live")].count(1) > 3)
        now = client.block()
    at = [address for address in range(27) if made["registers"][address] != now[address]]
    assert at in ([7, 26], [26])
    assert lines(device, "read")[0]["k"] == 1


def torn_block(device: RocDevice, client: Client) -> tuple[list[int], Line]:
    wait_for(device, "made")
    while True:
        block = client.block()
        read = lines(device, "read")[-1]
        if read["torn"]:
            return block, read


def test_tear() -> None:
    with roc(cycle=0.2, tear=True, tear_for=0.1) as device, tcp(device) as client:
        wait_for(device, "made")
        client.clear()
        block, read = torn_block(device, client)
        assert (read["k"], read["flag"], block[0]) == (None, 0, 0)
        new = wait_for(device, "made", 2)
    old = lines(device, "made")[0]
    split = new["split"] - 300
    assert block[5:split] == new["registers"][5:split]
    assert block[split:] == old["registers"][split:]
    assert new["mono_ns"] - old["mono_ns"] == pytest.approx(0.2e9, abs=0.09e9)


def test_tear_flag_first() -> None:
    options = {"cycle": 0.2, "tear_flag_first": True, "tear_for": 0.1}
    with roc(**options) as device, tcp(device) as client:
        wait_for(device, "made")
        client.clear()
        block, read = torn_block(device, client)
        assert (read["k"], read["flag"], block[0]) == (None, 1, 1)
        client.clear()
        clear = lines(device, "clear")[1]
        assert (clear["k"], clear["torn"]) == (2, True)
        assert wait_for(device, "made", 2)["registers"][0] == 0


def test_refuse_by_exception() -> None:
    options = {"cycle": 5, "refuse_clear": "exception", "refuse_count": 1}
    with roc(samples=0, **options) as device, tcp(device) as client:
        assert client.ask(TCP_CLEAR, 9).hex(" ") == "00 07 00 00 00 03 8a 86 03"
        client.clear()
    assert len(lines(device, "refused")) == len(lines(device, "clear")) == 1


@pytest.mark.parametrize("effect", ["no", "yes"])
def test_refuse_in_silence(effect: str) -> None:
    options = {"cycle": 0.3, "refuse_clear": "silent", "silent_effect": effect}
    with roc(**options) as device, tcp(device) as client:
        wait_for(device, "made")
        client.send(TCP_CLEAR)
        assert client.block()[0] == (effect == "no")
    assert lines(device, "refused")[0]["effect"] is (effect == "yes")
    assert len(lines(device, "clear")) == (effect == "yes")


def test_plc() -> None:
    with roc(cycle=0.1, plc=True, samples=5, linger=0.1) as device:
        device.wait()
    made = {line["k"]: line["mono_ns"] for line in lines(device, "made")}
    cleared = {line["k"]: line["mono_ns"] for line in lines(device, "plc_clear")}
    assert cleared.keys() == made.keys()
    assert all(-1e6 <= cleared[k] - made[k] < 0.099e9 for k in made)


def test_identical() -> None:
    with roc(cycle=0.02, identical_every=3, samples=7, linger=0) as device:
        device.wait()
    blocks = [tuple(line["registers"]) for line in lines(device, "made")]
    assert [k for k in range(2, 8) if blocks[k - 1] == blocks[k - 2]] == [3, 6]
    assert lines(device, "made")[2]["identical"] is True


def test_link_drops_tcp() -> None:
    with roc(cycle=5, drop_link_every=0.1) as device, tcp(device) as client:
        client.block()
        with pytest.raises(ConnectionResetError):
            client.receive(1)
        with tcp(device) as again:
            again.block()


def test_link_drops_pty(tmp_path: Path) -> None:
    link = tmp_path / "roc"
    with roc(pty=str(link), cycle=5, drop_link_every=0.6) as device:
        with serial(str(link)) as client:
            wait_for(device, "link_dropped")
            with pytest.raises(OSError, match="Input/output"):
                client.send(RTU_READ)
        assert not link.is_symlink()
        until(link.is_symlink)
        with serial(str(link)) as client:
            assert len(client.ask(RTU_READ, RTU_ANSWER)) == RTU_ANSWER
    assert not link.is_symlink()


def test_stop_after() -> None:
    with roc(cycle=0.1, stop_after=2, linger=0.3) as device, tcp(device) as client:
        wait_for(device, "made", 2)
        client.block()
        wait_for(device, "dead")
        client.send(TCP_READ)
        assert wait_for(device, "ignored")["why"] == "silence"
        assert not client.receive(1, 0.02)
        device.wait()
    assert len(lines(device, "made")) == 2


def lives(device: RocDevice, k: int, number: int) -> None:
    until(lambda: [line["k"] for line in lines(device, "live")].count(k) >= number)


def test_check_disk(tmp_path: Path) -> None:
    writer_module = pytest.importorskip("mcap.writer")
    options = {"cycle": 0.25, "live": True, "check_disk": str(tmp_path)}
    with (tmp_path / "log.mcap").open("wb") as file, roc(**options) as device:
        writer = writer_module.Writer(
            file, chunk_size=1, compression=writer_module.CompressionType.NONE
        )
        writer.start()
        channel = writer.register_channel("roc", "x", 0)
        with tcp(device) as client:
            for k, stored in enumerate((True, False, True), 1):
                wait_for(device, "made", k)
                answer = client.ask(TCP_READ, TCP_ANSWER)
                lives(device, k, 1)  # what was read is not the block any more
                if stored:
                    writer.add_message(channel, 0, b"head" + answer[9:] + b"tail", 0)
                    file.flush()
                client.clear()
            writer.finish()
            file.flush()
            wait_for(device, "made", 4)
            client.clear()
    clears = lines(device, "clear")
    assert [line["on_disk"] for line in clears] == [True, False, True, False]
    assert [line["on_disk_form"] for line in clears] == ["whole", None, "whole", None]
    assert not any("disk_errors" in line for line in clears)


def test_disk_reads_on_behind_an_unfinished_tail(tmp_path: Path) -> None:
    writer_module = pytest.importorskip("mcap.writer")
    whole, path = tmp_path / "whole", tmp_path / "log.mcap"
    with whole.open("wb") as file:
        writer = writer_module.Writer(
            file, chunk_size=1, compression=writer_module.CompressionType.NONE
        )
        writer.start()
        channel = writer.register_channel("roc", "x", 0)
        for number in range(3):
            writer.add_message(channel, 0, b"payload %d" % number, 0)
        writer.finish()
    octets, disk = whole.read_bytes(), Disk(str(tmp_path))
    seen = [False] * 3
    for end in range(len(octets) + 1):
        path.write_bytes(octets[:end])
        found = [disk.find([(b"load %d" % k, "whole")]) for k in range(3)]
        assert not any(errors for _, errors in found), end
        now = [mark == "whole" for mark, _ in found]
        assert now >= seen
        seen = now
    assert all(seen)
    assert disk.find([(b"1payload", "whole")]) == (None, [])  # not across two messages
    damaged = bytearray(octets)
    damaged[octets.index(b"payload 1")] ^= 1
    path.write_bytes(damaged)
    assert "crc" in Disk(str(tmp_path)).find([(b"load 2", "whole")])[1][0].lower()


# -- as a process -----------------------------------------------------------------------------


def process(*arguments: str) -> subprocess.Popen[str]:
    script = Path(__file__).with_name("roc.py")
    command = [sys.executable, str(script), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def test_process_on_sigterm(tmp_path: Path) -> None:
    truth, link = tmp_path / "truth.jsonl", tmp_path / "roc"
    with process("--pty", str(link), "--cycle", "0.05", "--truth", str(truth)) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == f"listening {link}\n"
        with serial(str(link)) as client:
            assert len(client.ask(RTU_READ, RTU_ANSWER)) == RTU_ANSWER
        running.send_signal(signal.SIGTERM)
        assert running.wait(PATIENCE) == 0
    events = [json.loads(line) for line in truth.read_text().splitlines()]
    assert (events[0]["event"], events[-1]["event"]) == ("start", "summary")
    assert events[-1]["reads"] == {"ok": 1}
    assert all(isinstance(line["wall_ns"] + line["mono_ns"], int) for line in events)


def test_process_ends_by_itself() -> None:
    options = ("--cycle", "0.02", "--samples", "3", "--linger", "0.1", "--word-order", "CDAB")
    with process("--tcp", "127.0.0.1:0", *options) as running:
        assert running.stdout is not None
        word, port = running.stdout.readline().split()
        assert (word, port.isdigit()) == ("listening", True)
        assert running.wait(PATIENCE) == 0


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--tcp", "127.0.0.1:0", "--pty", "x"],
        ["--tcp", "127.0.0.1:0", "--late", "0.6", "--drop", "0.6"],
        ["--tcp", "127.0.0.1:0", "--tear", "--tear-for", "0.2"],
        ["--pty", "x", "--drop-link-every", "0.5"],
    ],
)
def test_impossible_options(arguments: list[str]) -> None:
    with pytest.raises(SystemExit):
        parse_options(arguments)

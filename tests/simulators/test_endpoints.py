"""Devices on the wire, asked with octets: no codec of roclog's, no client of pymodbus's."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import time
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import pytest
from pymodbus.framer import FramerRTU

from roclog.simulators import (
    LineSettings,
    PtyEndpoint,
    RtuOverTcpEndpoint,
    SimulatedRoc,
    SimulatorServer,
    TcpEndpoint,
    UdpEndpoint,
    endpoints,
)

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable
    from pathlib import Path

    ReadOctets = Callable[[int, int], Awaitable[bytes]]
    Until = Callable[[Callable[[], bool]], Awaitable[None]]

READ_BLOCK = bytes.fromhex("8A 03 01 2C 00 1B DB 4F")
CLEAR_FLAG = bytes.fromhex("8A 06 01 2C 00 00 57 44")
READ_IDENTITY = bytes.fromhex("8A 03 00 00 00 30 5B 65")


def crc(octets: bytes) -> bytes:
    """CRC of the serial line guide, bit by bit; low octet first."""
    remainder = 0xFFFF
    for octet in octets:
        remainder ^= octet
        for _ in range(8):
            remainder = remainder >> 1 ^ (0xA001 if remainder & 1 else 0)
    return remainder.to_bytes(2, "little")


def frame(text: str) -> bytes:
    octets = bytes.fromhex(text)
    return octets + crc(octets)


class Broken:
    """Fails at each request."""

    unit = 9

    def step(self, seconds: float) -> None:
        pass

    def answer(self, pdu: bytes) -> bytes | None:
        raise ZeroDivisionError


class Line:
    """A client on a pseudo-terminal."""

    def __init__(self, link: Path, read: ReadOctets) -> None:
        self._descriptor = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._read = read

    def send(self, octets: bytes) -> None:
        os.write(self._descriptor, octets)

    async def ask(self, octets: bytes, size: int) -> bytes:
        self.send(octets)
        return await self._read(self._descriptor, size)

    def close(self) -> None:
        os.close(self._descriptor)


@asynccontextmanager
async def pty(link: Path, read: ReadOctets, *devices: SimulatedRoc | Broken) -> AsyncIterator[Line]:
    async with SimulatorServer(devices, PtyEndpoint(link)):
        line = Line(link, read)
        try:
            yield line
        finally:
            line.close()


@asynccontextmanager
async def tcp(
    *devices: SimulatedRoc | Broken,
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    endpoint = TcpEndpoint("127.0.0.1", 0)
    async with asyncio.timeout(5), SimulatorServer(devices, endpoint):
        reader, writer = await asyncio.open_connection("127.0.0.1", endpoint.port)
        try:
            yield reader, writer
        finally:
            writer.close()
            await writer.wait_closed()


def test_crc_of_the_test_agrees_with_published_frames() -> None:
    assert frame("CC 04 00 00 00 7D").endswith(bytes.fromhex("20 36"))
    assert frame("8A 03 01 2C 00 1B") == READ_BLOCK


def test_rtu_identity(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        async with pty(tmp_path / "roc", read_octets, SimulatedRoc(seed=7)) as line:
            answer = await line.ask(READ_IDENTITY, 101)
            assert answer[:7] == bytes.fromhex("8A 03 60 48 49 41 43")
            assert answer[33:36] == b"ROC"
            assert answer[53:71] == b"000007-138HIAC ROC"
            assert answer[85:99] == b"2089263-1 RevC"
            assert answer[99:] == crc(answer[:99])

    asyncio.run(main())


def test_rtu_sample_and_clear(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        roc = SimulatedRoc(seed=7)
        roc.step(10)
        async with pty(tmp_path / "roc", read_octets, roc) as line:
            block = await line.ask(READ_BLOCK, 59)
            assert block[:5] == bytes.fromhex("8A 03 36 00 01")
            assert block[57:] == crc(block[:57])
            assert await line.ask(CLEAR_FLAG, 8) == CLEAR_FLAG
            again = await line.ask(READ_BLOCK, 59)
            assert again[:5] == bytes.fromhex("8A 03 36 00 00")
            assert again[5:57] == block[5:57]

    asyncio.run(main())


@pytest.mark.parametrize(
    ("request_adu", "answer"),
    [
        ("8A 04 01 2C 00 1B", "8A 84 01"),
        ("8A 03 01 2C 00 1C", "8A 83 02"),
        ("8A 06 01 2C 00 01", "8A 86 03"),
        ("8A 10 00 69 00 02 04 00 14 00 02", "8A 10 00 69 00 02"),
        ("8A 2B 0E 01 00", "8A AB 01"),
        ("8A 2B 84 00 08 00 02", "8A AB 01"),
        ("8A 6E 01 02 03 04 05 06 07 08 09", "8A EE 01"),
        ("8A 11", "8A 91 01"),
        ("09 03 00 00 00 01", "09 83 04"),
    ],
)
def test_rtu_answers(
    tmp_path: Path, read_octets: ReadOctets, request_adu: str, answer: str
) -> None:
    async def main() -> None:
        async with pty(tmp_path / "roc", read_octets, SimulatedRoc(seed=7), Broken()) as line:
            expected = frame(answer)
            assert await line.ask(frame(request_adu), len(expected)) == expected

    asyncio.run(main())


def test_rtu_request_that_arrives_octet_by_octet(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        async with pty(tmp_path / "roc", read_octets, SimulatedRoc(seed=7)) as line:
            for octet in CLEAR_FLAG[:-1]:
                line.send(bytes((octet,)))
                for _ in range(5):
                    await asyncio.sleep(0)
            assert await line.ask(CLEAR_FLAG[-1:], 8) == CLEAR_FLAG

    asyncio.run(main())


WRITE_123_REGISTERS = "8A 10 05 00 00 7B F6" + 117 * " 00 01" + " 8A 6E 00 09"


def test_rtu_long_request_octet_by_octet_is_not_taken_apart(
    tmp_path: Path, read_octets: ReadOctets
) -> None:
    inner = frame("8A 6E 01 02")  # a whole request, of a function without known length
    request = frame(WRITE_123_REGISTERS + inner.hex() + "00 01")
    assert len(request) == 255

    async def main() -> None:
        async with pty(tmp_path / "roc", read_octets, SimulatedRoc(seed=7)) as line:
            for octet in request[:-1]:
                line.send(bytes((octet,)))
                for _ in range(3):
                    await asyncio.sleep(0)
            refused = frame("8A 90 02")
            assert await line.ask(request[-1:], len(refused)) == refused

    asyncio.run(main())


@pytest.mark.parametrize(
    "request_adu",
    [
        "8A 03 01 2C 00 1B",
        "8A 06 01 2C 00 00",
        "8A 07",
        "8A 11",
        "8A 16 00 04 00 F2 00 25",
        "8A 18 04 DE",
        "8A 14 07 06 00 04 00 01 00 02",
        "8A 17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF",
        "8A 0F 00 13 00 0A 02 CD 01",
        WRITE_123_REGISTERS + " 00 01" * 4,
    ],
    ids=lambda text: text[:5],
)
def test_rtu_request_of_known_length_is_cheap(
    request_adu: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = []
    check = FramerRTU.check_CRC

    def counted(octets: bytes, remainder: int) -> bool:
        checks.append(len(octets))
        return check(octets, remainder)

    monkeypatch.setattr(endpoints._RtuFramer, "check_CRC", staticmethod(counted))
    framer = endpoints._RtuFramer(endpoints._Decoder(lambda unit, pdu: None))
    request = frame(request_adu)
    for size in range(len(request)):
        assert framer.decode(request[:size]) == (0, 0, 0, b"")
    assert framer.decode(request) == (len(request), 0x8A, 0, request[1:-2])
    # Inside long ones there are octets that look like short requests just complete.
    assert sum(checks) <= 5 * len(request)


@pytest.mark.parametrize("private", ["8A 2B 84 00 08 00 02", "8A 6E 01 02 03"])
def test_rtu_private_request_behind_noise(private: str) -> None:
    framer = endpoints._RtuFramer(endpoints._Decoder(lambda unit, pdu: None))
    request = frame(private)
    for noise in (b"", b"\xff\xfe\xfd", READ_BLOCK[:-1] + b"\0"):
        octets = noise + request
        answers = [framer.decode(octets[:size]) for size in range(len(octets) + 1)]
        assert answers.pop() == (len(octets), 0x8A, 0, request[1:-2])
        assert set(answers) == {(0, 0, 0, b"")}


@pytest.mark.parametrize(
    "unheard",
    [
        frame("05 03 01 2C 00 1B"),
        frame("00 06 01 2C 00 00"),
        READ_BLOCK[:-1] + b"\x4e",
        READ_BLOCK[:5],
        b"\x00\xff\x8a",
        frame(WRITE_123_REGISTERS)[:20],
    ],
    ids=["absent unit", "unit 0", "bad CRC", "torn", "noise", "torn long request"],
)
def test_rtu_silence_then_the_next_request_is_answered(
    tmp_path: Path, read_octets: ReadOctets, unheard: bytes
) -> None:
    async def main() -> None:
        async with pty(tmp_path / "roc", read_octets, SimulatedRoc(seed=7)) as line:
            line.send(unheard)
            assert await line.ask(CLEAR_FLAG, 8) == CLEAR_FLAG

    asyncio.run(main())


def test_rtu_reset_is_silent_and_the_saved_node_id_answers(
    tmp_path: Path, read_octets: ReadOctets, until: Until
) -> None:
    async def main() -> None:
        roc = SimulatedRoc(seed=7)
        async with pty(tmp_path / "roc", read_octets, roc) as line:
            node_id, save = frame("8A 06 00 64 00 07"), frame("8A 06 04 4E 00 5A")
            assert await line.ask(node_id, 8) == node_id
            assert await line.ask(save, 8) == save
            line.send(frame("8A 06 04 4D 00 55"))
            await until(lambda: roc.unit == 7)
            clear = frame("07 06 01 2C 00 00")
            assert await line.ask(clear, 8) == clear

    asyncio.run(main())


def test_several_units_on_one_line(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        rocs = [SimulatedRoc(unit, seed=7) for unit in (1, 138, 247)]
        async with pty(tmp_path / "roc", read_octets, *rocs) as line:
            for unit in ("01", "8A", "F7"):
                expected = frame(f"{unit} 03 02 00 {unit}")
                assert await line.ask(frame(f"{unit} 03 00 64 00 01"), 7) == expected

    asyncio.run(main())


def test_line_with_wire_time_tells_what_it_saw(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        settings = LineSettings(baud=115_200, turnaround_ns=1_000_000)
        endpoint = PtyEndpoint(tmp_path / "roc", settings)
        assert endpoint.statistics is None
        async with SimulatorServer([SimulatedRoc(seed=7)], endpoint):
            line = Line(tmp_path / "roc", read_octets)
            begin = time.monotonic()
            assert len(await line.ask(READ_BLOCK, 59)) == 59
            assert time.monotonic() - begin >= 0.001 + (8 + 59) * 10 / 115_200
            line.close()
        seen = endpoint.statistics
        assert seen is not None
        assert (seen.requests, seen.answers, seen.answer_octets) == (1, 1, 59)

    asyncio.run(main())


def test_line_can_be_taken_down_and_up_again(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        link, roc = tmp_path / "roc", SimulatedRoc(seed=7)
        server = SimulatorServer([roc], PtyEndpoint(link))
        for _ in range(2):
            await server.start()
            line = Line(link, read_octets)
            assert await line.ask(CLEAR_FLAG, 8) == CLEAR_FLAG
            line.close()
            await server.stop()
            assert not link.is_symlink()

    asyncio.run(main())


def test_tcp_answers() -> None:
    async def main() -> None:
        async with tcp(SimulatedRoc(seed=7), Broken()) as (reader, writer):
            for request, answer in (
                ("00 01 00 00 00 06 8A 03 00 64 00 01", "00 01 00 00 00 05 8A 03 02 00 8A"),
                ("FF FE 00 00 00 06 8A 06 01 2C 00 00", "FF FE 00 00 00 06 8A 06 01 2C 00 00"),
                ("00 03 00 00 00 06 8A 04 01 2C 00 1B", "00 03 00 00 00 03 8A 84 01"),
                ("00 04 00 00 00 08 8A 2B 84 00 08 00 02 00", "00 04 00 00 00 03 8A AB 01"),
                ("00 05 00 00 00 06 05 03 01 2C 00 1B", "00 05 00 00 00 03 05 83 0B"),
                ("00 06 00 00 00 06 09 03 01 2C 00 1B", "00 06 00 00 00 03 09 83 04"),
            ):
                expected = bytes.fromhex(answer)
                writer.write(bytes.fromhex(request))
                assert await reader.readexactly(len(expected)) == expected

    asyncio.run(main())


def test_tcp_reset_is_silent(until: Until) -> None:
    async def main() -> None:
        roc = SimulatedRoc(seed=7)
        roc.step(10)
        ask_flag = bytes.fromhex("03 01 2C 00 01")
        async with tcp(roc) as (reader, writer):
            writer.write(bytes.fromhex("00 01 00 00 00 06 8A 06 04 4D 00 55"))
            await until(lambda: roc.answer(ask_flag) == bytes.fromhex("03 02 00 00"))
            writer.write(bytes.fromhex("00 02 00 00 00 06 8A 03 00 64 00 01"))
            assert await reader.readexactly(11) == bytes.fromhex("00 02 00 00 00 05 8A 03 02 00 8A")

    asyncio.run(main())


def test_device_that_fails_at_a_request_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        async with tcp(Broken()) as (reader, writer):
            writer.write(bytes.fromhex("00 01 00 00 00 06 09 03 01 2C 00 1B"))
            await reader.readexactly(9)

    with caplog.at_level(logging.ERROR):
        asyncio.run(main())
    assert [record.name for record in caplog.records] == ["roclog.simulators.endpoints"]
    assert "simulated unit 9 failed at 03 01 2c 00 1b" in caplog.text


def test_tcp_port_in_use() -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            server = SimulatorServer([SimulatedRoc(seed=7)], TcpEndpoint("127.0.0.1", port))
            with pytest.raises(OSError, match=f"cannot listen on 127.0.0.1:{port}"):
                await server.start()
            await server.stop()

    asyncio.run(main())


def test_two_rocs_one_on_a_pty_and_one_on_tcp(tmp_path: Path, read_octets: ReadOctets) -> None:
    async def main() -> None:
        one, two = SimulatedRoc(seed=7), SimulatedRoc(seed=8)
        async with (
            pty(tmp_path / "roc", read_octets, one) as line,
            tcp(two) as (reader, writer),
        ):
            writer.write(bytes.fromhex("00 01 00 00 00 06 8A 03 00 19 00 05"))
            assert await line.ask(frame("8A 03 00 19 00 05"), 15) == frame(
                "8A 03 0A" + b"000007-138".hex()
            )
            assert (await reader.readexactly(19))[9:] == b"000008-138"

    asyncio.run(main())


class Datagrams:
    """A client of a UDP endpoint: each answer waits up to 5 s."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(("127.0.0.1", port))

    def send(self, text: str) -> None:
        self._socket.send(bytes.fromhex(text))

    async def receive(self) -> bytes:
        async with asyncio.timeout(5):
            return await asyncio.get_running_loop().sock_recv(self._socket, 4096)

    def close(self) -> None:
        self._socket.close()


def test_udp_answers() -> None:
    async def main() -> None:
        endpoint = UdpEndpoint("127.0.0.1", 0)
        async with SimulatorServer([SimulatedRoc(seed=7), Broken()], endpoint):
            client = Datagrams(endpoint.port)
            for request, answer in (
                ("00 01 00 00 00 06 8A 03 00 64 00 01", "00 01 00 00 00 05 8A 03 02 00 8A"),
                ("FF FE 00 00 00 06 8A 06 01 2C 00 00", "FF FE 00 00 00 06 8A 06 01 2C 00 00"),
                ("00 03 00 00 00 06 8A 04 01 2C 00 1B", "00 03 00 00 00 03 8A 84 01"),
                ("00 05 00 00 00 06 05 03 01 2C 00 1B", "00 05 00 00 00 03 05 83 0B"),
                ("00 06 00 00 00 06 09 03 01 2C 00 1B", "00 06 00 00 00 03 09 83 04"),
            ):
                client.send(request)
                assert await client.receive() == bytes.fromhex(answer)
            client.close()

    asyncio.run(main())


@pytest.mark.parametrize(
    "broken",
    [
        "00",
        "00 01 00 00 00 06 8A 03",
        "00 01 00 01 00 06 8A 03 00 64 00 01",
        "00 01 00 00 00 06 8A 03 00 64 00 01 00",
        2 * "00 01 00 00 00 06 8A 03 00 64 00 01 ",
    ],
)
def test_udp_drops_what_is_not_one_request(broken: str) -> None:
    async def main() -> None:
        endpoint = UdpEndpoint("127.0.0.1", 0)
        async with SimulatorServer([SimulatedRoc(seed=7)], endpoint):
            client = Datagrams(endpoint.port)
            client.send(broken)
            client.send("00 02 00 00 00 06 8A 03 00 64 00 01")
            assert await client.receive() == bytes.fromhex("00 02 00 00 00 05 8A 03 02 00 8A")
            client.close()

    asyncio.run(main())


def test_rtu_over_tcp_answers() -> None:
    """Piece by piece, and nothing for a unit that is not there."""

    async def main() -> None:
        endpoint = RtuOverTcpEndpoint("127.0.0.1", 0)
        async with asyncio.timeout(5), SimulatorServer([SimulatedRoc(seed=7)], endpoint):
            reader, writer = await asyncio.open_connection("127.0.0.1", endpoint.port)
            writer.write(frame("07 03 01 2C 00 1B"))
            await asyncio.sleep(0.02)
            for cut in (8, 3):
                writer.write(CLEAR_FLAG[:cut])
                await asyncio.sleep(0.02)
                writer.write(CLEAR_FLAG[cut:])
                assert await reader.readexactly(8) == CLEAR_FLAG
            writer.write(READ_IDENTITY)
            answer = await reader.readexactly(101)
            assert answer[:3] == bytes.fromhex("8A 03 60")
            assert answer[99:] == crc(answer[:99])
            writer.close()
            await writer.wait_closed()

    asyncio.run(main())


@pytest.mark.parametrize("kind", [UdpEndpoint, RtuOverTcpEndpoint])
def test_network_endpoints_open_again_where_they_were(
    kind: type[UdpEndpoint | RtuOverTcpEndpoint],
) -> None:
    async def main() -> None:
        endpoint = kind("127.0.0.1", 0)
        server = SimulatorServer([SimulatedRoc(seed=7)], endpoint)
        ports = set()
        for _ in range(3):
            await server.start()
            other = SimulatorServer([SimulatedRoc(seed=7)], kind("127.0.0.1", endpoint.port))
            with pytest.raises(OSError, match=f"cannot listen on 127.0.0.1:{endpoint.port}"):
                await other.start()
            ports.add(endpoint.port)
            await server.stop()
            await asyncio.sleep(0)
        assert len(ports) == 1

    asyncio.run(main())

"""Endpoints on pymodbus's servers; the only module of the simulators that knows pymodbus.

The simulators take framing, CRC and MBAP header from pymodbus on purpose: the logger has its own,
so a mistake in either shows as a device that does not answer.

From pymodbus 3.16.1 this relies on the servers' attributes `decoder` and `framer` being used for
every connection made after they were replaced, on `ModbusPDU.datastore_update` giving the answer,
and on `NoSuchIdException` with `ignore_missing_devices` giving silence.
"""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final

from pymodbus.exceptions import NoSuchIdException
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.server import ModbusSerialServer, ModbusTcpServer, ModbusUdpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from roclog.simulators.serial_line import LineSettings, SerialLine

if TYPE_CHECKING:
    import os

    from pymodbus.datastore import ModbusServerContext

    from roclog.simulators.serial_line import Statistics
    from roclog.simulators.server import Answer

    Server = ModbusTcpServer | ModbusUdpServer | ModbusSerialServer

logger = logging.getLogger(__name__)

SMALLEST_FRAME: Final = 4
LONGEST_FRAME: Final = 256

FIXED_LENGTHS: Final = {
    1: 8,
    2: 8,
    3: 8,
    4: 8,
    5: 8,
    6: 8,
    7: 4,
    11: 4,
    12: 4,
    17: 4,
    22: 10,
    24: 6,
}
"""Octets of a request with address and CRC, by function code."""

COUNTED: Final = {15: (6, 9), 16: (6, 9), 20: (2, 5), 21: (2, 5), 23: (10, 13)}
"""Place of the octet that counts those behind it, and the octets of a request besides those."""


class NetworkEndpoint(ABC):
    """Devices on `host` and `port`.

    Port 0 takes a free one; `port` tells which while the endpoint is open.
    `is_little_endian`: the fields of the MBAP header are; PDUs are the devices' own affair.
    """

    is_gateway: bool

    def __init__(self, host: str, port: int, *, is_little_endian: bool = False) -> None:
        self.host = host
        self.port = port
        self.is_little_endian = is_little_endian
        self._server: ModbusTcpServer | ModbusUdpServer | None = None

    @abstractmethod
    def _new_server(self) -> ModbusTcpServer | ModbusUdpServer: ...

    async def open(self, answer: Answer) -> None:
        server = self._new_server()
        await _serve(server, answer, f"{self.host}:{self.port}")
        self._server = server
        if isinstance(server.transport, asyncio.Server):
            self.port = server.transport.sockets[0].getsockname()[1]
        else:
            self.port = server.transport.get_extra_info("sockname")[1]

    async def close(self) -> None:
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
            self._server = None


class TcpEndpoint(NetworkEndpoint):
    """Modbus TCP; a unit id without a device is answered as by a gateway."""

    is_gateway = True

    def _new_server(self) -> ModbusTcpServer:
        address = self.host, self.port
        server = ModbusTcpServer(_unused_device(), address=address, ignore_missing_devices=True)
        if self.is_little_endian:
            server.framer = _LittleEndianFramer
        return server


class UdpEndpoint(NetworkEndpoint):
    """Modbus UDP; a unit id without a device is answered as by a gateway.

    Of requests that arrive from two clients at the same time one may be lost, as on any network.
    """

    is_gateway = True

    def _new_server(self) -> ModbusUdpServer:
        address = self.host, self.port
        server = ModbusUdpServer(_unused_device(), address=address, ignore_missing_devices=True)
        server.framer = _LittleEndianDatagram if self.is_little_endian else _DatagramFramer
        return server


class RtuOverTcpEndpoint(NetworkEndpoint):
    """Modbus RTU over TCP, as a gateway that passes octets through; absent units are silent."""

    is_gateway = False

    def _new_server(self) -> ModbusTcpServer:
        address = self.host, self.port
        server = ModbusTcpServer(_unused_device(), address=address, ignore_missing_devices=True)
        server.framer = _RtuFramer
        return server


class PtyEndpoint:
    """Modbus RTU on a pseudo-terminal that clients open as `link`; absent units are silent.

    `settings` tell how the line is; without them octets take no time on it.
    """

    is_gateway = False

    def __init__(self, link: str | os.PathLike[str], settings: LineSettings | None = None) -> None:
        self.link = link
        self.settings = settings or LineSettings()
        self._line: SerialLine | None = None
        self._server: ModbusSerialServer | None = None
        self._statistics: Statistics | None = None

    @property
    def statistics(self) -> Statistics | None:
        """What the line has seen, also after closing; None before it is opened."""
        return self._statistics if self._line is None else self._line.statistics()

    async def open(self, answer: Answer) -> None:
        self._line = SerialLine(self.link, settings=self.settings)
        try:
            server = ModbusSerialServer(
                _unused_device(), port=self._line.server_port, ignore_missing_devices=True
            )
            server.framer = _RtuFramer
            await _serve(server, answer, self._line.server_port)
        except BaseException:
            await self.close()
            raise
        self._server = server

    async def close(self) -> None:
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
            self._server = None
        if self._line is not None:
            self._line.close()
            self._statistics = self._line.statistics()
            self._line = None


async def _serve(server: Server, answer: Answer, place: str) -> None:
    # pymodbus logs every frame that it cannot use as an error; on a line that is not news.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    server.decoder = _Decoder(answer)
    try:
        await server.serve_forever(background=True)
    except RuntimeError as error:
        raise OSError(f"cannot listen on {place}") from error
    # The serial server begins to read two turns of the loop later and cannot be closed before.
    for _ in range(3):
        await asyncio.sleep(0)


def _unused_device() -> SimDevice:
    """Give what the constructors of pymodbus insist on; the requests never look at it."""
    return SimDevice(0, [SimData(0, values=[0], datatype=DataType.REGISTERS)])


class _Octets(ModbusPDU):
    """An answer as it is."""

    def __init__(self, pdu: bytes) -> None:
        super().__init__()
        self.function_code = pdu[0]
        self._payload = pdu[1:]

    def encode(self) -> bytes:
        return self._payload


class _Request(ModbusPDU):
    """Any request, not looked into."""

    def __init__(self, pdu: bytes, answer: Answer) -> None:
        super().__init__()
        self.function_code = pdu[0]
        self._pdu = pdu
        self._answer = answer
        self._is_handled = False

    async def datastore_update(self, context: ModbusServerContext, device_id: int) -> ModbusPDU:
        del context
        if self._is_handled:
            # pymodbus handles the latest request as often as requests came in one turn of the loop.
            raise NoSuchIdException
        self._is_handled = True
        try:
            answer = self._answer(device_id, self._pdu)
        except Exception:
            logger.exception("simulated unit %d failed at %s", device_id, self._pdu.hex(" "))
            raise  # pymodbus answers with exception 4
        if answer is None:
            raise NoSuchIdException
        return _Octets(answer)


class _Decoder(DecodePDU):
    """Takes every function code."""

    def __init__(self, answer: Answer) -> None:
        super().__init__(is_server=True)
        self._answer = answer

    def decode(self, frame: bytes) -> ModbusPDU | None:
        return _Request(bytes(frame), self._answer)


class _RtuFramer(FramerRTU):
    """Finds the request that ends with the octets received so far.

    A request is as long as its function code says and ends in the CRC of its other octets. RTU
    gives no length for private function codes: there the CRC alone tells, after each octet. Noise
    in front of a request and requests that were broken off are skipped. While the first octets may
    be a request that is still arriving, only a whole one of known length is taken in its place:
    among the many pairs of a beginning and an end in a long request, some CRC is right by chance.
    """

    def decode(self, data: bytes) -> tuple[int, int, int, bytes]:
        size = _request_size(data, 0)
        is_arriving = size is not None and len(data) < size <= LONGEST_FRAME
        for start in range(len(data) - SMALLEST_FRAME + 1):
            size = _request_size(data, start)
            if size != len(data) - start and (is_arriving or size is not None):
                continue
            if self.check_CRC(data[start:-2], int.from_bytes(data[-2:], "big")):
                return len(data), data[start], 0, data[start + 1 : -2]
        return 0, 0, 0, self.EMPTY


class _DatagramFramer(FramerSocket):
    """Drops a datagram that is not one whole request; no part of it waits for the next."""

    def decode(self, data: bytes) -> tuple[int, int, int, bytes]:
        size, unit, transaction, pdu = super().decode(data)
        if size != len(data):
            return len(data), 0, 0, self.EMPTY
        return size, unit, transaction, pdu


class _LittleEndianFramer(FramerSocket):
    """Turns the three words of the MBAP header round."""

    def decode(self, data: bytes) -> tuple[int, int, int, bytes]:
        return super().decode(_turned(data))

    def encode(self, payload: bytes, device_id: int, tid: int) -> bytes:
        return _turned(super().encode(payload, device_id, tid))


class _LittleEndianDatagram(_LittleEndianFramer, _DatagramFramer):
    """Both."""


def _turned(frame: bytes) -> bytes:
    words = (frame[at : at + 2][::-1] for at in (0, 2, 4))
    return b"".join(words) + frame[6:]


def _request_size(data: bytes, start: int) -> int | None:
    """Octets of the request at `start` with its CRC; None when nothing tells it.

    More than there are when the octet that tells it has not arrived.
    """
    present = len(data) - start
    if present < 2:
        return present + 1
    function = data[start + 1]
    if function not in COUNTED:
        return FIXED_LENGTHS.get(function)
    place, others = COUNTED[function]
    return data[start + place] + others if place < present else present + 1

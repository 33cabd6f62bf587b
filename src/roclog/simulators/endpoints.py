"""Endpoints on pymodbus's servers; the only module of the simulators that knows pymodbus.

The simulators take framing, CRC and MBAP header from pymodbus on purpose: the logger has its own,
so a mistake in either shows as a device that does not answer.

From pymodbus 3.16.1 this relies on the servers' attribute `decoder` being used for every
connection made after it was replaced, on `ModbusPDU.datastore_update` giving the answer, and on
`NoSuchIdException` with `ignore_missing_devices` giving silence.
"""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final

from pymodbus.exceptions import NoSuchIdException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from roclog.simulators.pty_line import PtyLine

if TYPE_CHECKING:
    import os

    from pymodbus.datastore import ModbusServerContext

    from roclog.simulators.server import Answer

logger = logging.getLogger(__name__)

SMALLEST_FRAME: Final = 4


class TcpEndpoint:
    """Modbus TCP on `host` and `port`; a unit id without a device is answered as by a gateway.

    Port 0 takes a free one; `port` tells which while the endpoint is open.
    """

    is_gateway = True

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self._server: ModbusTcpServer | None = None

    async def open(self, answer: Answer) -> None:
        server = ModbusTcpServer(
            _unused_device(), address=(self.host, self.port), ignore_missing_devices=True
        )
        await _serve(server, answer, f"{self.host}:{self.port}")
        self._server = server
        if isinstance(server.transport, asyncio.Server):
            self.port = server.transport.sockets[0].getsockname()[1]

    async def close(self) -> None:
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
            self._server = None


class PtyEndpoint:
    """Modbus RTU on a pseudo-terminal that clients open as `link`; absent units are silent."""

    is_gateway = False

    def __init__(self, link: str | os.PathLike[str]) -> None:
        self.link = link
        self._line: PtyLine | None = None
        self._server: ModbusSerialServer | None = None

    async def open(self, answer: Answer) -> None:
        self._line = PtyLine(self.link)
        try:
            server = ModbusSerialServer(
                _unused_device(), port=self._line.server_port, ignore_missing_devices=True
            )
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
            self._line = None


async def _serve(server: ModbusTcpServer | ModbusSerialServer, answer: Answer, place: str) -> None:
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

    @classmethod
    def calculateRtuFrameSize(cls, data: bytes) -> int:  # noqa: N802 - name given by pymodbus
        return len(data)

    async def datastore_update(self, context: ModbusServerContext, device_id: int) -> ModbusPDU:
        del context
        try:
            answer = self._answer(device_id, self._pdu)
        except Exception:
            logger.exception("simulated unit %d failed at %s", device_id, self._pdu.hex(" "))
            raise  # pymodbus answers with exception 4
        if answer is None:
            raise NoSuchIdException
        return _Octets(answer)


class _Decoder(DecodePDU):
    """Takes every function code, and on a serial line tells where a request ends.

    RTU gives no length, and pymodbus knows none for private function codes. A request is complete
    when the octets received so far end in the CRC of the others; pymodbus tries this from the
    first octet, then from the second and so on, so noise in front of a request is skipped.
    """

    def __init__(self, answer: Answer) -> None:
        super().__init__(is_server=True)
        self._answer = answer

    def lookupPduClass(self, data: bytes) -> type[ModbusPDU] | None:  # noqa: N802
        if len(data) < SMALLEST_FRAME:
            return None
        crc = int.from_bytes(data[-2:], "big")
        return _Request if FramerRTU.check_CRC(data[:-2], crc) else None

    def decode(self, frame: bytes) -> ModbusPDU | None:
        return _Request(bytes(frame), self._answer)

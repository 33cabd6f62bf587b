"""The least that a Python program on asyncio can do: one Protocol, one future for each read."""

from __future__ import annotations

import asyncio
import struct
from typing import TYPE_CHECKING, cast

from yardstick.frames import REGISTERS, request_pdu, tcp_tail

if TYPE_CHECKING:
    from yardstick.job import Job

_WORDS = struct.Struct(f">{REGISTERS}H")
_ANSWER_SIZE = 9 + 2 * REGISTERS


class RawAsyncio(asyncio.Protocol):
    failures = (ConnectionError,)

    def __init__(self, job: Job) -> None:
        self._port = job.tcp_port
        self._requests: dict[int, bytes] = {}
        self._transaction = 0
        self._received = b""
        self._transport: asyncio.Transport
        self._waiter: asyncio.Future[bytes]
        self._loop: asyncio.AbstractEventLoop
        self.late_us: list[float] = []

    async def open(self) -> None:
        self._loop = asyncio.get_running_loop()
        await self._loop.create_connection(lambda: self, "127.0.0.1", self._port)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        self._received += data
        if len(self._received) >= _ANSWER_SIZE:
            answer, self._received = self._received, b""
            self._waiter.set_result(answer)

    async def read(self, address: int) -> tuple[int, ...]:
        if address not in self._requests:
            self._requests[address] = tcp_tail(request_pdu(address))
        self._transaction = self._transaction % 0xFFFF + 1
        number = self._transaction.to_bytes(2)
        self._waiter = self._loop.create_future()
        self._transport.write(number + self._requests[address])
        answer = await self._waiter
        if answer[:2] != number or len(answer) != _ANSWER_SIZE:
            raise ConnectionError("this is another answer")
        return _WORDS.unpack_from(answer, 9)

    def close(self) -> None:
        self._transport.abort()

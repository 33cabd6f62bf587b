"""pymodbus, the asynchronous client, without its retries: a failure is seen as one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pymodbus import ModbusException
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from yardstick.frames import REGISTERS, UNIT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from yardstick.job import Job


class PymodbusClient:
    failures = (ModbusException, ConnectionError)

    def __init__(self, job: Job) -> None:
        self._client: AsyncModbusSerialClient | AsyncModbusTcpClient
        self._job = job
        self.late_us: list[float] = []

    async def open(self) -> None:
        job = self._job
        if job.port:
            self._client = AsyncModbusSerialClient(
                job.port, baudrate=job.baud, timeout=job.timeout, retries=0
            )
        else:
            self._client = AsyncModbusTcpClient(
                "127.0.0.1", port=job.tcp_port, timeout=job.timeout, retries=0
            )
        if not await self._client.connect():
            raise ConnectionError("pymodbus did not connect")

    async def read(self, address: int) -> Sequence[int]:
        answer = await self._client.read_holding_registers(address, count=REGISTERS, device_id=UNIT)
        if answer.isError():
            raise ConnectionError(str(answer))
        return answer.registers

    def close(self) -> None:
        self._client.close()

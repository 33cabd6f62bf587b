"""``python -m yardstick.bare_polls FOLDER PORT DEVICES SECONDS``: pymodbus reads, nothing more.

One client and one task for each device, asyncio.sleep until the next read is due, first reads
spread over a period. What is read is thrown away. Prints what it cost as one line of JSON.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
from typing import Any

from pymodbus import ModbusException
from pymodbus.client import AsyncModbusTcpClient

from yardstick.fleet import FIRST_REGISTER, addresses
from yardstick.frames import REGISTERS, UNIT
from yardstick.process_cost import cost, since

_PERIOD = 1.0


async def _poll(client: AsyncModbusTcpClient, due: float, end: float, counts: list[int]) -> None:
    await asyncio.sleep(due - time.monotonic())
    await client.connect()
    while due < end:
        try:
            answer = await client.read_holding_registers(
                FIRST_REGISTER, count=REGISTERS, device_id=UNIT
            )
            counts[answer.isError()] += 1
        except ModbusException:
            counts[1] += 1
        due += _PERIOD
        await asyncio.sleep(max(0.0, due - time.monotonic()))
    client.close()


async def run(port: int, devices: int, seconds: float) -> dict[str, Any]:
    before = cost()
    start, counts = time.monotonic(), [0, 0]
    async with asyncio.TaskGroup() as group:
        for number, host in enumerate(addresses(devices)):
            client = AsyncModbusTcpClient(host, port=port, timeout=1, retries=0)
            due = start + _PERIOD * number / devices
            group.create_task(_poll(client, due, start + seconds, counts))
    return {"whole": since(before), "good": counts[0], "failed": counts[1]}


def main() -> None:
    logging.disable(logging.CRITICAL)
    _, port, devices, seconds = sys.argv[1:]
    print(json.dumps(asyncio.run(run(int(port), int(devices), float(seconds)))))


if __name__ == "__main__":
    main()

"""pymodbus as it comes, as a UDP server; arguments and output as of modbus_tk_server.py.

python pymodbus_server.py udp PORT UNIT REGISTERS
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pymodbus.pdu.register_message import WriteSingleRegisterRequest
from pymodbus.server import ModbusUdpServer
from pymodbus.simulator import DataType, SimData, SimDevice

if TYPE_CHECKING:
    from pymodbus.pdu import ModbusPDU


def tell(*, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
    if not sending and isinstance(pdu, WriteSingleRegisterRequest):
        print("wrote", pdu.address, pdu.registers[0], flush=True)
    return pdu


async def serve(place: str, unit: str, text: str) -> None:
    lines = [map(int, line.split()) for line in text.splitlines()]
    data = [SimData(address, values=value, datatype=DataType.REGISTERS) for address, value in lines]
    device = SimDevice(int(unit), data)
    server = ModbusUdpServer(
        device,
        address=("127.0.0.1", int(place)),
        trace_pdu=lambda sending, pdu: tell(sending=sending, pdu=pdu),
    )
    await server.serve_forever(background=True)
    print("listening", flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    _, place, unit, registers = sys.argv[1:]
    asyncio.run(serve(place, unit, Path(registers).read_text()))

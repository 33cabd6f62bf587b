"""modbus-tk as a server: `listening`, then `wrote ADDRESS VALUE` for each register written.

    python modbus_tk_server.py (tcp PORT | rtu TTY) UNIT REGISTERS

REGISTERS has lines `ADDRESS VALUE`; runs of addresses become blocks, others do not exist.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import serial
from modbus_tk import (  # type: ignore[import-untyped]
    defines,
    hooks,
    modbus_rtu,
    modbus_tcp,
)

WRITE_REGISTER = 6


def blocks(text: str) -> list[tuple[int, list[int]]]:
    found: list[tuple[int, list[int]]] = []
    for line in text.splitlines():
        address, value = map(int, line.split())
        if found and found[-1][0] + len(found[-1][1]) == address:
            found[-1][1].append(value)
        else:
            found.append((address, [value]))
    return found


def tell(arguments: tuple[object, bytes]) -> None:
    pdu = arguments[1]
    if pdu[0] == WRITE_REGISTER:
        address, value = (int.from_bytes(pdu[at : at + 2], "big") for at in (1, 3))
        print("wrote", address, value, flush=True)


def main() -> None:
    kind, place, unit, registers = sys.argv[1:]
    if kind == "tcp":
        server = modbus_tcp.TcpServer(int(place), "127.0.0.1")
    else:
        server = modbus_rtu.RtuServer(serial.Serial(place, 9600))
    hooks.install_hook("modbus.Slave.handle_request", tell)
    server.start()
    slave = server.add_slave(int(unit))
    for address, values in blocks(Path(registers).read_text()):
        name = f"from {address}"
        slave.add_block(name, defines.HOLDING_REGISTERS, address, len(values))
        slave.set_values(name, address, values)
    print("listening", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()

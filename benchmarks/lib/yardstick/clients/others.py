"""Other libraries of Python, where they are installed: pip install minimalmodbus modbus-tk ..."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import serial

from yardstick.frames import REGISTERS, UNIT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from yardstick.job import Job


class _Client:
    failures: tuple[type[Exception], ...] = (OSError, ValueError)

    def __init__(self, job: Job) -> None:
        self._job = job
        self.late_us: list[float] = []
        self._client = self._make()

    def _make(self) -> Any:
        raise NotImplementedError

    def open(self) -> None:
        """The library opens when it is made, or with the first read."""


class Minimalmodbus(_Client):
    """One request is tried once; its own silence."""

    def _make(self) -> Any:
        instrument = import_module("minimalmodbus").Instrument(self._job.port, UNIT)
        instrument.serial.baudrate = self._job.baud
        instrument.serial.timeout = self._job.timeout
        return instrument

    def read(self, address: int) -> Sequence[int]:
        registers: Sequence[int] = self._client.read_registers(address, REGISTERS, 3)
        return registers

    def close(self) -> None:
        self._client.serial.close()


class ModbusTk(_Client):
    def _make(self) -> Any:
        job = self._job
        library = import_module("modbus_tk.modbus_rtu" if job.port else "modbus_tk.modbus_tcp")
        errors = import_module("modbus_tk.exceptions")
        self.failures = (errors.ModbusError, errors.ModbusInvalidResponseError, OSError)
        if job.port:
            master = library.RtuMaster(serial.Serial(job.port, job.baud))
        else:
            master = library.TcpMaster("127.0.0.1", job.tcp_port)
        master.set_timeout(job.timeout)
        return master

    def read(self, address: int) -> Sequence[int]:
        registers: Sequence[int] = self._client.execute(UNIT, 3, address, REGISTERS)
        return registers

    def close(self) -> None:
        self._client.close()


class PyModbusTcp(_Client):
    def _make(self) -> Any:
        library = import_module("pyModbusTCP.client")
        job = self._job
        return library.ModbusClient(
            "127.0.0.1", port=job.tcp_port, unit_id=UNIT, timeout=job.timeout, auto_open=True
        )

    def read(self, address: int) -> Sequence[int]:
        registers: Sequence[int] | None = self._client.read_holding_registers(address, REGISTERS)
        if registers is None:
            raise OSError(self._client.last_error_as_txt)
        return registers

    def close(self) -> None:
        self._client.close()

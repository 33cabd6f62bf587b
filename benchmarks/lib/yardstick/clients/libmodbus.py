"""libmodbus, the C library, where the system has it."""

from __future__ import annotations

import ctypes
from ctypes.util import find_library
from typing import TYPE_CHECKING

from yardstick.frames import REGISTERS, UNIT

if TYPE_CHECKING:
    from yardstick.job import Job


def _load() -> ctypes.CDLL:
    try:
        library = ctypes.CDLL(find_library("modbus") or "libmodbus.so.5", use_errno=True)
    except OSError as error:
        raise ImportError(str(error)) from error
    library.modbus_new_rtu.restype = library.modbus_new_tcp.restype = ctypes.c_void_p
    library.modbus_new_rtu.argtypes = [
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char,
        ctypes.c_int,
        ctypes.c_int,
    ]
    library.modbus_new_tcp.argtypes = [ctypes.c_char_p, ctypes.c_int]
    library.modbus_set_slave.argtypes = [ctypes.c_void_p, ctypes.c_int]
    library.modbus_set_response_timeout.argtypes = [
        ctypes.c_void_p,
        ctypes.c_uint32,
        ctypes.c_uint32,
    ]
    library.modbus_read_registers.argtypes = [
        ctypes.c_void_p,
        ctypes.c_int,
        ctypes.c_int,
        ctypes.c_void_p,
    ]
    for name in ("modbus_connect", "modbus_close", "modbus_free"):
        getattr(library, name).argtypes = [ctypes.c_void_p]
    return library


class Libmodbus:
    failures = (OSError,)

    def __init__(self, job: Job) -> None:
        self._library = library = _load()
        self.late_us: list[float] = []
        if job.port:
            self._context = library.modbus_new_rtu(job.port.encode(), job.baud, b"N", 8, 1)
        else:
            self._context = library.modbus_new_tcp(b"127.0.0.1", job.tcp_port)
        library.modbus_set_slave(self._context, UNIT)
        seconds, rest = divmod(round(job.timeout * 1e6), 1_000_000)
        library.modbus_set_response_timeout(self._context, seconds, rest)
        self._registers = (ctypes.c_uint16 * REGISTERS)()

    def open(self) -> None:
        if self._library.modbus_connect(self._context) != 0:
            raise OSError(ctypes.get_errno(), "libmodbus did not connect")

    def read(self, address: int) -> list[int]:
        count = self._library.modbus_read_registers(
            self._context, address, REGISTERS, ctypes.byref(self._registers)
        )
        if count < 0:
            raise OSError(ctypes.get_errno(), "libmodbus")
        return self._registers[:count]

    def close(self) -> None:
        self._library.modbus_close(self._context)
        self._library.modbus_free(self._context)

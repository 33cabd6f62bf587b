"""RS-485 / RS-232 link."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING

import serial

if TYPE_CHECKING:
    from collections.abc import Callable


class SerialLink:
    """One serial port, opened exclusively."""

    def __init__(self, port: str, baudrate: int, bytesize: int, parity: str, stopbits: int) -> None:
        self.port = port
        self.baudrate = baudrate
        self._settings = {"bytesize": bytesize, "parity": parity, "stopbits": stopbits}
        self.character_bits = 1 + bytesize + (parity != "N") + stopbits
        self._serial: serial.Serial | None = None
        self._lost: Callable[[str], None] | None = None

    @property
    def name(self) -> str:
        return self.port

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        try:
            self._serial = serial.Serial(
                self.port, self.baudrate, timeout=0, exclusive=True, **self._settings
            )
        except ValueError as error:  # a setting that this port cannot take
            raise OSError(str(error)) from error
        self._serial.reset_input_buffer()
        self._lost = lost
        fd = self._serial.fileno()
        asyncio.get_running_loop().add_reader(fd, self._readable, fd, receive)

    def send(self, octets: bytes) -> None:
        if self._serial is None:
            raise OSError("the port is closed")
        written = os.write(self._serial.fileno(), octets)
        if written != len(octets):
            raise OSError(f"the port took {written} of {len(octets)} octets")

    def close(self) -> None:
        if self._serial is not None:
            port, self._serial = self._serial, None
            asyncio.get_running_loop().remove_reader(port.fileno())
            port.close()

    def _readable(self, fd: int, receive: Callable[[bytes], None]) -> None:
        try:
            octets = os.read(fd, 4096)
        except BlockingIOError:
            return
        except OSError as error:
            self._gone(error.strerror or str(error))
            return
        if octets:
            receive(octets)
        else:
            self._gone("the port is gone")

    def _gone(self, reason: str) -> None:
        self.close()
        if self._lost is not None:
            self._lost(reason)

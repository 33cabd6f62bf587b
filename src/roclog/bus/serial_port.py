"""RS-485 / RS-232 link."""

from __future__ import annotations

import asyncio
import errno
import os
import termios
from contextlib import suppress
from typing import TYPE_CHECKING

import serial

if TYPE_CHECKING:
    from collections.abc import Callable


class SerialLink:
    """One serial port, opened exclusively, by its path anew each time: a link may move on."""

    def __init__(self, port: str, baudrate: int, bytesize: int, parity: str, stopbits: int) -> None:
        self.port = port
        self.baudrate = baudrate
        self.bytesize = bytesize
        self.parity = parity
        self.stopbits = stopbits
        self.character_bits = 1 + bytesize + (parity != "N") + stopbits
        self._serial: serial.Serial | None = None
        self._lost: Callable[[str], None] | None = None

    @property
    def name(self) -> str:
        return self.port

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self.close()
        self._serial = self._open_port()
        self._lost = lost
        fd = self._serial.fileno()
        try:
            asyncio.get_running_loop().add_reader(fd, self._readable, fd, receive)
        except BaseException:
            self.close()
            raise

    def send(self, octets: bytes) -> None:
        if self._serial is None:
            raise OSError("the port is closed")
        written = os.write(self._serial.fileno(), octets)
        if written != len(octets):
            raise OSError(f"the port took {written} of {len(octets)} octets")

    def close(self) -> None:
        if self._serial is None:
            return
        port, self._serial = self._serial, None
        asyncio.get_running_loop().remove_reader(port.fileno())
        with suppress(OSError, termios.error):  # else closing waits until a stuck port has sent
            port.reset_output_buffer()
        with suppress(OSError):  # the device behind it may be gone
            port.close()

    def _open_port(self) -> serial.Serial:
        """Open, set up and empty the port; every failure becomes a plain OSError."""
        try:
            return serial.Serial(
                self.port,
                self.baudrate,
                bytesize=self.bytesize,
                parity=self.parity,
                stopbits=self.stopbits,
                timeout=0,
                exclusive=True,
            )
        except ValueError as error:  # a setting that this port cannot take
            raise OSError(str(error)) from error
        except termios.error as error:
            raise OSError(*error.args) from error
        except serial.SerialException as error:
            if error.errno == errno.EWOULDBLOCK:
                raise OSError(error.errno, "another program has it open") from error
            if error.errno is not None:
                raise OSError(error.errno, os.strerror(error.errno)) from error
            raise

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

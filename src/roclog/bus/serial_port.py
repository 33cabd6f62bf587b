"""RS-485 / RS-232 link."""

from __future__ import annotations

import asyncio
import errno
import os
import termios
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import serial

from roclog.bus import serial_driver
from roclog.bus.link import Link

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from roclog.bus.link import LineErrors
    from roclog.bus.serial_driver import Rs485

_TAKEN: Final = "another program has it open"


class SerialLink(Link):
    """One serial port, opened exclusively, by its path anew each time: a link may move on.

    low_latency: ask the driver to hand octets over as they come.
    rs485: direction control by the driver, without which the port does not open; None: as it is.
    tty_class: where the system describes its ports.
    """

    def __init__(
        self,
        port: str,
        baudrate: int,
        bytesize: int,
        parity: str,
        stopbits: int,
        *,
        low_latency: bool = False,
        rs485: Rs485 | None = None,
        tty_class: Path = serial_driver.TTY_CLASS,
    ) -> None:
        self.port = port
        self.baudrate = baudrate
        self.bytesize = bytesize
        self.parity = parity
        self.stopbits = stopbits
        self.low_latency = low_latency
        self.rs485 = rs485
        self.character_bits = 1 + bytesize + (parity != "N") + stopbits
        self._tty_class = tty_class
        self._facts: dict[str, str] = {}
        self._errors = serial_driver.ErrorCounter()
        self._serial: serial.Serial | None = None
        self._lost: Callable[[str], None] | None = None

    @property
    def name(self) -> str:
        return self.port

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self.close()
        self._facts = {}
        self._serial = self._open_port()
        self._lost = lost
        fd = self._serial.fileno()
        try:
            self._set_up(fd)
            asyncio.get_running_loop().add_reader(fd, self._readable, fd, receive)
        except termios.error as error:
            self.close()
            raise OSError(*error.args) from error
        except BaseException:
            self.close()
            raise

    def send(self, octets: bytes) -> None:
        if self._serial is None:
            raise OSError("the port is closed")
        try:
            written = os.write(self._serial.fileno(), octets)
        except BlockingIOError:
            written = 0
        if written != len(octets):
            raise OSError(f"the port took {written} of {len(octets)} octets")

    def close(self) -> None:
        if self._serial is None:
            return
        port, self._serial = self._serial, None
        self._errors.read(port.fileno())
        asyncio.get_running_loop().remove_reader(port.fileno())
        with suppress(OSError, termios.error):  # else closing waits until a stuck port has sent
            port.reset_output_buffer()
        with suppress(OSError):  # the device behind it may be gone
            serial_driver.give_back(port.fileno())
        with suppress(OSError):
            port.close()

    def describe(self) -> Mapping[str, str]:
        """device, driver, low_latency, latency_timer, rs485, warning: those that are known."""
        return self._facts

    def line_errors(self) -> LineErrors | None:
        return self._errors.read(None if self._serial is None else self._serial.fileno())

    def _open_port(self) -> serial.Serial:
        """Open, set up and empty the port; every failure becomes a plain OSError."""
        first = self._look_at_port()
        try:
            port = serial.Serial(
                None,
                self.baudrate,
                bytesize=self.bytesize,
                parity=self.parity,
                stopbits=self.stopbits,
                timeout=0,
                exclusive=True,
            )
            port.port = self.port
            if self.rs485 is not None:  # else RTS would hold the line until the driver knows
                port.rts = self.rs485.rts_after_send
            port.open()
        except ValueError as error:  # a setting that this port cannot take
            raise OSError(str(error)) from error
        except termios.error as error:
            raise OSError(*error.args) from error
        except serial.SerialException as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EBUSY):
                raise OSError(error.errno, _TAKEN) from error
            if error.errno is not None:
                raise OSError(error.errno, os.strerror(error.errno)) from error
            raise
        else:
            return port
        finally:
            os.close(first)

    def _look_at_port(self) -> int:
        """A descriptor of a port that is free, before anything is changed at it."""
        try:
            fd = os.open(self.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            text = _TAKEN if error.errno == errno.EBUSY else error.strerror
            raise OSError(error.errno, text) from error
        if not os.isatty(fd):
            reason = OSError(errno.ENOTTY, "is not a serial port")
        elif serial_driver.is_taken(fd):
            reason = OSError(errno.EBUSY, _TAKEN)
        else:
            return fd
        os.close(fd)
        raise reason

    def _set_up(self, fd: int) -> None:
        """What pyserial leaves open, and what the adapter is like."""
        self._errors.begin(fd)
        serial_driver.take(fd)
        serial_driver.reject_damaged_characters(fd, self.parity)
        facts = self._facts = serial_driver.adapter(self.port, self._tty_class)
        if self.rs485 is not None:
            serial_driver.set_direction_control(fd, self.rs485)
            facts["rs485"] = "set"
        if self.low_latency:
            facts["low_latency"] = serial_driver.ask_low_latency(fd)
        timer, path = serial_driver.latency_timer(facts["device"], self._tty_class)
        if timer is not None:
            facts["latency_timer"] = f"{timer} ms"
        warning = "; ".join(self._doubts(fd, timer, path))
        if warning:
            facts["warning"] = warning

    def _doubts(self, fd: int, timer: int | None, path: Path) -> Iterator[str]:
        if not serial_driver.has_format(fd, self.parity, self.stopbits):
            yield f"the driver did not take parity {self.parity}, stop bits {self.stopbits}"
        if timer is not None and timer > 1 and self.low_latency:
            yield (
                f"the adapter may keep octets for {timer} ms, its latency timer: "
                f"write 1 to {path} or add a udev rule that does"
            )

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

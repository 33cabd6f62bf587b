"""What a Linux serial driver tells and takes beyond termios.

Numbers and layouts are those of <linux/serial.h>, <linux/tty_flags.h> and <asm-generic/ioctls.h>.
Other systems have no such calls.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import sys
import termios
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from roclog.bus.link import LineErrors

LINUX: Final = sys.platform == "linux"
TTY_CLASS: Final = Path("/sys/class/tty")

_TIOCGRS485: Final = 0x542E
_TIOCSRS485: Final = 0x542F
_TIOCGEXCL: Final = 0x80045440
"""Not in termios, which has the others."""
_SERIAL_STRUCT: Final = 72
"""Octets of it where a long has 64 bits; it is shorter elsewhere, which does no harm."""
_FLAGS: Final = struct.Struct("=i")
_FLAGS_OFFSET: Final = 16
_ASYNC_LOW_LATENCY: Final = 0x2000
_RS485: Final = struct.Struct("=3I20x")
_RS485_ENABLED: Final = 1 << 0
_RS485_RTS_ON_SEND: Final = 1 << 1
_RS485_RTS_AFTER_SEND: Final = 1 << 2
_RS485_DIRECTION: Final = _RS485_ENABLED | _RS485_RTS_ON_SEND | _RS485_RTS_AFTER_SEND
_COUNTS: Final = struct.Struct("=24x5I36x")
"""frame, overrun, parity, brk, buf_overrun."""
_COUNT_MASK: Final = 0xFFFF_FFFF
_WITHOUT: Final = "leave the key out for an adapter that switches by itself"
_PSEUDO_TERMINALS: Final = range(136, 144)
"""Major numbers, from the kernel's admin-guide/devices.txt."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rs485:
    """How RTS switches the driver of the line. Delays in milliseconds, from and to RTS."""

    rts_on_send: bool = True
    rts_after_send: bool = False
    delay_before_send: int = 0
    delay_after_send: int = 0


def ask_low_latency(fd: int) -> str:
    """Have octets handed over as they come, where the driver can; what came of it, for people."""
    if not LINUX:
        return "only on Linux"
    try:
        settings = bytearray(fcntl.ioctl(fd, termios.TIOCGSERIAL, bytes(_SERIAL_STRUCT)))
        (flags,) = _FLAGS.unpack_from(settings, _FLAGS_OFFSET)
        if flags & _ASYNC_LOW_LATENCY:
            return "set before"
        _FLAGS.pack_into(settings, _FLAGS_OFFSET, flags | _ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, termios.TIOCSSERIAL, bytes(settings))
        taken = fcntl.ioctl(fd, termios.TIOCGSERIAL, bytes(_SERIAL_STRUCT))
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL):
            return "not known to the driver"
        return f"refused: {error.strerror}"
    (flags,) = _FLAGS.unpack_from(taken, _FLAGS_OFFSET)
    return "set" if flags & _ASYNC_LOW_LATENCY else "ignored by the driver"


def set_direction_control(fd: int, wanted: Rs485) -> None:
    """Raises OSError where the driver cannot, or takes anything else: nobody would be heard."""
    if not LINUX:
        raise OSError(errno.ENOTSUP, f"rs485: only on Linux; {_WITHOUT}")
    flags = _RS485_ENABLED
    flags |= _RS485_RTS_ON_SEND if wanted.rts_on_send else 0
    flags |= _RS485_RTS_AFTER_SEND if wanted.rts_after_send else 0
    delays = wanted.delay_before_send, wanted.delay_after_send
    try:
        state = bytearray(fcntl.ioctl(fd, _TIOCGRS485, bytes(_RS485.size)))
        (others,) = struct.unpack_from("=I", state)
        struct.pack_into("=3I", state, 0, others & ~_RS485_DIRECTION | flags, *delays)
        fcntl.ioctl(fd, _TIOCSRS485, bytes(state))
        taken, *taken_delays = _RS485.unpack(fcntl.ioctl(fd, _TIOCGRS485, bytes(_RS485.size)))
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL):
            text = f"rs485: the driver of this port has no direction control; {_WITHOUT}"
        else:
            text = f"rs485: the driver refused it: {error.strerror}"
        raise OSError(error.errno, text) from error
    if (taken & _RS485_DIRECTION, *taken_delays) != (flags, *delays):
        made = _shown(taken, *taken_delays)
        raise OSError(errno.EINVAL, f"rs485: the driver made {made} of {_shown(flags, *delays)}")


def _shown(flags: int, before: int, after: int) -> str:
    levels = [
        f"{name} = {'true' if flags & bit else 'false'}"
        for name, bit in (
            ("rts_on_send", _RS485_RTS_ON_SEND),
            ("rts_after_send", _RS485_RTS_AFTER_SEND),
        )
    ]
    delays = [f'delay_before_send = "{before}ms"', f'delay_after_send = "{after}ms"']
    return f"{{ {', '.join(levels + delays)} }}" if flags & _RS485_ENABLED else "nothing"


class ErrorCounter:
    """Errors of all the time in which a port was open. The driver counts since it was loaded."""

    def __init__(self) -> None:
        self._total = LineErrors()
        self._last: tuple[int, ...] | None = None

    def begin(self, fd: int) -> None:
        """The port was opened: what was counted before is none of ours."""
        self._last = _counts(fd)

    def read(self, fd: int | None) -> LineErrors | None:
        """None: this driver does not count. Without a descriptor: what was known last."""
        if self._last is None:
            return None
        now = None if fd is None else _counts(fd)
        if now is not None:
            frame, overrun, parity, breaks, full = (
                (new - old) & _COUNT_MASK for new, old in zip(now, self._last, strict=True)
            )
            self._last = now
            self._total = LineErrors(
                frame=self._total.frame + frame,
                parity=self._total.parity + parity,
                overrun=self._total.overrun + overrun + full,
                breaks=self._total.breaks + breaks,
            )
        return self._total


def _counts(fd: int) -> tuple[int, ...] | None:
    if not LINUX:
        return None
    try:
        return _COUNTS.unpack(fcntl.ioctl(fd, termios.TIOCGICOUNT, bytes(_COUNTS.size)))
    except OSError:
        return None


def is_taken(fd: int) -> bool:
    """Whether a program has the port for itself. Root could open it all the same."""
    if not LINUX:
        return False
    try:
        return fcntl.ioctl(fd, _TIOCGEXCL, bytes(4)) != bytes(4)
    except OSError:  # not a terminal, or an old kernel
        return False


def take(fd: int) -> None:
    """Keep others from opening the port, also those that look for no lock.

    Not a pseudo-terminal: its other side keeps it alive, and so the mark of a program that died.
    """
    if LINUX and os.major(os.fstat(fd).st_rdev) not in _PSEUDO_TERMINALS:
        fcntl.ioctl(fd, termios.TIOCEXCL)


def give_back(fd: int) -> None:
    if LINUX and os.major(os.fstat(fd).st_rdev) not in _PSEUDO_TERMINALS:
        fcntl.ioctl(fd, termios.TIOCNXCL)


def reject_damaged_characters(fd: int, parity: str) -> None:
    """Have a character with wrong parity or stop bit read as 0, so that the checksum rejects it.

    Without parity it stays as it came and the checksum alone decides: a device that lets go of the
    line a little early spoils its last stop bit, not its answer. A break reads as 0. The port is
    one that pyserial opened, which clears INPCK.
    """
    attributes = termios.tcgetattr(fd)
    attributes[0] &= ~(termios.IGNPAR | termios.PARMRK | termios.IGNBRK | termios.BRKINT)
    if parity != "N":
        attributes[0] |= termios.INPCK
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def has_format(fd: int, parity: str, stopbits: int) -> bool:
    """Whether the driver took both; it need not say so when it is told."""
    control = termios.tcgetattr(fd)[2]
    found = control & (termios.PARENB | termios.PARODD | termios.CSTOPB)
    wanted = termios.PARENB if parity != "N" else 0
    wanted |= termios.PARODD if parity == "O" else 0
    wanted |= termios.CSTOPB if stopbits == 2 else 0
    return bool(found == wanted)


def adapter(path: str, tty_class: Path = TTY_CLASS) -> dict[str, str]:
    """What the system knows: the device that a link stands for, its driver."""
    device = os.path.realpath(path)
    facts = {"device": device}
    driver = tty_class / Path(device).name / "device" / "driver"
    if driver.is_symlink():
        facts["driver"] = driver.readlink().name
    return facts


def latency_timer(device: str, tty_class: Path = TTY_CLASS) -> tuple[int | None, Path]:
    """Milliseconds that the adapter may keep octets, where its driver says so, and where."""
    path = tty_class / Path(device).name / "device" / "latency_timer"
    try:
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return None, path
    return int(text) if text.isdecimal() else None, path

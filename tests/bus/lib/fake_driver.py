"""A serial driver behind ``fcntl.ioctl``: answers what a pseudo-terminal cannot.

Sizes, offsets and numbers are what gcc 12 prints on x86_64 for <linux/serial.h> and
<linux/tty_flags.h> of linux-libc-dev 6.1, written here as plain figures:

struct serial_struct: 72 octets; flags at 16 (4), xmit_fifo_size at 20, closing_wait at 40 (2),
    iomem_base at 48 (8), iomap_base at 64 (8)
struct serial_rs485: 32 octets; flags at 0, delay_rts_before_send at 4, delay_rts_after_send at 8
struct serial_icounter_struct: 80 octets; rx at 16, frame at 24, overrun at 28, parity at 32,
    brk at 36, buf_overrun at 40
TIOCGSERIAL 0x541e, TIOCSSERIAL 0x541f, TIOCGRS485 0x542e, TIOCSRS485 0x542f, TIOCGICOUNT 0x545d
TIOCMBIS 0x5416 raises and TIOCMBIC 0x5417 lowers: TIOCM_DTR 0x002, TIOCM_RTS 0x004
"""

from __future__ import annotations

import errno
import fcntl
import os
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

TIOCGSERIAL: Final = 0x541E
TIOCSSERIAL: Final = 0x541F
TIOCGRS485: Final = 0x542E
TIOCSRS485: Final = 0x542F
TIOCGICOUNT: Final = 0x545D
TIOCMBIS: Final = 0x5416
TIOCMBIC: Final = 0x5417
SIZES: Final = {
    TIOCGSERIAL: 72,
    TIOCSSERIAL: 72,
    TIOCGRS485: 32,
    TIOCSRS485: 32,
    TIOCGICOUNT: 80,
}
COUNT_OFFSETS: Final = {
    "rx": 16,
    "frame": 24,
    "overrun": 28,
    "parity": 32,
    "brk": 36,
    "buf_overrun": 40,
}


class FakeDriver:
    """serial, rs485, counts: the kernel's structs. Their first content has no two octets alike.

    refuses: errno of a request instead of an answer.
    rts: levels in the order in which they were set.
    on_set: called after a struct was set; changes it as a driver may.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.serial = bytearray(range(100, 172))
        self.rs485 = bytearray(12) + bytearray(range(50, 70))
        self.counts = bytearray(range(150, 230))
        self.refuses: dict[int, int] = {}
        self.on_set: Callable[[], None] = lambda: None
        self.asked: list[int] = []
        self.rts: list[bool] = []
        self._true = fcntl.ioctl
        monkeypatch.setattr(fcntl, "ioctl", self._ioctl)

    def count(self, **values: int) -> None:
        for name, value in values.items():
            offset = COUNT_OFFSETS[name]
            self.counts[offset : offset + 4] = value.to_bytes(4, "little")

    def _ioctl(self, fd: int, request: int, argument: object = 0, *rest: object) -> object:
        if request in (TIOCMBIS, TIOCMBIC):
            if argument == bytes.fromhex("04 00 00 00"):
                self.rts.append(request == TIOCMBIS)
            return argument
        if request not in SIZES:
            return self._true(fd, request, argument, *rest)  # type: ignore[call-overload]
        assert isinstance(argument, bytes)
        assert len(argument) == SIZES[request]
        assert os.isatty(fd)
        self.asked.append(request)
        if request in self.refuses:
            raise OSError(self.refuses[request], os.strerror(self.refuses[request]))
        struct = {TIOCGICOUNT: self.counts, TIOCGRS485: self.rs485, TIOCSRS485: self.rs485}.get(
            request, self.serial
        )
        if request in (TIOCSSERIAL, TIOCSRS485):
            struct[:] = argument
            self.on_set()
        return bytes(struct)


NOT_THERE: Final = dict.fromkeys(SIZES, errno.ENOTTY)

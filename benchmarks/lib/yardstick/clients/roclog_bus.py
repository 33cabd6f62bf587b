"""roclog's bus, as a recording uses it: connection, bus, transaction, words."""

from __future__ import annotations

import math
import time
from functools import cache
from typing import TYPE_CHECKING, Any, cast

from roclog.bus.tally import Tally
from roclog.clock import SystemClock
from roclog.config.settings import Connection
from roclog.connect import make_bus
from roclog.errors import DeviceError
from roclog.modbus.request import ReadRegisters, words
from yardstick.frames import REGISTERS, UNIT

if TYPE_CHECKING:
    from collections.abc import Callable

    from roclog.bus.link import Link
    from yardstick.job import Job

_SECOND = 10**9


@cache
def _request(address: int) -> ReadRegisters:
    return ReadRegisters(3, address, REGISTERS)


class RoclogClient:
    failures = (DeviceError,)

    def __init__(self, job: Job) -> None:
        connection = _serial(job) if job.port else _tcp(job)
        self._bus = make_bus(connection, [], SystemClock())
        self._tally = Tally()
        self.late_us: list[float] = []
        if job.port:
            link = TimedLink(self._bus.link, connection.silence, self.late_us)
            self._bus.link = cast("Link", link)

    async def open(self) -> None:
        """The first read opens."""

    async def read(self, address: int) -> tuple[int, ...]:
        answer = await self._bus.transact(UNIT, _request(address), self._tally)
        return words(answer.pdu)

    def close(self) -> None:
        self._bus.close()


class TimedLink:
    """A link that notes how long after the silence each request was handed over."""

    def __init__(self, link: Link, silence: int, late_us: list[float]) -> None:
        self._link = link
        self._silence = silence
        self._late_us = late_us
        self._heard = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        def note(octets: bytes) -> None:
            self._heard = time.monotonic_ns()
            receive(octets)

        await self._link.open(note, lost)

    def send(self, octets: bytes) -> None:
        if self._heard:
            self._late_us.append((time.monotonic_ns() - self._heard - self._silence) / 1e3)
        self._link.send(octets)


def _serial(job: Job) -> Connection:
    return Connection(
        name="line",
        transport="rtu",
        port=job.port,
        host="",
        baudrate=job.baud,
        bytesize=8,
        parity="N",
        stopbits=1,
        timeout=round(job.timeout * _SECOND),
        late_answer=round(job.late_answer * _SECOND),
        silence=math.ceil(job.silence * _SECOND),
        character=math.ceil(10 * _SECOND / job.baud),
    )


def _tcp(job: Job) -> Connection:
    return Connection(
        name="plant",
        transport="tcp",
        port=job.tcp_port,
        host="127.0.0.1",
        baudrate=0,
        bytesize=0,
        parity="",
        stopbits=0,
        timeout=round(job.timeout * _SECOND),
        late_answer=None,
        silence=0,
        character=0,
    )

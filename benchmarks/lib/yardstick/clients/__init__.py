"""The clients, each behind the same two or three calls. A library is imported when it is made."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from yardstick.job import Job


class AsyncClient(Protocol):
    """failures: what a read may raise. late_us: as of Outcome."""

    failures: tuple[type[Exception], ...]
    late_us: list[float]

    async def open(self) -> None: ...

    async def read(self, address: int) -> Sequence[int]: ...

    def close(self) -> None: ...


class BlockingClient(Protocol):
    failures: tuple[type[Exception], ...]
    late_us: list[float]

    def open(self) -> None: ...

    def read(self, address: int) -> Sequence[int]: ...

    def close(self) -> None: ...


def _made_by(module: str, name: str) -> Callable[[Job], Any]:
    def make(job: Job) -> Any:
        return getattr(import_module(f"yardstick.clients.{module}"), name)(job)

    return make


ASYNC: Final[Mapping[str, Callable[[Job], AsyncClient]]] = {
    "roclog": _made_by("roclog_bus", "RoclogClient"),
    "pymodbus": _made_by("pymodbus_async", "PymodbusClient"),
    "raw asyncio": _made_by("raw_asyncio", "RawAsyncio"),
}
BLOCKING: Final[Mapping[str, Callable[[Job], BlockingClient]]] = {
    "raw serial": _made_by("raw_serial", "DroppingLate"),
    "raw serial, late kept": _made_by("raw_serial", "KeepingLate"),
    "minimalmodbus": _made_by("others", "Minimalmodbus"),
    "modbus-tk": _made_by("others", "ModbusTk"),
    "pyModbusTCP": _made_by("others", "PyModbusTcp"),
    "libmodbus": _made_by("libmodbus", "Libmodbus"),
}

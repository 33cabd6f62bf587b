"""The devices of a recording, as roclog is told of them; each has its own address in 127/8."""

from __future__ import annotations

from decimal import Decimal
from typing import TYPE_CHECKING, Final

from roclog.config.settings import Connection, Device, RecordingSettings, Settings
from roclog.register_map import (
    Block,
    Point,
    RegisterMap,
    SerialDefaults,
    Table,
    WordOrder,
    WordType,
)
from yardstick.frames import REGISTERS, UNIT

if TYPE_CHECKING:
    from pathlib import Path

FIRST_REGISTER: Final = 300
BLOCK: Final = "values"
_SECOND: Final = 10**9

REGISTER_MAP: Final = RegisterMap(
    name="benchmark",
    title="27 registers on schedule",
    source="made up for this measurement",
    unit=UNIT,
    serial=SerialDefaults(baudrate=9600),
    answer_limit=_SECOND,
    samples=(
        Block(
            name=BLOCK,
            table=Table.HOLDING_REGISTERS,
            address=FIRST_REGISTER,
            count=REGISTERS,
            points=(
                Point(name="count", offset=0, type=WordType.U32),
                *(
                    Point(
                        name=f"value_{offset}",
                        offset=offset,
                        type=WordType.S16,
                        scale=Decimal("0.1"),
                    )
                    for offset in range(2, REGISTERS)
                ),
            ),
        ),
    ),
)


def addresses(count: int) -> list[str]:
    """IPv4 addresses of that many devices."""
    return [f"127.1.{number // 250}.{number % 250 + 1}" for number in range(count)]


def settings(folder: Path, port: int, count: int, period: int) -> Settings:
    """A configuration: one TCP connection for each device, polled each ``period`` nanoseconds."""
    hosts = addresses(count)
    return Settings(
        path=folder / "benchmark.toml",
        recording=RecordingSettings(
            directory=folder / "recordings",
            segment_duration=3600 * _SECOND,
            segment_size=64 << 20,
        ),
        connections={f"c{n}": _connection(f"c{n}", host, port) for n, host in enumerate(hosts)},
        devices={
            f"d{n}": Device(
                name=f"d{n}",
                profile=REGISTER_MAP,
                connection=f"c{n}",
                unit=UNIT,
                poll=period,
                word_order=WordOrder.ABCD,
                acknowledge=False,
                cycle=None,
            )
            for n in range(count)
        },
    )


def _connection(name: str, host: str, port: int) -> Connection:
    return Connection(
        name=name,
        transport="tcp",
        port=port,
        host=host,
        baudrate=0,
        bytesize=0,
        parity="",
        stopbits=0,
        timeout=_SECOND,
        late_answer=None,
        silence=0,
        character=0,
    )

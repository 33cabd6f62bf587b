"""From a configured connection to the bus that serves it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.bus.bus import Bus
from roclog.bus.serial_driver import Rs485
from roclog.bus.serial_port import SerialLink
from roclog.bus.tcp import TcpLink
from roclog.bus.timing import Framing, Timing
from roclog.bus.udp import UdpLink
from roclog.register_map import FlagAndClear

if TYPE_CHECKING:
    from roclog.bus.link import Link
    from roclog.clock import Clock
    from roclog.config.settings import Connection, Device, Transport

_FRAMINGS: Final[dict[Transport, Framing]] = {
    "rtu": Framing.RTU,
    "rtu-over-tcp": Framing.RTU,
    "tcp": Framing.MBAP_STREAM,
    "udp": Framing.MBAP_DATAGRAM,
}


def make_bus(
    connection: Connection,
    devices: list[Device],
    clock: Clock,
    asked_for: frozenset[tuple[int, int, int]] = frozenset(),
) -> Bus:
    """The bus of a connection; only the acknowledgements of its devices may be written.

    asked_for: writes besides, as (unit, address, value), that a person has seen and agreed to.
    """
    timing = Timing(
        framing=_FRAMINGS[connection.transport],
        timeout=connection.timeout,
        late_answer=connection.late_answer or 0,
        silence=connection.silence,
        character=connection.character,
        dialect=connection.dialect,
    )
    permitted = frozenset(
        (device.unit, block.address + block.trigger.flag, block.trigger.clear)
        for device in devices
        if device.acknowledge
        for block in device.profile.samples
        if isinstance(block.trigger, FlagAndClear)
    )
    return Bus(_make_link(connection), timing, clock, permitted | asked_for, len(devices))


def _make_link(connection: Connection) -> Link:
    if connection.transport == "rtu":
        return SerialLink(
            str(connection.port),
            connection.baudrate,
            connection.bytesize,
            connection.parity,
            connection.stopbits,
            low_latency=connection.low_latency,
            rs485=_direction_control(connection),
        )
    kind = UdpLink if connection.transport == "udp" else TcpLink
    return kind(connection.host, int(connection.port))


def _direction_control(connection: Connection) -> Rs485 | None:
    """As drivers take it: in milliseconds."""
    wanted = connection.rs485
    if wanted is None:
        return None
    return Rs485(
        rts_on_send=wanted.rts_on_send,
        rts_after_send=wanted.rts_after_send,
        delay_before_send=wanted.delay_before_send // 10**6,
        delay_after_send=wanted.delay_after_send // 10**6,
    )

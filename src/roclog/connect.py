"""From a configured connection to the bus that serves it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roclog.bus.bus import Bus, Timing
from roclog.bus.serial_port import SerialLink
from roclog.bus.tcp import TcpLink

if TYPE_CHECKING:
    from roclog.bus.link import Link
    from roclog.clock import Clock
    from roclog.config.settings import Connection, Device


def make_bus(connection: Connection, devices: list[Device], clock: Clock) -> Bus:
    """The bus of a connection; only the acknowledgements of its devices may be written."""
    link: Link
    if connection.transport == "rtu":
        link = SerialLink(
            str(connection.port),
            connection.baudrate,
            connection.bytesize,
            connection.parity,
            connection.stopbits,
        )
    else:
        link = TcpLink(connection.host, int(connection.port))
    timing = Timing(
        timeout=connection.timeout,
        late_answer=connection.late_answer,
        silence=connection.silence,
        character=connection.character,
    )
    permitted = frozenset(
        (device.unit, block.address + block.trigger.flag, block.trigger.clear)
        for device in devices
        if device.acknowledge
        for block in device.profile.samples
        if block.trigger is not None
    )
    return Bus(link, timing, clock, permitted, len(devices))

"""What a valid configuration says, with every default filled in. Durations are nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from roclog.modbus.dialect import STANDARD, Dialect

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from roclog.register_map import RegisterMap, WordOrder

Transport = Literal["rtu", "tcp", "udp", "rtu-over-tcp"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSettings:
    """Where segments go and when one ends.

    directory: absolute; need not exist yet. segment_size, keep_size: octets.
    keep_age, keep_size: None keeps everything.
    """

    directory: Path
    segment_duration: int
    segment_size: int
    keep_age: int | None = None
    keep_size: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionControl:
    """How RTS switches an RS-485 driver: its level then, and how long before and after a frame.

    Delays are whole milliseconds, since drivers take those.
    """

    rts_on_send: bool
    rts_after_send: bool
    delay_before_send: int
    delay_after_send: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Connection:
    """A serial line, a Modbus TCP or UDP server, or a gateway that passes RTU frames through.

    port: path of the serial port, or port number.
    host: empty with rtu.
    baudrate: of the line, also behind a gateway; 0 with tcp and udp.
    bytesize, parity, stopbits: of the serial port; 0 or empty except with rtu.
    timeout: for an answer to begin and end, from the end of the request.
    late_answer: from the start of a request until its answer can no longer come; None where answers
    are numbered: with tcp and udp.
    silence: before every frame. character: duration of one on the wire. Both 0 with tcp and udp.
    low_latency: have the driver of the serial port hand octets over as they come.
    rs485: None leaves the port as it is.
    dialect: of the devices there.
    """

    name: str
    transport: Transport
    port: str | int
    host: str
    baudrate: int
    bytesize: int
    parity: str
    stopbits: int
    timeout: int
    late_answer: int | None
    silence: int
    character: int
    low_latency: bool = False
    rs485: DirectionControl | None = None
    dialect: Dialect = STANDARD

    @property
    def is_serial(self) -> bool:
        """RTU frames on a line, here or behind a gateway."""
        return self.transport in ("rtu", "rtu-over-tcp")

    @property
    def place(self) -> str:
        """Serial port or host:port, for people."""
        if self.transport == "rtu":
            return str(self.port)
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A device on a connection. cycle: time between samples; None = what the device says."""

    name: str
    profile: RegisterMap
    connection: str
    unit: int
    poll: int
    word_order: WordOrder
    acknowledge: bool
    cycle: int | None

    @property
    def clears(self) -> bool:
        """Whether roclog writes to the device: it may acknowledge, and its profile has a flag."""
        return self.acknowledge and self.profile.flagged is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """A configuration. path: the file, absolute. Mappings are in the order of the file."""

    path: Path
    recording: RecordingSettings
    connections: Mapping[str, Connection]
    devices: Mapping[str, Device]

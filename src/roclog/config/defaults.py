"""One table of the file to one object of the settings, with what the file leaves open filled in."""

from __future__ import annotations

import math
import os
from decimal import Decimal
from typing import TYPE_CHECKING, Final, TypeVar

from msgspec import UNSET, UnsetType

from roclog.config.leaves import Silence
from roclog.config.settings import Connection, Device, DirectionControl, RecordingSettings
from roclog.config.tables import (
    Keep,
    Recording,
    Rs485,
    Rtu,
    RtuOverTcp,
    Segment,
    Tcp,
    Udp,
)
from roclog.modbus.dialect import STANDARD
from roclog.register_map import MODBUS_PORT, RegisterMap, SerialDefaults, WordOrder

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from roclog.config.profiles.device_table import DeviceTable

    Value = TypeVar("Value")

_SECOND: Final = 10**9
_ANSWER_LIMIT: Final = 500_000_000
_UNUSED_LINE: Final = SerialDefaults(baudrate=9600)
"""On a connection that no device uses."""
LEAST_SILENCE: Final = Silence(characters=Decimal("3.5"))
_FIXED_SILENCE: Final = 1_750_000
_FIXED_SILENCE_ABOVE: Final = 19_200
"""Modbus over Serial Line V1.02, section 2.5.1.1: characters; nanoseconds above this baud rate."""


def _given(value: Value | UnsetType, default: Value) -> Value:
    return default if isinstance(value, UnsetType) else value


def _optional(value: Value | UnsetType) -> Value | None:
    return None if isinstance(value, UnsetType) else value


def recording_settings(table: Recording, base: Path) -> RecordingSettings:
    """base: the directory of the configuration."""
    segment = _given(table.segment, Segment())
    keep = _given(table.keep, Keep())
    return RecordingSettings(
        directory=base / _given(table.directory, "recordings"),
        segment_duration=_given(segment.duration, 3600 * _SECOND),
        segment_size=_given(segment.size, 64 << 20),
        keep_age=_optional(keep.age),
        keep_size=_optional(keep.size),
    )


def serial_line(
    name: str, table: Rtu, profiles: Sequence[RegisterMap], base: Path
) -> Connection | None:
    """The connection of devices with these profiles; None where the port is not known."""
    if isinstance(table.port, UnsetType):
        return None
    wanted = [profile.serial for profile in profiles] or [_UNUSED_LINE]
    baudrate = _given(table.baudrate, wanted[0].baudrate)
    bytesize = _given(table.bytesize, wanted[0].bytesize)
    parity = _given(table.parity, wanted[0].parity)
    stopbits = _given(table.stopbits, wanted[0].stopbits)
    bits = 1 + bytesize + (parity != "N") + stopbits
    character = math.ceil(bits * _SECOND / baudrate)
    timeout = _serial_timeout(table, profiles)
    return Connection(
        name=name,
        transport="rtu",
        port=str(base / table.port) if os.name == "posix" else table.port,
        host="",
        baudrate=baudrate,
        bytesize=bytesize,
        parity=parity,
        stopbits=stopbits,
        timeout=timeout,
        late_answer=_given(table.late_answer, 2 * timeout),
        silence=_silence(table, wanted, baudrate, character),
        character=character,
        low_latency=_given(table.low_latency, default=True),
        rs485=None if isinstance(table.rs485, UnsetType) else direction_control(table.rs485),
    )


def direction_control(table: Rs485) -> DirectionControl:
    return DirectionControl(
        rts_on_send=_given(table.rts_on_send, default=True),
        rts_after_send=_given(table.rts_after_send, default=False),
        delay_before_send=_given(table.delay_before_send, 0),
        delay_after_send=_given(table.delay_after_send, 0),
    )


def gateway(name: str, table: RtuOverTcp, profiles: Sequence[RegisterMap]) -> Connection | None:
    """As serial_line; characters are as long as those of the devices, at the given baud rate."""
    if isinstance(table.host, UnsetType) or isinstance(table.port, UnsetType):
        return None
    wanted = [profile.serial for profile in profiles] or [_UNUSED_LINE]
    baudrate = _given(table.baudrate, wanted[0].baudrate)
    bits = max(1 + s.bytesize + (s.parity != "N") + s.stopbits for s in wanted)
    character = math.ceil(bits * _SECOND / baudrate)
    timeout = _serial_timeout(table, profiles)
    return Connection(
        name=name,
        transport="rtu-over-tcp",
        port=table.port,
        host=table.host,
        baudrate=baudrate,
        bytesize=0,
        parity="",
        stopbits=0,
        timeout=timeout,
        late_answer=_given(table.late_answer, 2 * timeout),
        silence=_silence(table, wanted, baudrate, character),
        character=character,
    )


def _serial_timeout(table: Rtu | RtuOverTcp, profiles: Sequence[RegisterMap]) -> int:
    longest = max((profile.answer_limit for profile in profiles), default=_ANSWER_LIMIT)
    return _given(table.timeout, longest)


def _silence(
    table: Rtu | RtuOverTcp, wanted: Sequence[SerialDefaults], baudrate: int, character: int
) -> int:
    if not isinstance(table.silence, UnsetType):
        return table.silence.nanoseconds(character)
    asked = max(serial.silence_characters for serial in wanted)
    return max(least_silence(baudrate, character), math.ceil(asked * character))


def least_silence(baudrate: int, character: int) -> int:
    """Nanoseconds that the standard asks between two frames."""
    if baudrate > _FIXED_SILENCE_ABOVE:
        return _FIXED_SILENCE
    return LEAST_SILENCE.nanoseconds(character)


def server(name: str, table: Tcp | Udp, profiles: Sequence[RegisterMap]) -> Connection | None:
    """As serial_line."""
    if isinstance(table.host, UnsetType):
        return None
    limits = [profile.answer_limit for profile in profiles]
    ports = {profile.port for profile in profiles}
    dialects = [profile.dialect for profile in profiles]
    return Connection(
        name=name,
        transport="tcp" if isinstance(table, Tcp) else "udp",
        port=_given(table.port, ports.pop() if len(ports) == 1 else MODBUS_PORT),
        host=table.host,
        baudrate=0,
        bytesize=0,
        parity="",
        stopbits=0,
        timeout=_given(table.timeout, max(_SECOND, *limits) if limits else _SECOND),
        late_answer=None,
        silence=0,
        character=0,
        dialect=dialects[0] if dialects else STANDARD,
    )


def device(name: str, table: DeviceTable, profile: RegisterMap) -> Device | None:
    """None where the connection is not known."""
    if isinstance(table.connection, UnsetType):
        return None
    return Device(
        name=name,
        profile=profile,
        connection=table.connection,
        unit=_given(table.unit, profile.unit),
        poll=_given(table.poll, _SECOND),
        word_order=_given(getattr(table, "word_order", UNSET), _word_order(profile)),
        acknowledge=_given(getattr(table, "acknowledge", UNSET), default=True),
        cycle=_optional(getattr(table, "cycle", UNSET)),
    )


def _word_order(profile: RegisterMap) -> WordOrder:
    """Numbers that come least significant octet first are found with octets and words reversed."""
    return WordOrder.ABCD if profile.dialect.order == "big" else WordOrder.DCBA

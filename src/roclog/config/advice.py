"""What is allowed but will disappoint, and how busy a serial line will be."""

from __future__ import annotations

import math
import os
import re
import stat
from dataclasses import dataclass
from itertools import chain, combinations
from pathlib import Path
from typing import TYPE_CHECKING, Final

from roclog.config.leaves import shown
from roclog.config.profiles import TABLES
from roclog.errors import Problem
from roclog.plugins import plugins_named
from roclog.quantities import format_duration
from roclog.register_map import Table
from roclog.request_plan import plan_requests, requests_by_period

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.config.settings import Connection, Device, Settings
    from roclog.modbus.request import Request
    from roclog.register_map import RegisterMap

TURNAROUND: Final = 10_000_000
"""Nanoseconds that a device typically takes between request and answer."""
_FRAME: Final = 3
"""Characters around a PDU on a serial line: unit and checksum."""
_LABELS: Final = {
    Table.DISCRETE_INPUTS: range(10_001, 20_000),
    Table.INPUT_REGISTERS: range(30_001, 40_000),
    Table.HOLDING_REGISTERS: range(40_001, 50_000),
}
"""What manuals that count from 1 call the addresses of a table; addresses in their own right."""
_ADDRESS_KEYS: Final = {"registers": "blocks", "mpa-48": "addresses"}
"""By profile, the key in which users write addresses."""
_BY_ID: Final = Path("/dev/serial/by-id")
_NUMBERED: Final = re.compile(r"/dev/tty(USB|ACM)\d+")
"""Names that the system gives out in the order of plugging in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """One device's part of a line: nanoseconds for one poll, every ``poll``."""

    device: str
    poll: int
    request: int
    turnaround: int
    answer: int
    silence: int

    @property
    def wire(self) -> int:
        """What no device can shorten."""
        return self.request + self.answer + self.silence

    @property
    def busy(self) -> int:
        return self.wire + self.turnaround


@dataclass(frozen=True, slots=True)
class BusLoad:
    """How much of the time one serial connection is in use."""

    connection: str
    shares: tuple[Share, ...]

    @property
    def expected(self) -> float:
        """1.0 = always busy, with a typical turnaround."""
        return sum(share.busy / share.poll for share in self.shares)

    @property
    def least(self) -> float:
        """Octets on the wire and silence alone; above 1.0 the polls cannot be kept."""
        return sum(share.wire / share.poll for share in self.shares)


def bus_loads(settings: Settings) -> list[BusLoad]:
    """For every serial line that has devices, also behind a gateway."""
    loads: list[BusLoad] = []
    for connection in settings.connections.values():
        shares = tuple(
            _share(device.name, period, requests, connection)
            for device in settings.devices.values()
            if device.connection == connection.name
            for period, requests in requests_by_period(device.profile, device.poll).items()
        )
        if shares and connection.is_serial:
            loads.append(BusLoad(connection.name, shares))
    return loads


def _share(device: str, period: int, requests: list[Request], connection: Connection) -> Share:
    asked = sum(_FRAME + len(request.pdu) for request in requests)
    answered = sum(_FRAME + request.answer_size for request in requests)
    return Share(
        device=device,
        poll=period,
        request=asked * connection.character,
        turnaround=len(requests) * TURNAROUND,
        answer=answered * connection.character,
        silence=len(requests) * connection.silence,
    )


def warnings(settings: Settings) -> list[Problem]:
    """Everything worth a second look in a valid configuration, by key path."""
    found = [*_file_warnings(settings)]
    for connection in settings.connections.values():
        key = f"connections.{connection.name}"
        users = [d for d in settings.devices.values() if d.connection == connection.name]
        found += [Problem(f"{key}{k}", text) for k, text in _connection_warnings(connection, users)]
    for device in settings.devices.values():
        found += [Problem(f"devices.{device.name}.poll", text) for text in _poll_warnings(device)]
        timeout = settings.connections[device.connection].timeout
        found += [
            Problem(f"devices.{device.name}.functions", text)
            for text in _repeat_warnings(device, timeout)
        ]
        key = f"devices.{device.name}.{_ADDRESS_KEYS.get(device.profile.name, 'blocks')}"
        found += [Problem(key, text) for text in _label_warnings(device)]
        key = f"devices.{device.name}.blocks"
        found += [Problem(key, text) for text in _payload_warnings(device)]
        key = f"devices.{device.name}.profile"
        found += [Problem(key, text) for text in _profile_warnings(device)]
    return [*found, *_twin_warnings(settings)]


def _twin_warnings(settings: Settings) -> Iterator[Problem]:
    """Devices that read the same of one unit. Those with a flag are judged where they clear it."""
    for one, other in combinations(settings.devices.values(), 2):
        same_unit = (one.connection, one.unit) == (other.connection, other.unit)
        if not same_unit or one.profile.flagged or other.profile.flagged:
            continue
        known = {(block.table, block.address) for block in one.profile.samples}
        both = [b.name for b in other.profile.samples if (b.table, b.address) in known]
        if both:
            yield Problem(
                f"devices.{other.name}.unit",
                f"{other.unit} is the unit of device {shown(one.name)} on the same connection, and "
                f"both read {both[0]}: one device is asked twice; where there are two, "
                "each needs its own unit",
            )


def _file_warnings(settings: Settings) -> Iterator[Problem]:
    try:
        mode = settings.path.stat().st_mode
    except OSError:
        return
    writers = [
        who for bit, who in ((stat.S_IWGRP, "its group"), (stat.S_IWOTH, "others")) if mode & bit
    ]
    if writers:
        yield Problem("", f"{' and '.join(writers)} may write to this file: chmod go-w")


def _connection_warnings(connection: Connection, users: list[Device]) -> Iterator[tuple[str, str]]:
    if not users:
        yield "", "no device uses this connection"
    if not connection.is_serial:
        return
    yield from _port_warnings(connection)
    known = ["baudrate"]
    if connection.transport == "rtu":  # else the gateway has the rest
        known += ["bytesize", "parity", "stopbits"]
    for device in users:
        who = f"{device.profile.name} ({device.name})"
        for name in known if device.profile.serial.is_documented else ():
            actual, fixed = getattr(connection, name), getattr(device.profile.serial, name)
            if actual != fixed:
                yield f".{name}", f"{shown(actual)}, but {who} has {shown(fixed)}"
        asked = math.ceil(device.profile.serial.silence_characters * connection.character)
        if connection.silence < asked:
            text = f"{format_duration(connection.silence)}, but {who} asks {format_duration(asked)}"
            yield ".silence", text
    longest = max((_longest_answer(device.profile) for device in users), default=0)
    needed = longest * connection.character + TURNAROUND
    if connection.timeout < needed:
        text = (
            f"{format_duration(connection.timeout)}, but the longest answer and a typical "
            f"turnaround take {format_duration(needed)} at {connection.baudrate} baud"
        )
        yield ".timeout", text


def _port_warnings(connection: Connection) -> Iterator[tuple[str, str]]:
    port = str(connection.port)
    if connection.transport == "rtu" and _NUMBERED.fullmatch(port):
        better = _name_that_stays(port) or f"a link below {_BY_ID}"
        yield ".port", f"{port} may be another adapter when it is plugged in again; use {better}"


def _name_that_stays(port: str) -> str | None:
    """The link to this port, of those that udev makes from make and serial number."""
    try:
        links = sorted(str(link) for link in _BY_ID.iterdir())
    except OSError:
        return None
    same = (link for link in links if os.path.realpath(link) == os.path.realpath(port))
    return next((link for link in same if link.isprintable()), None)


def _longest_answer(profile: RegisterMap) -> int:
    """Characters of a frame."""
    on_schedule = chain(*requests_by_period(profile, 1).values())
    facts = [f for block in profile.facts for f in plan_requests([block], profile.dialect)]
    requests = [*on_schedule, *(fetch.request for fetch in facts)]
    return _FRAME + max((request.answer_size for request in requests), default=0)


def _profile_warnings(device: Device) -> Iterator[str]:
    if device.profile.name in TABLES:
        for plugin in plugins_named(device.profile.name):
            yield f"{plugin}: has this name too; the built-in profile is used"


def _label_warnings(device: Device) -> Iterator[str]:
    for block in device.profile.blocks if device.profile.name in _ADDRESS_KEYS else ():
        labels = _LABELS.get(block.table, range(0))
        if block.address in labels:
            index, table = labels.index(block.address), block.table
            yield (
                f"{block.name}: address {block.address} is asked for as it is; a manual that "
                f"counts {table.replace('_', ' ')} from {labels.start} means address {index}"
            )


def _payload_warnings(device: Device) -> Iterator[str]:
    block = device.profile.flagged
    if block is None or block.handshake is None or not block.handshake.is_assumed:
        return
    if len(block.points) > 1:
        yield (
            f"{block.name}: a change of any point is a sample, also while the flag is down; name "
            "in payload the points of the trigger that change with a new sample only"
        )


def _poll_warnings(device: Device) -> Iterator[str]:
    if device.cycle is not None and device.poll > device.cycle:
        lost = 1 - device.cycle / device.poll
        yield (
            f"{format_duration(device.poll)} is longer than the cycle of the device, "
            f"{format_duration(device.cycle)}: about {lost:.0%} of the samples will be lost"
        )
    shortest = _shortest_cycle(device.profile)
    if device.cycle is None and shortest is not None and device.poll > shortest:
        yield (
            f"{format_duration(device.poll)} is longer than the shortest cycle that "
            f"{device.profile.name} can have, {format_duration(shortest)}: where the device is set "
            "so, samples will be lost"
        )


def _repeat_warnings(device: Device, timeout: int) -> Iterator[str]:
    for block in device.profile.samples:
        period = block.period or device.poll
        if block.repeatable and 2 * timeout > period:
            yield (
                f"{block.name} is repeatable, but will not be called again: two timeouts of "
                f"{format_duration(timeout)} do not fit {format_duration(period)}"
            )


def _shortest_cycle(profile: RegisterMap) -> int | None:
    """Nanoseconds, from the lowest documented values of the points that make the cycle."""
    if profile.cycle is None:
        return None
    facts, names = profile.cycle
    lows = [point.low for point in profile.block(facts).points if point.name in names]
    if any(low is None for low in lows):
        return None
    return int(sum(low for low in lows if low is not None) * 10**9)

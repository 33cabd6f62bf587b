"""``roclog simulate``."""

from __future__ import annotations

import asyncio
import math
import re
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple

import click

from roclog.devices import PROFILES
from roclog.quantities import format_duration, parse_duration
from roclog.simulators import (
    LineSettings,
    PtyEndpoint,
    RtuOverTcpEndpoint,
    SimulatedRoc,
    SimulatorServer,
    TcpEndpoint,
    UdpEndpoint,
)

_SIMULATED: Final = {"hiac-roc": SimulatedRoc}
_NETWORK: Final[dict[str, type[TcpEndpoint | UdpEndpoint | RtuOverTcpEndpoint]]] = {
    "--tcp": TcpEndpoint,
    "--udp": UdpEndpoint,
    "--rtu-over-tcp": RtuOverTcpEndpoint,
}

Endpoint = TcpEndpoint | UdpEndpoint | RtuOverTcpEndpoint | PtyEndpoint


class Wanted(NamedTuple):
    """One device to serve."""

    profile: str
    unit: int


def _devices(
    _: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> tuple[Wanted, ...]:
    wanted = []
    for text in texts:
        profile, colon, unit = text.partition(":")
        if profile not in _SIMULATED:
            known = ", ".join(_SIMULATED)
            raise click.BadParameter(f"{profile!r} is not one of {known}", param=parameter)
        if colon and not re.fullmatch("[0-9]{1,3}", unit):
            raise click.BadParameter(f"{unit!r} is not a unit from 1 to 247", param=parameter)
        wanted.append(Wanted(profile, int(unit) if colon else PROFILES[profile].unit))
    units = [each.unit for each in wanted]
    for each in wanted:
        if not 1 <= each.unit <= 247:
            raise click.BadParameter(f"{each.unit} is not a unit from 1 to 247", param=parameter)
        if units.count(each.unit) > 1:
            text = f"unit {each.unit} twice; write {each.profile}:139 for another one"
            raise click.BadParameter(text, param=parameter)
    return tuple(wanted)


def _address(
    _: click.Context, parameter: click.Parameter, text: str | None
) -> tuple[str, int] | None:
    if text is None:
        return None
    host, _colon, port = text.rpartition(":")
    if not host or not re.fullmatch("[0-9]{1,5}", port) or int(port) > 65535:
        raise click.BadParameter(f"{text!r} is not HOST:PORT", param=parameter)
    return host.removeprefix("[").removesuffix("]"), int(port)


def _duration(_: click.Context, parameter: click.Parameter, text: str | None) -> int | None:
    if text is None:
        return None
    try:
        return parse_duration(text)
    except ValueError as error:
        raise click.BadParameter(str(error), param=parameter) from error


def _positive(_: click.Context, parameter: click.Parameter, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise click.BadParameter(f"{value} is not a positive number", param=parameter)
    return value


@click.command()
@click.argument("devices", metavar="PROFILE[:UNIT]...", nargs=-1, required=True, callback=_devices)
@click.option(
    "--tcp",
    metavar="HOST:PORT",
    callback=_address,
    help="Serve Modbus TCP here; port 0 takes a free one.",
)
@click.option(
    "--udp",
    metavar="HOST:PORT",
    callback=_address,
    help="Serve Modbus UDP here.",
)
@click.option(
    "--rtu-over-tcp",
    metavar="HOST:PORT",
    callback=_address,
    help="Serve Modbus RTU over TCP here, as a gateway that passes octets through.",
)
@click.option(
    "--pty",
    metavar="LINK",
    type=click.Path(path_type=Path),
    help="Serve Modbus RTU on a pseudo-terminal that clients open as LINK.",
)
@click.option(
    "--baud",
    metavar="N",
    type=click.IntRange(50, 4_000_000),
    help="With --pty: octets take their time on a half-duplex line of N Bd. Without it they take "
    "none.",
)
@click.option(
    "--turnaround",
    metavar="DURATION",
    callback=_duration,
    help="With --pty: from the end of a request to the beginning of its answer, like 10ms.",
)
@click.option(
    "--usb-latency",
    metavar="DURATION",
    callback=_duration,
    help="With --pty: clients see octets only at ticks this far apart, like the 16ms of many USB "
    "adapters.",
)
@click.option(
    "--speed",
    type=float,
    default=1.0,
    show_default=True,
    callback=_positive,
    help="Seconds of the devices per second.",
)
@click.option(
    "--seed", type=int, default=1, show_default=True, help="Equal seeds give equal samples."
)
@click.option(
    "--truth",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write every completed sample to this CSV file; with several devices, "
    "to one file each with the unit in its name.",
)
def simulate(
    devices: tuple[Wanted, ...],
    *,
    tcp: tuple[str, int] | None,
    udp: tuple[str, int] | None,
    rtu_over_tcp: tuple[str, int] | None,
    pty: Path | None,
    baud: int | None,
    turnaround: int | None,
    usb_latency: int | None,
    speed: float,
    seed: int,
    truth: Path | None,
) -> None:
    """Serve simulated devices.

    Ends with SIGINT (Ctrl-C) or SIGTERM, exit code 0. UNIT is the one that the device is delivered
    with where it is not given. With --baud, --turnaround or --usb-latency, what the line has seen
    is told at the end; a short gap is a request that began before the silence that the devices ask
    for.

    \b
    Example:
      roclog simulate hiac-roc hiac-roc:139 --tcp 127.0.0.1:5020 --speed 10
      roclog simulate hiac-roc hiac-roc:139 --pty line --baud 9600 --turnaround 10ms
    """
    is_timed = any(option is not None for option in (baud, turnaround, usb_latency))
    if is_timed and pty is None:
        raise click.UsageError("--baud, --turnaround and --usb-latency are for --pty only")
    endpoints: list[Endpoint] = [
        kind(*address)
        for kind, address in zip(_NETWORK.values(), (tcp, udp, rtu_over_tcp), strict=True)
        if address is not None
    ]
    if pty is not None:
        line = _line(devices, baud, turnaround or 0, usb_latency or 0)
        endpoints.append(PtyEndpoint(pty, line))
    if len(endpoints) != 1:
        raise click.UsageError(f"one of {', '.join(_NETWORK)} and --pty is needed")
    (endpoint,) = endpoints
    with ExitStack() as files:
        served = []
        for wanted in devices:
            file = None
            if truth is not None:
                name = truth if len(devices) == 1 else _with_unit(truth, wanted.unit)
                file = files.enter_context(name.open("w", encoding="utf-8"))
            served.append(_SIMULATED[wanted.profile](wanted.unit, seed=seed, truth=file))
        asyncio.run(
            _serve(SimulatorServer(served, endpoint, speed=speed), endpoint, devices, speed)
        )
    if is_timed and isinstance(endpoint, PtyEndpoint):
        click.echo(f"line: {endpoint.statistics}", err=True)


def _line(
    devices: tuple[Wanted, ...], baud: int | None, turnaround: int, usb_latency: int
) -> LineSettings:
    """Octets have the format of the first device; the longest silence that one asks for counts."""
    asked = [PROFILES[wanted.profile].serial for wanted in devices]
    first = asked[0]
    return LineSettings(
        baud=baud,
        character_bits=1 + first.bytesize + (first.parity != "N") + first.stopbits,
        turnaround_ns=turnaround,
        usb_latency_ns=usb_latency,
        silence_characters=max(serial.silence_characters for serial in asked),
    )


def _with_unit(file: Path, unit: int) -> Path:
    return file.with_name(f"{file.stem}-{unit}{file.suffix}")


async def _serve(
    server: SimulatorServer,
    endpoint: Endpoint,
    devices: tuple[Wanted, ...],
    speed: float,
) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    try:
        await server.start()
    except OSError as error:
        options = [option for option, kind in _NETWORK.items() if isinstance(endpoint, kind)]
        option = options[0] if options else "--pty"
        reason = error.strerror or str(error)
        raise click.BadParameter(f"{_place(endpoint)}: {reason}", param_hint=option) from error
    try:
        names = ", ".join(f"{wanted.profile} unit {wanted.unit}" for wanted in devices)
        text = f"serving {names} on {_described(endpoint)} at speed {speed:g}, Ctrl-C ends"
        click.echo(text, err=True)
        await stop.wait()
    finally:
        await server.stop()


def _place(endpoint: Endpoint) -> str:
    if isinstance(endpoint, PtyEndpoint):
        return str(endpoint.link)
    host = f"[{endpoint.host}]" if ":" in endpoint.host else endpoint.host
    return f"{host}:{endpoint.port}"


def _described(endpoint: Endpoint) -> str:
    """Give the place and how the line there is."""
    parts = [_place(endpoint)]
    if isinstance(endpoint, PtyEndpoint):
        line = endpoint.settings
        if line.baud is not None:
            parts.append(f"{line.baud} Bd")
        if line.turnaround_ns:
            parts.append(f"turnaround {format_duration(line.turnaround_ns)}")
        if line.usb_latency_ns:
            parts.append(f"USB latency {format_duration(line.usb_latency_ns)}")
    return ", ".join(parts)

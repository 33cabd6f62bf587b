"""``roclog simulate``."""

from __future__ import annotations

import asyncio
import math
import re
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from roclog.devices import CONFIGURED, PROFILES
from roclog.quantities import format_duration, parse_duration
from roclog.simulators import (
    LineSettings,
    PtyEndpoint,
    Quirk,
    RtuOverTcpEndpoint,
    SimulatedMpa48,
    SimulatedMsxE3317,
    SimulatedRoc,
    SimulatedStampedInputs,
    SimulatorServer,
    TcpEndpoint,
    UdpEndpoint,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from roclog.register_map import RegisterMap
    from roclog.simulators import SimulatedDevice

_STAMPED: Final = "mei-timestamped"
_MPA: Final = "mpa-48"
_MSX: Final = "msx-e3317"
_SIMULATED: Final[dict[str, Callable[..., SimulatedDevice]]] = {
    "hiac-roc": SimulatedRoc,
    _STAMPED: SimulatedStampedInputs,
    _MPA: SimulatedMpa48,
    _MSX: SimulatedMsxE3317,
}
_MAPS: Final[Mapping[str, RegisterMap]] = {
    **PROFILES,
    **CONFIGURED,
}
"""For the unit and the line settings that devices are delivered with."""
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
        wanted.append(Wanted(profile, int(unit) if colon else _MAPS[profile].unit))
    units = [each.unit for each in wanted]
    for each in wanted:
        if each.profile == _MSX:
            if each.unit not in _MAPS[_MSX].dialect.units:
                text = f"{each.unit} is not a unit of {_MSX}, 0 or 1"
                raise click.BadParameter(text, param=parameter)
        elif not 1 <= each.unit <= 247:
            raise click.BadParameter(f"{each.unit} is not a unit from 1 to 247", param=parameter)
        if units.count(each.unit) > 1:
            other = 1 - each.unit if each.profile == _MSX else each.unit + 1
            text = f"unit {each.unit} twice; write {each.profile}:{other} for another one"
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


def _offset(_: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    """Seconds, which may be negative."""
    if text is None:
        return None
    seconds = (_duration(_, parameter, text.removeprefix("-")) or 0) / 1e9
    return -seconds if text.startswith("-") else seconds


def _quirks(
    _: click.Context, __: click.Parameter, words: tuple[str, ...]
) -> tuple[Quirk, ...] | None:
    return tuple(map(Quirk, words)) or None


def _sensors(
    _: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> dict[str, dict[str, Any]]:
    """Arguments of the simulator; none where nothing is said."""
    sensors: dict[str, str] = {}
    addresses: dict[str, int] = {}
    for text in texts:
        match = re.fullmatch("([^=@]+)=([^=@]+)(?:@([0-9]{1,5}))?", text)
        if match is None:
            raise click.BadParameter(f"{text!r} is not CHANNEL=MODEL[@REGISTER]", param=parameter)
        if match[1] in sensors:
            raise click.BadParameter(f"{match[1]} twice", param=parameter)
        sensors[match[1]] = match[2]
        if match[3]:
            addresses[match[1]] = int(match[3])
    return {"sensors": sensors, "addresses": addresses} if sensors else {}


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
    help=f"Write every completed sample, change of an input, or answer of {_MPA} to this CSV file; "
    "with several devices, to one file each with the unit in its name.",
)
@click.option(
    "--rate",
    metavar="N",
    type=click.FloatRange(0, 1000),
    help=f"{_STAMPED}: changes per second of the device.  [default: 1]",
)
@click.option(
    "--clock-offset",
    "clock_offset_s",
    metavar="DURATION",
    callback=_offset,
    help=f"{_STAMPED}: what its clock is ahead, like 90s; -90s is behind.",
)
@click.option(
    "--clock-drift",
    "clock_drift_ppm",
    metavar="PPM",
    type=click.FloatRange(-100_000, 100_000),
    help=f"{_STAMPED}: what its clock gains, in millionths.",
)
@click.option(
    "--quirk",
    "quirks",
    multiple=True,
    type=click.Choice([quirk.value for quirk in Quirk]),
    callback=_quirks,
    help=f"{_STAMPED}: answer as some devices do, or (misprinted) as the paper's wrong example; "
    "may be repeated.",
)
@click.option(
    "--byte-order",
    type=click.Choice(["big", "little"]),
    help=f"{_MSX}: of numbers, and of the MBAP header.  [default: big]",
)
@click.option(
    "--sensor",
    "sensors",
    metavar="CHANNEL=MODEL[@REGISTER]",
    multiple=True,
    callback=_sensors,
    help=f"{_MPA}: what is on a channel, like channel_2=model-10; from channel_3 on with the "
    "register of its status, like channel_3=model-52@40; may be repeated.  "
    "[default: channel_1=model-15, channel_2=model-10]",
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
    byte_order: str | None,
    sensors: dict[str, dict[str, Any]],
    **stamped: Any,
) -> None:
    """Serve simulated devices.

    Ends with SIGINT (Ctrl-C) or SIGTERM, exit code 0. UNIT is the one that the device is delivered
    with where it is not given. With --baud, --turnaround or --usb-latency, what the line has seen
    is told at the end; a short gap is a request that began before the silence that the devices ask
    for. A mei-timestamped device has 22 discrete inputs from 196 on with stamps of 7 octets, and 2
    input registers from 8 on with stamps of 4.

    \b
    Example:
      roclog simulate hiac-roc hiac-roc:139 --tcp 127.0.0.1:5020 --speed 10
      roclog simulate hiac-roc hiac-roc:139 --pty line --baud 9600 --turnaround 10ms
      roclog simulate msx-e3317 --udp 127.0.0.1:5120 --byte-order little
      roclog simulate mei-timestamped --udp 127.0.0.1:5020 --rate 5 --clock-offset 2s
      roclog simulate mpa-48:3 --tcp 127.0.0.1:5020 --speed 10
    """
    is_timed = any(option is not None for option in (baud, turnaround, usb_latency))
    if is_timed and pty is None:
        raise click.UsageError("--baud, --turnaround and --usb-latency are for --pty only")
    own = _own_arguments(devices, byte_order, sensors, stamped)
    _check_modules(devices, byte_order, is_plain=(pty or rtu_over_tcp or truth) is None)
    endpoints = _network((tcp, udp, rtu_over_tcp), is_little_endian=byte_order == "little")
    if pty is not None:
        line = _line(devices, baud, turnaround or 0, usb_latency or 0)
        endpoints.append(PtyEndpoint(pty, line))
    if len(endpoints) != 1:
        raise click.UsageError(f"one of {', '.join(_NETWORK)} and --pty is needed")
    (endpoint,) = endpoints
    with ExitStack() as files:
        served = []
        for wanted in devices:
            arguments: dict[str, Any] = {"seed": seed, **own.get(wanted.profile, {})}
            if truth is not None:
                name = truth if len(devices) == 1 else _with_unit(truth, wanted.unit)
                arguments["truth"] = files.enter_context(name.open("w", encoding="utf-8"))
            served.append(_made(wanted, **arguments))
        server = SimulatorServer(served, endpoint, speed=speed)
        asyncio.run(_serve(server, endpoint, devices, speed))
    if is_timed and isinstance(endpoint, PtyEndpoint):
        click.echo(f"line: {endpoint.statistics}", err=True)


def _own_arguments(
    devices: tuple[Wanted, ...],
    byte_order: str | None,
    sensors: dict[str, dict[str, Any]],
    stamped: dict[str, Any],
) -> dict[str, dict[str, Any]]:
    """What the options of one profile give its simulators, by profile."""
    if sensors and all(wanted.profile != _MPA for wanted in devices):
        raise click.UsageError(f"--sensor is for {_MPA} only")
    given = {name: value for name, value in stamped.items() if value is not None}
    if given and all(wanted.profile != _STAMPED for wanted in devices):
        text = f"--rate, --clock-offset, --clock-drift and --quirk are for {_STAMPED} only"
        raise click.UsageError(text)
    return {_STAMPED: given, _MPA: sensors, _MSX: {"byte_order": byte_order or "big"}}


def _network(
    addresses: tuple[tuple[str, int] | None, ...], *, is_little_endian: bool
) -> list[Endpoint]:
    """In the order of ``_NETWORK``."""
    return [
        kind(*address, is_little_endian=is_little_endian)
        for kind, address in zip(_NETWORK.values(), addresses, strict=True)
        if address is not None
    ]


def _check_modules(devices: tuple[Wanted, ...], byte_order: str | None, *, is_plain: bool) -> None:
    """is_plain: no line, no gateway, no truth."""
    modules = [wanted for wanted in devices if wanted.profile == _MSX]
    if byte_order is not None and len(modules) < len(devices):
        raise click.UsageError(f"--byte-order is for {_MSX} only")
    if modules and not is_plain:
        raise click.UsageError(f"{_MSX} is served with --tcp or --udp, and without --truth")


def _made(wanted: Wanted, **arguments: Any) -> SimulatedDevice:
    try:
        return _SIMULATED[wanted.profile](wanted.unit, **arguments)
    except (ValueError, OverflowError) as error:
        raise click.UsageError(f"{wanted.profile}: {error}") from error


def _line(
    devices: tuple[Wanted, ...], baud: int | None, turnaround: int, usb_latency: int
) -> LineSettings:
    """Octets have the format of the first device; the longest silence that one asks for counts."""
    asked = [_MAPS[wanted.profile].serial for wanted in devices]
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

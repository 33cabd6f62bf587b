"""``roclog check``."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from roclog.cli import output
from roclog.config import BusLoad, bus_loads, load, warnings
from roclog.errors import ConfigError, DeviceError, Problem, StorageError
from roclog.quantities import format_duration
from roclog.request_plan import place_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from roclog.config import Connection, Device, RecordingSettings, Settings
    from roclog.probe import ProbeResult
    from roclog.register_map import Block

_BUSY: Final = 0.8
"""Share of the time above which polls begin to wait for each other."""


@dataclass(frozen=True, slots=True)
class Place:
    """The recording directory as it is now. problem: why nothing can be recorded there."""

    exists: bool
    free: int
    problem: str = ""


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--probe", is_flag=True, help="Contact every device, read only.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@click.pass_context
def check(context: click.Context, config: Path, *, probe: bool, as_json: bool) -> None:
    """Validate CONFIG and show what will be recorded.

    All problems are reported at once, each with its key. Exit code 3: the configuration cannot be
    used; 6: the recording directory cannot. With --probe 4: no device gave anything of its data;
    5: something is missing.

    \b
    Example:
      roclog check roclog.toml --probe
    """
    try:
        settings = load(config)
        loads = bus_loads(settings)
        _refuse_overload(settings, loads)
    except ConfigError as error:
        if as_json:
            problems = [{"key": p.key, "text": p.text} for p in error.problems]
            click.echo(json.dumps({"schema": "roclog.check/1", "problems": problems}))
        raise
    place = look_at(settings.recording.directory)
    doubts = [*warnings(settings), *_load_warnings(loads), *_space_warnings(settings, place)]
    if not as_json:
        for line in _description(settings, loads, place):
            click.echo(line)
    for doubt in doubts:
        click.echo(f"roclog: warning: {settings.path.name}: {doubt}", err=True)
    results = _probe(settings) if probe else None
    if as_json:
        click.echo(json.dumps(_as_object(settings, loads, place, doubts, results)))
    else:
        for result in results or ():
            for line in _probe_lines(result):
                click.echo(output.printable(line))
    if place.problem:
        raise StorageError(settings.recording.directory, place.problem)
    _judge(context, results or [])


def _probe_lines(result: ProbeResult) -> Iterator[str]:
    yield f"{result.state:12}{result.device}: {result.text}"
    for part in result.problems:
        yield f"{'':14}{part.state}: {part.place}: {part.problem}"
    for text in result.left_out:
        yield f"{'':14}not asked: {text}"


def _judge(context: click.Context, results: list[ProbeResult]) -> None:
    """Raises DeviceError where no device gave anything; exits where something is missing."""
    asked = [result for result in results if result.state != "not asked"]
    mute = [result for result in asked if result.state not in ("answers", "partly")]
    if results and len(mute) == len(asked):
        is_silent = bool(mute) and all(result.state == "silent" for result in mute)
        raise DeviceError("no device answered" if is_silent else "no device gave its data")
    partly = [result for result in results if result.state == "partly"]
    if mute:
        output.tell(f"no data of {_names(mute)}")
    if partly:
        output.tell(f"{_names(partly)}: only a part could be read")
    if mute or partly:
        context.exit(output.DAMAGED)


def _names(results: list[ProbeResult]) -> str:
    return ", ".join(result.device for result in results)


def _probe(settings: Settings) -> list[ProbeResult]:
    from roclog.clock import SystemClock  # noqa: PLC0415 - brings the whole bus with it
    from roclog.probe import probe  # noqa: PLC0415

    return asyncio.run(probe(settings, SystemClock()))


def look_at(directory: Path) -> Place:
    """Where data would go: the directory, or the nearest one above it that exists."""
    exists = directory.is_dir()
    nearest = directory
    while not os.path.lexists(nearest) and nearest != nearest.parent:
        nearest = nearest.parent
    try:
        free = shutil.disk_usage(nearest).free
    except OSError as error:
        return Place(exists, 0, error.strerror or str(error))
    if not nearest.is_dir():
        return Place(exists, free, f"{nearest} is not a directory")
    if not os.access(nearest, os.W_OK | os.X_OK):
        verb = "written to" if exists else f"created: {nearest} is not writable"
        return Place(exists, free, f"cannot be {verb}")
    return Place(exists, free)


def _refuse_overload(settings: Settings, loads: list[BusLoad]) -> None:
    problems = [
        Problem(
            f"connections.{bus.connection}",
            f"polls need {bus.least:.0%} of the time for octets and silence alone: "
            f"{', '.join(_terms(bus))}; poll less often or raise the baud rate",
        )
        for bus in loads
        if bus.least > 1
    ]
    if problems:
        raise ConfigError(settings.path, problems)


def _load_warnings(loads: list[BusLoad]) -> list[Problem]:
    return [
        Problem(
            f"connections.{bus.connection}",
            f"polls need {bus.expected:.0%} of the time, so they will wait for each other",
        )
        for bus in loads
        if bus.expected > _BUSY
    ]


def _space_warnings(settings: Settings, place: Place) -> list[Problem]:
    recording = settings.recording
    wanted = recording.keep_size or 2 * recording.segment_size
    if place.problem or place.free >= wanted:
        return []
    text = f"{_size(place.free)} are free, less than {_size(wanted)}"
    why = "keep.size" if recording.keep_size else "two segments"
    return [Problem("recording.directory", f"{text} ({why})")]


def _description(settings: Settings, loads: list[BusLoad], place: Place) -> list[str]:
    lines = [
        f"{'file':12}{settings.path}",
        f"{'directory':12}{settings.recording.directory}, {_place(place)}",
        f"{'segments':12}{_segments(settings.recording)}",
    ]
    lines += [f"{'connection':12}{_connection(c)}" for c in settings.connections.values()]
    for device in settings.devices.values():
        lines.append(f"{'device':12}{_device(device)}")
        lines += [f"{'':14}{what}" for what in _samples(device)]
    for bus in loads:
        lines.append(f"{'bus load':12}{bus.connection}: {bus.expected:.1%}")
        lines += [f"{'':14}{term}" for term in _terms(bus)]
    return lines


def _place(place: Place) -> str:
    if place.problem:
        return place.problem
    state = "writable" if place.exists else "will be created"
    return f"{state}, {_size(place.free)} free"


def _segments(recording: RecordingSettings) -> str:
    limits = f"{format_duration(recording.segment_duration)} or {_size(recording.segment_size)}"
    kept = [
        *([format_duration(recording.keep_age)] if recording.keep_age is not None else []),
        *([_size(recording.keep_size)] if recording.keep_size is not None else []),
    ]
    return f"end at {limits}, kept: {' or '.join(kept) or 'all'}"


def _connection(connection: Connection) -> str:
    text = f"{connection.name}: {connection.transport} {connection.place}"
    timeout = format_duration(connection.timeout)
    if connection.late_answer is None:
        return f"{text}, timeout {timeout}"
    line = f"{connection.baudrate} Bd"
    if connection.transport == "rtu":
        line += f" {connection.bytesize}{connection.parity}{connection.stopbits}"
    if connection.rs485 is not None:
        line += ", direction by RTS"
    return (
        f"{text}, {line}, timeout {timeout}, "
        f"late answer {format_duration(connection.late_answer)}, "
        f"silence {_milliseconds(connection.silence)}"
    )


def _device(device: Device) -> str:
    unset = "not known" if device.profile.cycle is None else "as the device says"
    said = unset if device.cycle is None else format_duration(device.cycle)
    cycle = f"cycle {said}, " if device.profile.flagged is not None else ""
    dialect = device.profile.dialect
    order = f"{device.word_order}, " if device.profile.samples else ""
    if dialect.has_functions:
        order = f"{dialect.order} endian, "
    clears = "clears its flag" if device.clears else "never writes"
    return (
        f"{device.name}: {device.profile.name}, unit {device.unit} on {device.connection}, "
        f"poll {format_duration(device.poll)}, {cycle}{order}{clears}"
    )


def _samples(device: Device) -> list[str]:
    """What will be read, and where. Where a register is a function it is called, which may act."""
    return [
        f"{_asked_for(device, block)}, every {format_duration(block.period or device.poll)}"
        + (f": {block.title}" if block.title else "")
        for block in device.profile.samples
    ]


def _asked_for(device: Device, block: Block) -> str:
    dialect = device.profile.dialect
    if dialect.has_functions:
        return f"calls {place_of(block, dialect)}, {block.octets} octets"
    return f"reads {place_of(block, dialect)}"


def _terms(bus: BusLoad) -> list[str]:
    return [
        f"{share.device}: request {_milliseconds(share.request)} + turnaround "
        f"{_milliseconds(share.turnaround)} + answer {_milliseconds(share.answer)} + silence "
        f"{_milliseconds(share.silence)} every {format_duration(share.poll)}"
        for share in bus.shares
    ]


def _milliseconds(nanoseconds: int) -> str:
    return f"{nanoseconds / 1e6:.2f}ms"


def _size(octets: int) -> str:
    amount = float(octets)
    for unit in ("B", "KiB", "MiB", "GiB"):
        if amount < 1024:
            return f"{amount:.4g} {unit}"
        amount /= 1024
    return f"{amount:.4g} TiB"


def _as_object(
    settings: Settings,
    loads: list[BusLoad],
    place: Place,
    doubts: list[Problem],
    results: list[ProbeResult] | None,
) -> dict[str, object]:
    recording = settings.recording
    return {
        "schema": "roclog.check/1",
        "problems": [],
        "warnings": [{"key": doubt.key, "text": doubt.text} for doubt in doubts],
        "path": str(settings.path),
        "recording": {
            "directory": str(recording.directory),
            "exists": place.exists,
            "problem": place.problem or None,
            "free_bytes": place.free,
            "segment_duration_ns": recording.segment_duration,
            "segment_size_bytes": recording.segment_size,
            "keep_age_ns": recording.keep_age,
            "keep_size_bytes": recording.keep_size,
        },
        "connections": [_connection_object(c) for c in settings.connections.values()],
        "devices": [_device_object(d) for d in settings.devices.values()],
        "bus_loads": [
            {"connection": bus.connection, "expected": bus.expected, "least": bus.least}
            for bus in loads
        ],
        "probe": None if results is None else [_probe_object(result) for result in results],
    }


def _probe_object(result: ProbeResult) -> dict[str, object]:
    return {
        "device": result.device,
        "state": result.state,
        "ok": result.state == "answers",
        "refused": result.state == "refuses",
        "text": result.text,
        "blocks": [
            {"place": part.place, "state": part.state, "problem": part.problem}
            for part in result.parts
        ],
        "not_asked": list(result.left_out),
    }


def _connection_object(connection: Connection) -> dict[str, object]:
    return {
        "name": connection.name,
        "transport": connection.transport,
        "place": connection.place,
        "timeout_ns": connection.timeout,
        "late_answer_ns": connection.late_answer,
        "silence_ns": connection.silence,
        "baudrate": connection.baudrate or None,
    }


def _device_object(device: Device) -> dict[str, object]:
    return {
        "name": device.name,
        "profile": device.profile.name,
        "connection": device.connection,
        "unit": device.unit,
        "poll_ns": device.poll,
        "cycle_ns": device.cycle,
        "word_order": device.word_order.value,
        "acknowledge": device.acknowledge,
        "blocks": [
            {
                "name": block.name,
                "title": block.title,
                "table": block.table.value,
                "address": block.address,
                "count": block.count,
            }
            for block in device.profile.samples
        ],
    }

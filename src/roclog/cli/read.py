"""``roclog read``."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.table import Table

from roclog.errors import DeviceError
from roclog.quantities import format_instant
from roclog.register_map import WordType
from roclog.time_flags import flag_words

if TYPE_CHECKING:
    from roclog.decode import Value
    from roclog.probe import BlockRead, StampedRead
    from roclog.register_map import Point


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.argument("device")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def read(config: Path, device: str, *, as_json: bool) -> None:
    """Read every block of DEVICE once and print it decoded. Nothing is written or cleared.

    \b
    Example:
      roclog read roclog.toml roc1
    """
    from roclog.clock import SystemClock  # noqa: PLC0415
    from roclog.config import load  # noqa: PLC0415
    from roclog.probe import read_device, read_stamped  # noqa: PLC0415

    settings = load(config)
    if device not in settings.devices:
        known = ", ".join(settings.devices)
        raise click.UsageError(f"{config} has no device {device!r}; it has {known}")
    blocks = asyncio.run(read_device(settings, device, SystemClock()))
    lists = asyncio.run(read_stamped(settings, device, SystemClock()))
    if as_json:
        click.echo(json.dumps(_as_object(device, blocks, lists), default=bytes.hex))
    else:
        is_function = settings.devices[device].profile.dialect.has_functions
        for block in blocks:
            _print_block(block, is_function=is_function)
        for inputs in lists:
            _print_inputs(inputs)
    problems = [block.problem for block in blocks] + [inputs.problem for inputs in lists]
    if all(problems):
        raise DeviceError(f"{device}: {problems[0]}")


def _print_block(read: BlockRead, *, is_function: bool) -> None:
    """is_function: a register is a function, and what it answers has octets, not addresses."""
    console = Console(soft_wrap=True)
    block = read.block
    where = "function" if is_function else "bits from" if block.table.has_bits else "from register"
    title = f"{block.title or block.name}, {where} {block.address}"
    if read.decoded is None:
        console.print(f"{title}: {read.problem}\n", markup=False)
        return
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    place = "octet" if is_function else "address" if block.table.has_bits else "register"
    for heading in (place, "raw", "name", "value", "unit", ""):
        table.add_column(heading, justify="right" if heading in {place, "raw"} else "left")
    values = _by_name(read)
    for index, point in enumerate(block.points):
        remark = _remark(point, values)
        if read.decoded.doubtful >> index & 1:
            remark = f"{_doubt(point)}. {remark}"
        address = point.offset * (1 if block.packed else 2)
        if not is_function:
            address = block.address + point.offset
        value = _text(_meant(point, values[point.name]))
        raw = _raw(read, point)
        table.add_row(str(address), raw, point.name, value, point.unit, remark.strip())
    console.print(table, markup=False)
    if read.decoded.device_time:
        console.print(f"device time {format_instant(read.decoded.device_time)}")
    elif block.time is not None:
        console.print(f"device time unknown, {flag_words(read.decoded.time_flags)}")
    console.print()


def _raw(read: BlockRead, point: Point) -> str:
    """The first four of its registers, or in a packed block as many octets."""
    size, width = read.block.size_of(point), 2 if read.block.packed else 4
    most = 16 // width
    first = read.registers[point.offset : point.offset + min(size, most)]
    return " ".join(f"{one:0{width}X}" for one in first) + (" ..." if size > most else "")


def _print_inputs(read: StampedRead) -> None:
    console = Console(soft_wrap=True)
    title = f"{read.table.replace('_', ' ').capitalize()} {read.first} to {read.last}, with stamps"
    if read.problem:
        console.print(f"{title}: {read.problem}\n", markup=False)
        return
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("address", "value", "changed at", "octets", ""):
        table.add_column(heading, justify="right" if heading in {"address", "value"} else "left")
    for address, value, stamp in read.inputs:
        changed = format_instant(stamp.device_time) if stamp.device_time else "unknown"
        row = (str(address), str(value), changed, stamp.octets.hex(" "), flag_words(stamp.flags))
        table.add_row(*row)
    console.print(table, markup=False)
    console.print()


def _remark(point: Point, values: dict[str, Value | None]) -> str:
    if values[point.name] is None:
        return "no measurement"
    set_bits = [name for _, name in point.bits if values[name]]
    parts = [f"{name} {values[name]!r}" for _, _, name in point.parts]
    meanings = [text for value, text in point.meanings if value == values[point.name]]
    return ", ".join(set_bits + parts + meanings)


def _doubt(point: Point) -> str:
    if point.low is None:
        return f"not plausible as {point.type}"
    return f"outside the documented range {point.low} to {point.high}"


def _by_name(read: BlockRead) -> dict[str, Value | None]:
    from roclog.decode import named_values  # noqa: PLC0415

    if read.decoded is None:
        return {}
    return named_values(read.block, read.decoded)


def _meant(point: Point, value: Value | None) -> Value | None:
    """A binary32 with the digits that it has, as the instrument shows it."""
    from roclog.word_types import shortest_float32  # noqa: PLC0415

    is_binary32 = point.type is WordType.F32 and not point.is_scaled
    return shortest_float32(value) if is_binary32 and isinstance(value, float) else value


def _text(value: Value | None) -> str:
    """Device strings come from outside: control characters are shown, not obeyed."""
    if value is None:
        return "-"
    if isinstance(value, bytes):
        return value.hex(" ")
    if isinstance(value, str):
        return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in value)
    return repr(value)


def _as_object(device: str, blocks: list[BlockRead], lists: list[StampedRead]) -> dict[str, object]:
    return {
        "schema": "roclog.read/1",
        "device": device,
        "stamped": [
            {
                "table": read.table.value,
                "first": read.first,
                "last": read.last,
                "problem": read.problem,
                "inputs": [
                    {
                        "address": address,
                        "value": value,
                        "device_time": stamp.device_time or None,
                        "time_flags": flag_words(stamp.flags).split(),
                        "time_octets": stamp.octets.hex(),
                    }
                    for address, value, stamp in read.inputs
                ],
            }
            for read in lists
        ],
        "blocks": {
            read.block.name: {
                "values": _by_name(read),
                "octets" if read.block.packed else "registers": list(read.registers),
            }
            if read.decoded is not None
            else {"problem": read.problem}
            for read in blocks
        },
    }

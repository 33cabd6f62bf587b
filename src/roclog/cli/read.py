"""``roclog read``."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from roclog.cli import output
from roclog.errors import DeviceError
from roclog.quantities import format_instant
from roclog.register_map import WordType
from roclog.time_flags import flag_words

if TYPE_CHECKING:
    from roclog.config import Device
    from roclog.decode import Value
    from roclog.probe import BlockRead, StampedRead
    from roclog.register_map import Point, WordOrder


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
    from roclog.recording.objects import to_json  # noqa: PLC0415

    settings = load(config)
    if device not in settings.devices:
        known = ", ".join(settings.devices)
        raise click.UsageError(f"{config} has no device {device!r}; it has {known}")
    blocks = asyncio.run(read_device(settings, device, SystemClock()))
    lists = asyncio.run(read_stamped(settings, device, SystemClock()))
    asked = settings.devices[device]
    if as_json:
        click.echo(to_json(_as_object(asked, blocks, lists)))
    else:
        for block in blocks:
            is_function = asked.profile.dialect.has_functions
            _print_block(block, asked.word_order, is_function=is_function)
        for inputs in lists:
            _print_inputs(inputs)
    problems = [block.problem for block in blocks] + [inputs.problem for inputs in lists]
    if all(problems):
        raise DeviceError(f"{device}: {problems[0]}")


def _print_block(read: BlockRead, order: WordOrder, *, is_function: bool) -> None:
    """is_function: a register is a function, and what it answers has octets, not addresses."""
    from roclog.decode import why_missing  # noqa: PLC0415

    block = read.block
    where = "function" if is_function else "bits from" if block.table.has_bits else "from register"
    title = f"{block.title or block.name}, {where} {block.address}"
    if read.decoded is None:
        click.echo(output.printable(f"\n{title}: {read.problem}"))
        return
    place = "octet" if is_function else "address" if block.table.has_bits else "register"
    values, reasons = _by_name(read), why_missing(block, read.registers, order)
    rows = []
    for index, point in enumerate(block.points):
        remark = _remark(point, values, reasons)
        if read.decoded.doubtful >> index & 1:
            remark = f"{_doubt(point)}. {remark}"
        address = point.offset * (1 if block.packed else 2)
        if not is_function:
            address = block.address + point.offset
        value = _text(_meant(point, values[point.name]))
        raw = _raw(read, point)
        rows.append((str(address), raw, point.name, value, point.unit, remark.strip()))
    headings = (place, "raw", "name", "value", "unit", "")
    output.print_table(title, headings, rows, numeric=(place, "raw"))
    if read.decoded.device_time:
        click.echo(f"device time {format_instant(read.decoded.device_time)}")
    elif block.time is not None:
        click.echo(f"device time unknown, {flag_words(read.decoded.time_flags)}")


def _raw(read: BlockRead, point: Point) -> str:
    """The first four of its registers, or in a packed block as many octets."""
    size, width = read.block.size_of(point), 2 if read.block.packed else 4
    most = 16 // width
    first = read.registers[point.offset : point.offset + min(size, most)]
    return " ".join(f"{one:0{width}X}" for one in first) + (" ..." if size > most else "")


def _print_inputs(read: StampedRead) -> None:
    title = f"{read.table.replace('_', ' ').capitalize()} {read.first} to {read.last}, with stamps"
    if read.problem:
        click.echo(output.printable(f"\n{title}: {read.problem}"))
        return
    rows = []
    for address, value, stamp in read.inputs:
        changed = format_instant(stamp.device_time) if stamp.device_time else "unknown"
        row = (str(address), str(value), changed, stamp.octets.hex(" "), flag_words(stamp.flags))
        rows.append(row)
    headings = ("address", "value", "changed at", "octets", "")
    output.print_table(title, headings, rows, numeric=("address", "value"))


def _remark(point: Point, values: dict[str, Value | None], reasons: dict[str, str]) -> str:
    if values[point.name] is None:
        return f"no measurement: {reasons[point.name]}"
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
    if value is None:
        return "-"
    if isinstance(value, bytes):
        return value.hex(" ")
    return value if isinstance(value, str) else repr(value)


def _block_object(read: BlockRead, order: WordOrder) -> dict[str, object]:
    """Every null among the values has its reason in ``why_null``."""
    from roclog.decode import why_missing  # noqa: PLC0415

    if read.decoded is None:
        return {"problem": read.problem}
    block, decoded, values = read.block, read.decoded, _by_name(read)
    odd = {
        name: {math.inf: "Infinity", -math.inf: "-Infinity"}.get(value, "NaN")
        for name, value in values.items()
        if isinstance(value, float) and not math.isfinite(value)
    }
    reasons = why_missing(block, read.registers, order)
    for point in block.points:
        if point.name in reasons:
            odd |= dict.fromkeys(point.field_names, reasons[point.name])
    marked = [p.name for index, p in enumerate(block.points) if decoded.doubtful >> index & 1]
    return {
        "values": values,
        "why_null": odd,
        "doubtful": marked,
        "device_time": decoded.device_time or None,
        "time_flags": flag_words(decoded.time_flags).split(),
        "octets" if block.packed else "registers": list(read.registers),
    }


def _as_object(
    device: Device, blocks: list[BlockRead], lists: list[StampedRead]
) -> dict[str, object]:
    return {
        "schema": "roclog.read/1",
        "device": device.name,
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
        "blocks": {read.block.name: _block_object(read, device.word_order) for read in blocks},
    }

"""``roclog profiles``."""

from __future__ import annotations

import json
import sys
from difflib import get_close_matches
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import click

from roclog.devices import CONFIGURED, PROFILES
from roclog.errors import RegisterMapError
from roclog.plugins import find_plugins, load_plugin, plugins_named
from roclog.quantities import format_duration
from roclog.register_map import Change, ClearOnRead, Counter, FlagAndClear, SplitCalendar

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from roclog.plugins import Plugin
    from roclog.register_map import Block, Point, RegisterMap, TimeSource

_NUMERIC: Final = frozenset({"address", "octet", "words", "octets", "unit id"})
_LONG: Final = frozenset({"title", "source", "package"})
_POINT_HEADINGS: Final = ("name", "type", "scale", "unit", "range", "title")


_BUILT_IN: Final[Mapping[str, RegisterMap]] = {**PROFILES, **CONFIGURED}


class Listed(NamedTuple):
    """A register map and what brings it; None = roclog."""

    profile: RegisterMap
    plugin: Plugin | None = None


@click.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def profiles(name: str | None, *, as_json: bool) -> None:
    """Show the register maps, built in and of plug-ins.

    Without NAME the list of them. Addresses are PDU addresses, counted from 0.

    \b
    Example:
      roclog profiles hiac-roc
    """
    broken: list[RegisterMapError] = []
    chosen = _all(broken) if name is None else [_one(name)]
    if as_json:
        objects = [_profile_object(listed, blocks=name is not None) for listed in chosen]
        problems = [{"name": error.name, "problems": error.problems} for error in broken]
        found = {"schema": "roclog.profiles/1", "profiles": objects, "broken": problems}
        click.echo(json.dumps(found))
    elif name is None:
        rows = [(p.name, p.title, *_delivered(p), _origin(by), p.source) for p, by in chosen]
        headings = ("name", "title", "unit id", "serial line", "package", "source")
        _print_table(headings, rows)
    else:
        _print_profile(chosen[0])
    for error in broken:
        more = len(error.problems) - 1
        rest = f" (and {more} more, see roclog profiles {error.name})" if more else ""
        click.echo(f"roclog: warning: profile {error.name}: {error.problems[0]}{rest}", err=True)


def _one(name: str) -> Listed:
    if name in _BUILT_IN:
        return Listed(_BUILT_IN[name])
    plugins = plugins_named(name)
    if plugins and name not in _reserved():
        return Listed(load_plugin(name), plugins[0])
    if name in _reserved():
        text = (
            f"{name} has no map to show: its map stands in a configuration, as in examples/*.toml"
        )
        raise click.BadParameter(text, param_hint="NAME")
    known = list(dict.fromkeys([*_BUILT_IN, *(plugin.name for plugin in find_plugins())]))
    close = get_close_matches(name, known, n=1)
    hint = f", did you mean {close[0]!r}?" if close else f"; there is {', '.join(known)}"
    raise click.BadParameter(f"no profile {name!r}{hint}", param_hint="NAME")


def _all(broken: list[RegisterMapError]) -> list[Listed]:
    """Every map that can be used; what is wrong with the others goes to ``broken``."""
    found = [Listed(profile) for profile in _BUILT_IN.values()]
    plugins = {plugin.name: plugin for plugin in find_plugins()}
    for name, plugin in plugins.items():
        try:
            if name in _reserved():
                others = " and ".join(map(str, plugins_named(name)))
                text = f"{others}: has the name of a built-in profile, which is used"
                raise RegisterMapError(name, [text])  # noqa: TRY301 - as a map that is broken
            found.append(Listed(load_plugin(name), plugin))
        except RegisterMapError as error:
            broken.append(error)
    return found


def _reserved() -> frozenset[str]:
    """Names of all built-in profiles, those that have no map to show as well."""
    from roclog.config.profiles import TABLES  # noqa: PLC0415 - only where there are plug-ins

    return frozenset(TABLES)


def _origin(plugin: Plugin | None) -> str:
    return "built in" if plugin is None else plugin.origin


def _print_profile(listed: Listed) -> None:
    profile = listed.profile
    for label, text in _facts(profile, listed.plugin):
        click.echo(f"{label:12}{text}")
    for block in profile.blocks:
        click.echo(f"\n{block.title or block.name}")
        for label, text in _block_facts(profile, block):
            click.echo(f"{label:12}{text}")
        is_function = profile.dialect.has_functions
        headings = ("octet" if is_function else "address", "octets" if block.packed else "words")
        points = sorted(block.points, key=lambda point: point.offset)
        rows = [row for point in points for row in _rows(block, point, is_function=is_function)]
        _print_table((*headings, *_POINT_HEADINGS), rows)


def _facts(profile: RegisterMap, plugin: Plugin | None) -> Iterator[tuple[str, str]]:
    yield "profile", f"{profile.name}: {profile.title}"
    if plugin is not None:
        yield "package", plugin.origin
    yield "source", profile.source
    label, more = ("delivered", "") if _is_documented(profile) else ("assumed", ", not documented")
    yield label, f"unit {profile.unit}, {_serial(profile)}{more}"
    if profile.has_serial_port:
        yield "silence", f"{profile.serial.silence_characters:g} characters before a request"
    yield "answers", f"within {format_duration(profile.answer_limit)}{more}"
    if profile.cycle is not None:
        yield "cycle", f"{' + '.join(profile.cycle[1])} of block {profile.cycle[0]}"
    for note in profile.notes:
        yield "note", note


def _block_facts(profile: RegisterMap, block: Block) -> Iterator[tuple[str, str]]:
    when = "at every poll" if block in profile.samples else "when recording starts"
    if block.period is not None:
        when = f"every {format_duration(block.period)}"
    if profile.dialect.has_functions:
        size = f"{block.octets} octets"
        yield "block", f"{block.name}: function {block.address}, {size}, called {when}"
    else:
        last = block.address + block.count - 1
        words = f"{block.count} {block.table.replace('_', ' ')}"
        yield "block", f"{block.name}: {words} {block.address}-{last}, read {when}"
    yield from _trigger_facts(block)
    if block.time is not None:
        yield "time", _time_text(block, block.time, is_function=profile.dialect.has_functions)


def _trigger_facts(block: Block) -> Iterator[tuple[str, str]]:
    match block.trigger:
        case FlagAndClear(flag=flag, new=new, clear=clear, payload=payload):
            flag += block.address
            yield "trigger", f"register {flag} is {new} when there is a sample; {clear} clears it"
            yield "payload", f"registers {_spans(block, payload)}: a change is another sample"
        case ClearOnRead(address=address, mask=mask, new=new):
            yield "trigger", f"{address} AND {mask:#06x} is {new} when there is a sample"
            yield "clears", "by being read: each sample can be read only once"
        case Counter(point=point):
            yield "trigger", f"{point} counts the samples"
        case Change(payload=payload):
            what = f"registers {_spans(block, payload)}" if payload else "any of the words"
            yield "trigger", f"a change of {what} is another sample"


def _place(block: Block, offset: int, *, is_function: bool) -> int:
    """The register, or where a register is a function, the octet of its answer."""
    if is_function:
        return offset if block.packed else 2 * offset
    return block.address + offset


def _time_text(block: Block, time: TimeSource, *, is_function: bool) -> str:
    if isinstance(time, SplitCalendar):
        names = ", ".join(name.replace("_", "/") for name, _ in time.words)
        places = ", ".join(str(block.address + offset) for _, offset in time.words)
        return f"{names} in registers {places}"
    offsets = [getattr(time, name, None) for name in ("offset", "seconds", "microseconds")]
    first = [_place(block, n, is_function=is_function) for n in offsets if n is not None]
    what = "octets" if is_function else "registers"
    return f"{type(time).__name__} in {what} from {', '.join(map(str, first))} on"


def _spans(block: Block, ranges: Sequence[tuple[int, int]]) -> str:
    return ", ".join(_span(block.address + first, words) for first, words in ranges)


def _span(address: int, words: int) -> str:
    return str(address) if words == 1 else f"{address}-{address + words - 1}"


def _rows(block: Block, point: Point, *, is_function: bool) -> Iterator[tuple[str, ...]]:
    """The point, then each of its named bits and parts."""
    order = "" if point.word_order is None else f" {point.word_order}"
    yield (
        str(_place(block, point.offset, is_function=is_function)),
        str(block.size_of(point)),
        point.name,
        f"{point.type}{order}",
        _scale_text(point),
        point.unit,
        "" if point.low is None else f"{point.low} to {point.high}",
        _title_text(point),
    )
    blank = ("",) * (len(_POINT_HEADINGS) - 2)
    for bit, name in point.bits:
        yield ("", "", name, f"bit {bit}", *blank)
    for first, size, name in point.parts:
        yield ("", "", name, f"bits {first}-{first + size - 1}", *blank)


def _scale_text(point: Point) -> str:
    """What the number in the device is multiplied with, and what is added then."""
    scale = "" if point.scale is None else str(point.scale)
    if point.add is None:
        return scale
    return f"{scale or 1} {'-' if point.add < 0 else '+'} {abs(point.add)}"


def _title_text(point: Point) -> str:
    meanings = ", ".join(f"{value} = {text}" for value, text in point.meanings)
    none = ", ".join(f"{number} = {text}" for number, text in point.sentinels)
    gate = point.valid_when
    texts = [
        f"{point.title}: {meanings}" if meanings else point.title,
        f"no measurement: {none}" if none else "",
        f"only where {gate.point} is {' or '.join(map(str, gate.values))}" if gate else "",
    ]
    return "; ".join(filter(None, texts))


def _is_documented(profile: RegisterMap) -> bool:
    """Whether its document says how it is delivered."""
    return profile.serial.is_documented or not profile.has_serial_port


def _delivered(profile: RegisterMap) -> tuple[str, str]:
    """Unit and serial line."""
    mark = "" if _is_documented(profile) else " (assumed)"
    return f"{profile.unit}{mark}", f"{_serial(profile)}{mark}"


def _serial(profile: RegisterMap) -> str:
    if not profile.has_serial_port:
        return f"TCP and UDP only, port {profile.port}"
    serial = profile.serial
    return f"{serial.baudrate} Bd {serial.bytesize}{serial.parity}{serial.stopbits}"


def _print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    if sys.stdout.isatty():
        _print_rich(headings, rows)
        return
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    for row in (headings, *rows):
        cells = [
            cell.rjust(width) if heading in _NUMERIC else cell.ljust(width)
            for heading, cell, width in zip(headings, row, widths, strict=True)
        ]
        click.echo("  ".join(cells).rstrip())


def _print_rich(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console  # noqa: PLC0415 - not needed in pipes
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in headings:
        justify: Literal["left", "right"] = "right" if heading in _NUMERIC else "left"
        no_wrap = heading not in _LONG
        table.add_column(heading, justify=justify, overflow="fold", no_wrap=no_wrap)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


def _profile_object(listed: Listed, *, blocks: bool) -> dict[str, object]:
    profile, plugin = listed
    serial = profile.serial
    found: dict[str, object] = {
        "name": profile.name,
        "title": profile.title,
        "source": profile.source,
        "package": None if plugin is None else {"name": plugin.package, "version": plugin.version},
        "unit_id": profile.unit,
        "port": profile.port,
        "serial": None
        if not profile.has_serial_port
        else {
            "baudrate": serial.baudrate,
            "bytesize": serial.bytesize,
            "parity": serial.parity,
            "stopbits": serial.stopbits,
            "silence_characters": serial.silence_characters,
        },
        "answer_limit_ns": profile.answer_limit,
        "documented": _is_documented(profile),
        "notes": list(profile.notes),
    }
    if blocks:
        found["blocks"] = [_block_object(profile, block) for block in profile.blocks]
    return found


def _block_object(profile: RegisterMap, block: Block) -> dict[str, object]:
    trigger = block.handshake
    return {
        "name": block.name,
        "message": block.message or block.name,
        "title": block.title,
        "table": block.table.value,
        "address": block.address,
        "count": block.count,
        "sample": block in profile.samples,
        "trigger": None
        if trigger is None
        else {
            "address": block.address + trigger.flag,
            "new": trigger.new,
            "clear": trigger.clear,
        },
        "points": [_point_object(block, point) for point in block.points],
    }


def _point_object(block: Block, point: Point) -> dict[str, object]:
    return {
        "name": point.name,
        "address": block.address + point.offset,
        "words": block.size_of(point),
        "type": point.type.value,
        "scale": None if point.scale is None else float(point.scale),
        "add": None if point.add is None else float(point.add),
        "unit": point.unit,
        "low": None if point.low is None else float(point.low),
        "high": None if point.high is None else float(point.high),
        "word_order": None if point.word_order is None else point.word_order.value,
        "sentinels": {str(number): text for number, text in point.sentinels},
        "valid_when": None
        if point.valid_when is None
        else {"point": point.valid_when.point, "values": list(point.valid_when.values)},
        "meanings": {str(value): text for value, text in point.meanings},
        "bits": {str(bit): name for bit, name in point.bits},
        "parts": {f"{first}-{first + n - 1}": name for first, n, name in point.parts},
        "title": point.title,
    }

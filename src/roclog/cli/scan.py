"""``roclog scan``."""

from __future__ import annotations

import asyncio
import json
import re
import sys
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from roclog.cli import output
from roclog.cli.record import duration_option
from roclog.errors import DeviceError
from roclog.quantities import format_duration

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from roclog.config import Connection, Settings
    from roclog.scan import Finding, Scan

_LONG: Final = 30 * 10**9
_SILENCE: Final = {"silent": "none", "absent": "none, says the gateway"}
_WIDEST: Final = 48
"""Characters of an answer in the table on a terminal."""


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--connection", "name", required=True, metavar="NAME", help="Where to look.")
@click.option(
    "--units",
    "wanted",
    metavar="UNITS",
    help="Only these, like 1-32,138. Default: 1-247 on serial lines, with 0 and 255 on TCP, UDP.",
)
@click.option(
    "--timeout",
    metavar="DURATION",
    callback=duration_option,
    help="Instead of the connection's. On a line a silent unit costs twice that; short ones miss "
    "devices: 150ms was seen to.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def scan(
    config: Path, *, name: str, wanted: str | None, timeout: int | None, as_json: bool
) -> None:
    """Find the units on one connection of CONFIG. No register is written, cleared or called.

    Each unit is asked for its server id (function 17), and one that is not configured for its
    device identification (function 43/14); a configured hiac-roc for its identity. A refusal shows
    as well that somebody is there. Refused where an MSX-E is.

    Ctrl-C prints what was found so far. Exit code 4: no unit answered, or the connection was lost.

    \b
    Example:
      roclog scan roclog.toml --connection hydraulics --units 1-32,138
    """
    from roclog.clock import SystemClock  # noqa: PLC0415
    from roclog.config import load  # noqa: PLC0415
    from roclog.scan import hurried, open_scan  # noqa: PLC0415

    settings = load(config)
    connection = hurried(_connection(settings, name), _positive(timeout))
    units = _units(connection, wanted)
    one = open_scan(settings, connection, units, SystemClock())
    _announce(connection, one)
    try:
        with _progress(one) as progress:
            asyncio.run(one.run(progress))
    except KeyboardInterrupt:
        one.problem = "interrupted"
        _report(one, connection, as_json=as_json)
        raise
    _report(one, connection, as_json=as_json)
    if one.problem:
        raise DeviceError(
            f"{name}: given up, {len(one.findings)} of {len(one.units)} units asked: {one.problem}"
        )
    if not any(finding.is_there for finding in one.findings.values()):
        raise DeviceError(f"{name}: no unit answered")


def _connection(settings: Settings, name: str) -> Connection:
    from roclog.config.reading import suggestion  # noqa: PLC0415
    from roclog.scan import refusal  # noqa: PLC0415

    if name not in settings.connections:
        known = ", ".join(settings.connections)
        hint = suggestion(name, settings.connections)
        text = f"{settings.path.name} has no connection {name!r}; it has {known}{hint}"
        raise click.UsageError(text)
    reason = refusal(settings, name)
    if reason:
        raise click.UsageError(reason)
    return settings.connections[name]


def _positive(timeout: int | None) -> int | None:
    if timeout is not None and timeout < 10**6:
        raise click.UsageError(f"--timeout {format_duration(timeout)} is less than 1ms")
    return timeout


def _units(connection: Connection, text: str | None) -> list[int]:
    """The units of a text like ``1-32,138``, all of them where there is none."""
    from roclog.scan import questions  # noqa: PLC0415

    if text is None:
        return list(questions(connection))
    first, last = (1, 247) if connection.is_serial else (0, 255)
    units: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"\s*([0-9]{1,3})\s*(?:-\s*([0-9]{1,3})\s*)?", part)
        if match is None:
            raise click.UsageError(f"--units: {part!r} is neither a unit nor a range like 1-32")
        low, high = int(match[1]), int(match[2] or match[1])
        if low > high:
            raise click.UsageError(f"--units: {part.strip()} ends before it begins")
        if low < first or high > last:
            place = f"{connection.name} is {connection.transport}, units there are {first}-{last}"
            raise click.UsageError(f"--units: {part.strip()} is not possible, {place}")
        units.update(range(low, high + 1))
    return sorted(units)


def _announce(connection: Connection, one: Scan) -> None:
    from roclog.scan import silent_cost  # noqa: PLC0415

    cost = silent_cost(connection)
    place = f"{connection.transport} {connection.place}"
    if connection.is_serial:
        place += f", {connection.baudrate} Bd"
    count = f"{len(one.units)} unit{'s' * (len(one.units) != 1)}"
    longest = cost * len(one.units)
    output.tell(f"{connection.name} ({place}): asking {count}, up to {_rough(longest)}")
    if longest > _LONG:
        output.tell(f"{_rough(cost)} for each that is silent; --timeout shortens that")


def _rough(nanoseconds: int) -> str:
    """A duration for people."""
    seconds = nanoseconds / 1e9
    if seconds < 10:
        return f"{seconds:.2g} s" if seconds >= 1 else f"{nanoseconds / 1e6:.3g} ms"
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min"


@contextmanager
def _progress(one: Scan) -> Iterator[Callable[[str, int, int], None]]:
    """A bar on stderr for each thing that is done, if that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import Progress  # noqa: PLC0415

    with Progress(console=Console(stderr=True), transient=True) as bar:
        tasks = {"asking": bar.add_task("asking", total=len(one.units))}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            found = sum(finding.is_there for finding in one.findings.values())
            text = f"{what}, {found} found" if what == "asking" else what
            bar.update(tasks[what], completed=done, description=text)

        yield show


def _report(one: Scan, connection: Connection, *, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(_as_object(one, connection)))
    else:
        headings = "unit", "answer", "what it is", "configured as"
        output.print_table(f"units on {connection.name}", headings, _rows(one), ["unit"])
    for line in _remarks(one):
        output.tell(line)


def _rows(one: Scan) -> list[tuple[str, str, str, str]]:
    """Who answers, what is unclear, and who is configured and does not answer."""
    alike = sorted(one.alike)
    rows = []
    for finding in _found(one):
        if finding.unit in alike[1:]:
            continue
        units = alike if finding.unit in alike else [finding.unit]
        answer = _SILENCE.get(finding.state.value) or _short(finding.answer)
        rows.append((_ranges(units), answer, finding.identity, ", ".join(finding.devices)))
    return rows


def _short(text: str) -> str:
    """On a terminal only: whoever reads a pipe wants it whole."""
    if len(text) <= _WIDEST or not sys.stdout.isatty():
        return text
    return text[: _WIDEST - 4] + " ..."


def _found(one: Scan) -> list[Finding]:
    """All but those of whom nothing was known before and nothing is now."""
    from roclog.scan import State  # noqa: PLC0415

    findings = (one.findings[unit] for unit in sorted(one.findings))
    return [f for f in findings if f.devices or f.state in (State.ANSWERS, State.UNCLEAR)]


def _ranges(units: Iterable[int]) -> str:
    """As --units takes them."""
    runs = groupby(enumerate(units), lambda pair: pair[1] - pair[0])
    ends = [[unit for _, unit in run] for _, run in runs]
    return ",".join(f"{r[0]}-{r[-1]}" if len(r) > 1 else str(r[0]) for r in ends)


def _remarks(one: Scan) -> Iterator[str]:
    """What the table does not say."""
    from roclog.scan import State  # noqa: PLC0415

    findings = one.findings.values()
    count = sum(finding.is_there for finding in findings)
    if count or one.problem:
        asked = f"the first {len(findings)} of " if len(findings) < len(one.units) else ""
        yield f"{count} of {asked}{len(one.units)} units answer"
    if one.alike:
        yield (
            f"{len(one.alike)} units say exactly the same: probably one device that answers "
            "whatever unit it is asked for"
        )
    unclear = [finding.unit for finding in findings if finding.state is State.UNCLEAR]
    if unclear:
        who = f"unit{'s' * (len(unclear) != 1)} {_ranges(sorted(unclear))}"
        yield f"unclear and not counted: {who}; what came is no whole answer of the unit asked"
    absent = sum(finding.state is State.ABSENT for finding in findings)
    if absent:
        yield f"{absent} units are not there, says the gateway"
    missing = [name for f in findings if not f.is_there for name in f.devices]
    if missing:
        yield (
            f"configured and silent: {', '.join(missing)}; `roclog check --probe` asks for the "
            "registers of every device"
        )
    if one.late_units:
        late = sorted(set(one.late_units))
        who = f"unit{'s' * (len(late) != 1)} {_ranges(late)}"
        yield (
            f"answers that came too late: {len(one.late_units)}, of {who}; a longer --timeout may "
            "find more"
        )
    if one.stray_octets:
        yield (
            f"octets beside the answers: {one.stray_octets}; noise, or a longer --timeout is needed"
        )


def _as_object(one: Scan, connection: Connection) -> dict[str, object]:
    alike = one.alike
    return {
        "schema": "roclog.scan/1",
        "connection": connection.name,
        "transport": connection.transport,
        "place": connection.place,
        "timeout_ns": connection.timeout,
        "problem": one.problem,
        "asked": sorted(one.findings),
        "late_answers": len(one.late_units),
        "late_units": sorted(set(one.late_units)),
        "stray_octets": one.stray_octets,
        "units": [
            {
                "unit": finding.unit,
                "state": finding.state.value,
                "answer": finding.answer,
                "exception": finding.exception,
                "pdu": finding.pdu.hex(),
                "identity": finding.identity,
                "identification": {str(key): text for key, text in finding.identification},
                "devices": list(finding.devices),
                "alike": finding.unit in alike,
            }
            for finding in _found(one)
        ],
    }

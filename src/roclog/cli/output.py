"""What the commands that read recordings share: opening, tables, and talk on stderr."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from roclog.quantities import format_instant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rich.console import JustifyMethod

    from roclog.recording.reader import Recording

DAMAGED: Final = 5
_MOST: Final = 20
_BINARY: Final = ("B", "KiB", "MiB", "GiB", "TiB")


def paths_argument(function: Callable[..., Any]) -> Callable[..., Any]:
    """PATH... of a recording; globs are resolved by the reader, so that quoted ones work."""
    return click.argument("paths", nargs=-1, required=True, metavar="PATH...")(function)


def time_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """--from, --to and --channel."""
    for option in (
        click.option(
            "--channel",
            "channels",
            multiple=True,
            metavar="GLOB",
            help="Only channels with such a topic, like '/roc1/*'; may be repeated.",
        ),
        click.option("--to", "end", metavar="T", help="Up to this instant, excluded."),
        click.option(
            "--from", "start", metavar="T", help="From this instant on, like 2026-11-23T06:00:00Z."
        ),
    ):
        function = option(function)
    return function


@contextmanager
def usage_errors() -> Iterator[None]:
    """What the reader takes for wrong arguments is wrong usage."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def open_paths(paths: Sequence[str]) -> Recording:
    """The recording, with wrong paths as wrong usage."""
    from roclog.recording.reader import open_recording  # noqa: PLC0415

    with usage_errors():
        return open_recording(*map(Path, paths))


def tell_problems(recording: Recording) -> None:
    """On stderr, what a reading has left out."""
    lines = [str(problem) for problem in recording.damage]
    lines += [f"{c.topic}: {c.problem}" for c in recording.channels.values() if c.problem]
    tell_some(f"left out: {line}" for line in lines)
    conflicts = recording.conflicts
    tell_some(f"two samples {c.seq} of {c.topic} differ, both are given" for c in conflicts)


def tell_some(lines: Iterable[str]) -> None:
    """The first lines on stderr, then how many more there are."""
    everything = list(lines)
    for line in everything[:_MOST]:
        tell(line)
    if len(everything) > _MOST:
        tell(f"... and {len(everything) - _MOST} more like this")


def tell(text: str) -> None:
    click.echo(f"roclog: {printable(text)}", err=True)


def printable(text: str) -> str:
    """Texts out of files come from outside: control characters are shown, not obeyed."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def instant(nanoseconds: int | None) -> str:
    """ISO 8601 to the millisecond; empty for None."""
    if nanoseconds is None:
        return ""
    return format_instant(nanoseconds // 10**6 * 10**6)


def size(octets: int) -> str:
    """Three significant digits in a binary unit."""
    amount, unit = float(octets), 0
    while amount >= 1000 and unit < len(_BINARY) - 1:
        amount, unit = amount / 1024, unit + 1
    return f"{octets} B" if unit == 0 else f"{amount:#.3g} {_BINARY[unit]}".replace(". ", " ")


def print_table(
    title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], numeric: Iterable[str] = ()
) -> None:
    """A rich table on a terminal, aligned columns elsewhere; nothing without rows."""
    if not rows:
        return
    right = frozenset(numeric)
    cells = [[printable(cell) for cell in row] for row in rows]
    if sys.stdout.isatty():
        _print_rich(title, headings, cells, right)
        return
    click.echo(f"\n{title}")
    widths = [max(map(len, column)) for column in zip(headings, *cells, strict=True)]
    for row in (headings, *cells):
        aligned = [
            cell.rjust(width) if heading in right else cell.ljust(width)
            for heading, cell, width in zip(headings, row, widths, strict=True)
        ]
        click.echo("  ".join(aligned).rstrip())


def _print_rich(
    title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], right: frozenset[str]
) -> None:
    from rich.console import Console  # noqa: PLC0415 - not needed in pipes
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    table = Table(box=None, pad_edge=False, header_style="bold", expand=False)
    for heading in headings:
        justify: JustifyMethod = "right" if heading in right else "left"
        is_name = heading == "name"  # people have to type it
        table.add_column(heading, justify=justify, no_wrap=is_name, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console = Console()
    console.print(Text(f"\n{title}", style="bold cyan"))
    console.print(table)

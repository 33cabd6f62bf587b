"""``roclog export``."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from roclog.cli import output

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from roclog.export import Format, TimeFormat


@click.command()
@output.paths_argument
@click.option(
    "--format", "form", type=click.Choice(["csv", "ndjson"]), required=True, help="Kind of file."
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    metavar="DIR",
    help="Folder for the files, made if needed.",
)
@output.time_options
@click.option(
    "--time-format",
    "times",
    type=click.Choice(["iso", "ns"]),
    default="iso",
    show_default=True,
    help="ISO 8601 UTC, or nanoseconds since 1970. NDJSON always has nanoseconds.",
)
@click.option("--raw-text", is_flag=True, help="Leave text alone that a spreadsheet would run.")
@click.option("--force", is_flag=True, help="Replace files that exist.")
def export(
    paths: tuple[str, ...],
    *,
    form: Format,
    out: Path,
    start: str | None,
    end: str | None,
    channels: tuple[str, ...],
    times: TimeFormat,
    raw_text: bool,
    force: bool,
) -> None:
    """Write recordings as CSV or NDJSON, one file for each channel: DIR/roc1.sample.csv.

    \b
    Example:
      roclog export recordings --format csv --out tables --from 2026-11-01 --channel '/roc1/*'
    """
    from roclog.export import Style  # noqa: PLC0415
    from roclog.export import export as write  # noqa: PLC0415

    recording = output.open_paths(paths)
    with output.usage_errors(), _progress() as progress:
        written = write(
            recording,
            out,
            form=form,
            channels=channels or None,
            start=start,
            end=end,
            style=Style(times=times, raw_text=raw_text),
            force=force,
            progress=progress,
        )
    for file in written:
        click.echo(f"{file.path}: {file.records} records", err=True)
    output.tell_problems(recording)


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr if that is a terminal."""
    from roclog.export import no_progress  # noqa: PLC0415

    if not sys.stderr.isatty():
        yield no_progress
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import Progress  # noqa: PLC0415

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("exporting", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)

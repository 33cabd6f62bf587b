"""``roclog plot``."""

from __future__ import annotations

from pathlib import Path

import click

from roclog.cli import output


@click.command()
@output.paths_argument
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    required=True,
    metavar="FILE",
    help="The picture, a PNG.",
)
@output.time_options
@click.option("--force", is_flag=True, help="Replace a file that exists.")
def plot(
    paths: tuple[str, ...],
    *,
    out: Path,
    start: str | None,
    end: str | None,
    channels: tuple[str, ...],
    force: bool,
) -> None:
    """Draw what recordings hold over time, a panel for each quantity, gaps shaded.

    Drawn is what has a unit or decimals; where nothing has a unit, every number.

    \b
    Example:
      roclog plot recordings --out oil.png --channel '/roc1/*' --from 2026-11-01
    """
    from roclog.plot import plot_samples  # noqa: PLC0415

    if out.exists() and not force:
        raise click.UsageError(f"{out} exists; --force replaces it")
    recording = output.open_paths(paths)
    try:
        with output.usage_errors():
            plot_samples(recording, out, channel=channels or None, start=start, end=end)
    except ImportError as error:
        text = f"{error.name} is missing; pip install 'roclog[plot]' brings it"
        raise click.UsageError(text) from error
    click.echo(out)
    output.tell_problems(recording)

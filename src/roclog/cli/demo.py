"""``roclog demo``."""

from __future__ import annotations

import asyncio
import logging
import sys
import time
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from roclog.cli import output
from roclog.cli.record import duration_option
from roclog.errors import StorageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from roclog.demo import Paths
    from roclog.recording.reader import Recording
    from roclog.recording.records import Sample
    from roclog.session import Session


@click.command()
@click.option(
    "--for",
    "duration",
    default="30s",
    metavar="DURATION",
    show_default=True,
    callback=duration_option,
    help="How long to record.",
)
@click.option(
    "--out",
    default=Path("roclog-demo"),
    type=click.Path(path_type=Path, file_okay=False),
    show_default=True,
    help="Folder to create; if it exists, a number is put behind its name.",
)
def demo(duration: int, out: Path) -> None:
    """Record simulated devices and show what comes out.

    Three particle counters and an analyser at 30 times their real speed, two of them on one serial
    line (a pseudo terminal), the others behind TCP; a pressure module on TCP and a device with
    time-stamped inputs on UDP. They are recorded as real ones would be; at the end the exported CSV
    is compared with what the simulators made. Needs no hardware, no configuration and no root.

    \b
    Example:
      roclog demo --for 10s --out /tmp/roclog-demo
    """
    from roclog.demo import Paths, run_demo  # noqa: PLC0415

    seconds = duration / 1e9
    if seconds < 3:
        raise click.UsageError("--for must be at least 3s: a simulated sample takes half a second")
    paths = Paths(_new_folder(out))
    logging.getLogger("roclog").addHandler(logging.NullHandler())
    click.echo(f"simulating six devices of four kinds, recording for {seconds:g} s", err=True)
    with _progress(seconds) as on_second:
        asyncio.run(run_demo(paths, seconds, on_second))
    exact = _report(paths)
    if not exact:
        raise click.ClickException("the recording differs from what the simulators made")


def _new_folder(wanted: Path) -> Path:
    folder = wanted
    number = 2
    while folder.exists():
        folder = wanted.with_name(f"{wanted.name}-{number}")
        number += 1
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise StorageError(folder, error.strerror or str(error)) from error
    return folder


@contextmanager
def _progress(seconds: float) -> Iterator[Callable[[Session], None]]:
    """A bar on a terminal, silence elsewhere."""
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, Progress, TextColumn  # noqa: PLC0415

    started = time.monotonic()
    columns = (BarColumn(), TextColumn("{task.percentage:3.0f}%"), TextColumn("{task.description}"))
    hidden = not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), disable=hidden) as bar:
        task = bar.add_task("", total=seconds)

        def show(session: Session) -> None:
            count = sum(device.samples for device in session.devices)
            elapsed = time.monotonic() - started
            bar.update(task, completed=elapsed, description=f"{count} samples on disk")

        yield show
        bar.update(task, completed=seconds, description="sealed")


def _report(paths: Paths) -> bool:
    """Export, plot and print the table; True where every sample is as the simulator made it."""
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from roclog.export import export  # noqa: PLC0415
    from roclog.recording.reader import open_recording  # noqa: PLC0415

    recording = open_recording(paths.recordings)
    export(recording, paths.csv, form="csv")
    table = Table(box=None, pad_edge=False)
    for heading in ("device", "made", "recorded", "identical", "cleared", "gaps", "at the end"):
        left = heading in ("device", "at the end")
        table.add_column(heading, justify="left" if left else "right")
    exact = True
    for device in sorted(recording.devices):
        row = _compared(recording, paths, device)
        exact = exact and row.exact
        table.add_row(device, *row.cells)
    Console().print(table)
    _print_paths(paths, plotted=_plot(paths))
    return exact


class _Row(NamedTuple):
    """One line of the table, and whether it is as it should be."""

    exact: bool
    cells: tuple[str, ...]


def _compared(recording: Recording, paths: Paths, device: str) -> _Row:
    from roclog.demo import READ_ON_SCHEDULE, STAMPED  # noqa: PLC0415

    if device == STAMPED:
        return _stamped(recording, paths)
    compared = _scheduled if device in READ_ON_SCHEDULE else _counter
    return compared(recording, paths, device)


def _counter(recording: Recording, paths: Paths, device: str) -> _Row:
    from roclog.demo import compare  # noqa: PLC0415

    made, equal = compare(paths.truth(device), paths.csv / f"{device}.sample.csv")
    samples = list(recording.samples(device=device))
    cleared = sum(1 for clear in recording.clears(device=device) if clear.result == "done")
    gaps = sum(1 for _ in recording.gaps(device=device))
    codes = " ".join(f"{samples[-1].values[f'iso_code_{n}']:.1f}" for n in range(1, 5))
    same = made == equal == len(samples)
    return _row(made, len(samples), str(cleared), gaps, f"ISO codes {codes}", same=same)


def _stamped(recording: Recording, paths: Paths) -> _Row:
    """Reading changes nothing in this device: there is no flag to clear."""
    from roclog.demo import STAMPED, compare_changes  # noqa: PLC0415

    made, equal = compare_changes(paths.truth(STAMPED), paths.csv)
    samples = [sample for sample in recording.samples(device=STAMPED) if "change" in sample.values]
    gaps = sum(1 for gap in recording.gaps(device=STAMPED) if not gap.possible)
    last = samples[-1].values
    text = f"input {last['address']} is {last['value']}"
    same = made == equal == len(samples)
    return _row(made, len(samples), "-", gaps, text, same=same)


def _scheduled(recording: Recording, paths: Paths, device: str) -> _Row:
    """Every answer is a sample."""
    from roclog.demo import compare_reads  # noqa: PLC0415

    made, equal = compare_reads(paths.truth(device), paths.csv, device)
    samples = list(recording.samples(device=device))
    gaps = sum(1 for _ in recording.gaps(device=device))
    same = made == equal == len(samples)
    return _row(made, len(samples), "-", gaps, _last(samples, recording), same=same)


def _last(samples: list[Sample], recording: Recording) -> str:
    """The device's own time, or the last measurements that have a unit."""
    for sample in reversed(samples):
        if sample.device_time is not None:
            return f"{sample.block} {output.instant(sample.device_time)}"
        units = recording.channels[sample.topic].units
        known = [(name, sample.values[name], unit.strip("[]")) for name, unit in units.items()]
        texts = [
            f"{name.replace('_', ' ')} {value:g} {unit}"
            for name, value, unit in known
            if isinstance(value, float) and isfinite(value)
        ]
        if texts:
            return ", ".join(texts)
    return "-"


def _row(made: int, count: int, cleared: str, gaps: int, codes: str, *, same: bool) -> _Row:
    cells = (str(made), str(count), "yes" if same else "NO", cleared, str(gaps), codes)
    return _Row(same and gaps == 0, cells)


def _plot(paths: Paths) -> bool:
    """Whether the plot could be drawn; it needs the extra ``plot``."""
    from roclog.plot import plot_samples  # noqa: PLC0415
    from roclog.recording.reader import open_recording  # noqa: PLC0415

    try:
        plot_samples(open_recording(paths.recordings), paths.plot)
    except ImportError:
        return False
    return True


def _print_paths(paths: Paths, *, plotted: bool) -> None:
    click.echo()
    click.echo(f"configuration  {paths.configuration}")
    click.echo(f"recording      {paths.recordings}")
    click.echo(f"CSV            {paths.csv}")
    click.echo(f"plot           {paths.plot if plotted else 'pip install roclog[plot] draws one'}")
    click.echo()
    click.echo(f"next: roclog info {paths.recordings}")
    click.echo(f"      roclog replay {paths.recordings} --speed 10 --channel '/roc1/*'")
    order = "--order device-time --speed max --channel '/rtu7/*'"
    click.echo(f"      roclog replay {paths.recordings} {order}")

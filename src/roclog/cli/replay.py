"""``roclog replay``."""

from __future__ import annotations

import sys
import time
from typing import Final

import click

from roclog.cli import output

MAX: Final = "max"
LOG_TIME: Final = "log-time"
DEVICE_TIME: Final = "device-time"


def _speed(context: click.Context, option: click.Parameter, value: str) -> float | None:
    """A positive number, or None for "max"."""
    if value == MAX:
        return None
    try:
        speed = float(value)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        problem = f"{value!r} is neither a number above 0 nor {MAX}"
        raise click.BadParameter(problem, context, option)
    return speed


@click.command()
@output.paths_argument
@click.option(
    "--speed",
    callback=_speed,
    default="1",
    metavar="N|max",
    help="1 is as recorded, 10 ten times as fast, max without waiting.  [default: 1]",
)
@click.option(
    "--order",
    type=click.Choice([LOG_TIME, DEVICE_TIME]),
    default=LOG_TIME,
    show_default=True,
    help="device-time: by the devices' own clocks, samples without their time by log_time. All "
    "that is selected is read into memory first; --from and --to go by log_time.",
)
@output.time_options
@click.option("--json", "as_json", is_flag=True, help="NDJSON: one object a line.")
def replay(
    paths: tuple[str, ...],
    *,
    speed: float | None,
    order: str,
    start: str | None,
    end: str | None,
    channels: tuple[str, ...],
    as_json: bool,
) -> None:
    """Print the samples of recordings in the order and at the pace they were recorded.

    Time-stamped inputs are one line for each change. With --order device-time that is the sequence
    of events, to the millisecond as the devices have it; a line without a device time says
    "host time".

    With --channel whatever such channels hold: '*/gap', '/log', '*' for everything.

    \b
    Example:
      roclog replay recordings --speed 60 --channel '/roc1/*'
      roclog replay recordings --speed max --order device-time --channel '/rtu7/*'
    """
    from roclog.recording.objects import as_line  # noqa: PLC0415
    from roclog.replay import Lines, happened_at, logged_at, paced  # noqa: PLC0415

    recording = output.open_paths(paths)
    with output.usage_errors():
        records = recording.records(
            channels or None, start=start, end=end, kinds=None if channels else ("sample",)
        )
    instant = happened_at if order == DEVICE_TIME else logged_at
    lines = Lines(recording.channels, instant)
    watched = speed is not None or sys.stdout.isatty()
    try:
        if order == DEVICE_TIME:
            records = iter(sorted(records, key=instant))
        for record in paced(records, speed, time.monotonic, time.sleep, instant):
            text = as_line(record) if as_json else output.printable(lines.line(record))
            sys.stdout.write(f"{text}\n")
            if watched:
                sys.stdout.flush()
    except KeyboardInterrupt:
        sys.stdout.flush()
        return
    output.tell_problems(recording)

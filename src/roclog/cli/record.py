"""``roclog record``."""

from __future__ import annotations

import asyncio
import logging
import sys
from pathlib import Path

import click

from roclog.quantities import parse_duration


def duration_option(_: click.Context, parameter: click.Parameter, text: str | None) -> int | None:
    """Nanoseconds of a duration given on the command line."""
    if text is None:
        return None
    try:
        return parse_duration(text)
    except ValueError as error:
        raise click.BadParameter(str(error), param=parameter) from error


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option(
    "--for",
    "duration",
    metavar="DURATION",
    callback=duration_option,
    help="Stop after this time, like 30s or 8h. Default: record until SIGINT or SIGTERM.",
)
@click.option("--quiet", is_flag=True, help="Only warnings on stderr.")
def record(config: Path, duration: int | None, *, quiet: bool) -> None:
    """Record every device of CONFIG.

    A device's flag is cleared only after its sample is on disk. SIGINT (Ctrl-C) or SIGTERM finish
    the commit in hand, seal the recording and exit 0.

    \b
    Example:
      roclog record roclog.toml --for 8h
    """
    from roclog.clock import SystemClock  # noqa: PLC0415
    from roclog.config import load  # noqa: PLC0415
    from roclog.runner import record as run  # noqa: PLC0415

    settings = load(config)
    talk_on_stderr(logging.WARNING if quiet else logging.INFO)
    where = settings.recording.directory
    count = len(settings.devices)
    what = f"{count} devices" if count > 1 else next(iter(settings.devices))
    logging.getLogger("roclog").info("recording %s into %s", what, where)
    seconds = None if duration is None else duration / 1e9
    asyncio.run(run(settings, SystemClock(), seconds))


def talk_on_stderr(level: int) -> None:
    """Events as lines on stderr, with the time."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logger = logging.getLogger("roclog")
    logger.addHandler(handler)
    logger.setLevel(level)

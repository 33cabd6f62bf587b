"""``roclog recover``."""

from __future__ import annotations

from pathlib import Path

import click

from roclog.errors import DamagedFile, StorageError


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
def recover(paths: tuple[Path, ...]) -> None:
    """Seal what a crash left below each recording directory of PATHS.

    `roclog record` does the same when it starts. Running it twice does no harm; while a recorder is
    at work in the directory, nothing is touched.

    \b
    Example:
      roclog recover recordings
    """
    from roclog.recording.directory import Directory  # noqa: PLC0415
    from roclog.recording.seal import seal  # noqa: PLC0415

    worst: DamagedFile | None = None
    for path in paths:
        if not (path / "hot").is_dir():
            raise click.UsageError(f"{path} is not a recording directory: it has no folder hot")
        directory = Directory(path)
        try:
            for hot in directory.hot_segments():
                try:
                    click.echo(f"{hot} sealed as {seal(hot, path)}")
                except DamagedFile as problem:
                    worst = problem
                    click.echo(str(problem), err=True)
                except OSError as error:
                    raise StorageError(hot, error.strerror or str(error)) from error
        finally:
            directory.release()
    if worst is not None:
        raise worst

"""``roclog verify``."""

from __future__ import annotations

import click

from roclog.cli import output


@click.command()
@output.paths_argument
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@click.pass_context
def verify(context: click.Context, paths: tuple[str, ...], *, as_json: bool) -> None:
    """Check every checksum and the sequence of the samples; list the gaps. Changes nothing.

    Exit code 0: all is there. 5: damage or gaps were found.

    \b
    Example:
      roclog verify recordings
    """
    from roclog.recording.objects import to_json  # noqa: PLC0415
    from roclog.recording.verification import as_object, lines, verify_recording  # noqa: PLC0415

    report = verify_recording(output.open_paths(paths))
    if as_json:
        click.echo(to_json(as_object(report)))
    else:
        for line in lines(report):
            click.echo(output.printable(line))
    if not report.is_good:
        context.exit(output.DAMAGED)

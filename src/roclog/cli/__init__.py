"""The command ``roclog``: sub-commands by name, errors as exit codes and lines on stderr."""

from __future__ import annotations

import errno
import os
import sys
import traceback
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from roclog.errors import (
    ConfigError,
    DamagedFile,
    DeviceError,
    RegisterMapError,
    RoclogError,
    StorageError,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

UNEXPECTED: Final = 1
CONFIGURATION: Final = 3
NO_DEVICE: Final = 4
DAMAGE: Final = 5
STORAGE: Final = 6
INTERRUPTED: Final = 130
PIPE_CLOSED: Final = 141
"""Exit codes; 0 is done and 2 is click's for wrong usage. The last two are 128 + the signal."""

_CODES: Final = (
    (ConfigError, CONFIGURATION),
    (RegisterMapError, CONFIGURATION),
    (DeviceError, NO_DEVICE),
    (DamagedFile, DAMAGE),
    (StorageError, STORAGE),
    (RoclogError, UNEXPECTED),
)
_DISK: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})


class Entry(NamedTuple):
    """A sub-command: it is the attribute of its name in the module ``roclog.cli.<name>``."""

    name: str
    help: str


COMMANDS: Final = (
    Entry("demo", "Record simulated devices and show what comes out."),
    Entry("init", "Write a commented configuration."),
    Entry("check", "Validate CONFIG and show what will be recorded."),
    Entry("scan", "Find the units on one connection of CONFIG."),
    Entry("read", "Read every block of DEVICE once and print it decoded."),
    Entry("record", "Record every device of CONFIG."),
    Entry("device", "Change what a device itself is set to."),
    Entry("info", "Show what recordings hold."),
    Entry("replay", "Print the samples of recordings in time order."),
    Entry("export", "Write recordings as CSV or NDJSON."),
    Entry("plot", "Draw recordings as a picture."),
    Entry("verify", "Check every checksum of recordings."),
    Entry("recover", "Seal what a crash left behind."),
    Entry("simulate", "Serve simulated devices."),
    Entry("profiles", "Show the register maps, built in and of plug-ins."),
    Entry("decode", "Show what raw words mean, in every type and order."),
)
"""In the order of the help. The text is here so that the help imports no sub-command."""


class Commands(click.Group):
    """Imports a sub-command when it is called, and reports what it raises."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return [entry.name for entry in COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        command = getattr(import_module(f"roclog.cli.{cmd_name}"), cmd_name)
        return command if isinstance(command, click.Command) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(entry.name, entry.help) for entry in COMMANDS])

    def invoke(self, ctx: click.Context) -> Any:
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except BrokenPipeError:
            _close_pipe()
            ctx.exit(PIPE_CLOSED)
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)
        except Exception as error:  # noqa: BLE001 - the last place where it can be reported
            code = report(error, debug=ctx.params["debug"])
            _give_up_on_stdout()
            ctx.exit(code)
        return result


def report(error: Exception, *, debug: bool) -> int:
    """Tell what happened, a line for each problem, and return the exit code."""
    errors = list(_leaves(error))
    known = [(leaf, code) for leaf in errors if (code := _expected(leaf)) is not None]
    if len(known) == len(errors):
        for leaf, _ in known:
            _say(_text(leaf))
        return known[0][1]
    if debug:
        traceback.print_exception(error)
    for leaf in errors:
        _say(f"unexpected error: {type(leaf).__name__}: {leaf}")
    _say("please report this" + (", with the lines above" if debug else "; --debug shows where"))
    return UNEXPECTED


def _leaves(error: Exception) -> Iterator[Exception]:
    if isinstance(error, ExceptionGroup):
        for part in error.exceptions:
            yield from _leaves(part)
    else:
        yield error


def _expected(error: Exception) -> int | None:
    """Exit code of what is no fault of roclog's; None is one."""
    for kind, code in _CODES:
        if isinstance(error, kind):
            return code
    if isinstance(error, OSError) and (error.filename is not None or error.errno in _DISK):
        return STORAGE
    return None


def _text(error: Exception) -> str:
    if isinstance(error, OSError) and not isinstance(error, RoclogError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _say(text: str) -> None:
    for line in text.splitlines() or [""]:
        click.echo(f"roclog: {line}", err=True)


def _give_up_on_stdout() -> None:
    """What cannot be written now would change the exit code when the interpreter ends."""
    try:
        sys.stdout.flush()
    except OSError:
        _close_pipe()


def _close_pipe() -> None:
    """Nobody reads stdout any more; without this the interpreter complains when it ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # stdout is no file
        return


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--debug", is_flag=True, help="Show where an unexpected error happened.")
@click.version_option(package_name="roclog", message="%(prog)s %(version)s")
def cli(*, debug: bool) -> None:
    """Record Modbus devices in the field: every sample on disk before the device may forget it.

    \b
    Without hardware and configuration:
      roclog demo

    Exit codes: 0 done, 1 unexpected error or a device that does not do what it is told, 2 usage,
    3 configuration, 4 no device answered, 5 damage or gaps found or not everything answered,
    6 storage.
    """
    del debug


def main() -> None:
    """Run the command line of this process and end it."""
    cli.main(prog_name="roclog")

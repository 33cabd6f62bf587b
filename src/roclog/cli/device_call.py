"""One call of a sub-command of ``roclog device``: its device, its questions, its errors."""

from __future__ import annotations

import asyncio
import errno
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

from roclog.cli import INTERRUPTED
from roclog.cli.device_output import print_who
from roclog.cli.output import tell
from roclog.clock import SystemClock
from roclog.commanding.talk import NotDone, Target, look
from roclog.config import load
from roclog.config.reading import suggestion
from roclog.errors import DeviceError, LinkDown

if TYPE_CHECKING:
    from collections.abc import Coroutine
    from pathlib import Path

    from roclog.commanding.talk import State
    from roclog.register_map import RegisterMap

T = TypeVar("T")

_TAKEN: Final = (errno.EBUSY, errno.EWOULDBLOCK)


@dataclass(frozen=True)
class Call:
    """One call of a sub-command. config: as the user wrote it. yes: nothing is asked."""

    config: Path
    target: Target
    as_json: bool
    yes: bool = False

    @property
    def name(self) -> str:
        return self.target.device.name

    @property
    def profile(self) -> RegisterMap:
        return self.target.device.profile

    def command(self, name: str) -> str:
        """How to call another sub-command for the device."""
        return f"`roclog device {name} {self.config} {self.name}`"

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Its result; a DeviceError or NotDone names the device."""
        try:
            return asyncio.run(work)
        except NotDone as error:
            raise NotDone(f"{self.name}: {error}") from error
        except DeviceError as error:
            more = ""
            cause = error.__cause__ if isinstance(error, LinkDown) else None
            if isinstance(cause, OSError) and cause.errno in _TAKEN:
                more = "; a port belongs to one program at a time: "
                more += "if that is `roclog record`, stop it first"
            raise DeviceError(f"{self.name}: {error}{more}") from error

    def look(self) -> State:
        """The device as it is now, after a line for people that says who it is."""
        state = self.run(look(self.target))
        if not self.as_json:
            print_who(self.target, state)
        return state

    def note(self, text: str) -> None:
        """Talk on stderr, which JSON has in its object or does without."""
        if not self.as_json:
            tell(text)

    def ask(self, question: str) -> None:
        """Ends the command where people do not agree."""
        try:
            agreed = self.yes or click.confirm(question, err=True)
        except click.Abort:  # Ctrl-C or Ctrl-D
            click.echo(err=True)
            tell(f"{self.name}: interrupted; nothing was sent")
            raise click.exceptions.Exit(INTERRUPTED) from None
        if not agreed:
            tell(f"{self.name}: nothing was sent")
            raise click.exceptions.Exit(0)


def find_target(config: Path, name: str) -> Target:
    settings = load(config)
    if name not in settings.devices:
        known = ", ".join(settings.devices) + suggestion(name, settings.devices)
        raise click.UsageError(f"{config} has no device {name!r}; it has {known}")
    return Target(settings, settings.devices[name], SystemClock())


def find_writable(config: Path, name: str, *commands: str) -> Target:
    """A device that has settings, and these commands."""
    target = find_target(config, name)
    profile = target.device.profile
    if profile.writable is None:
        text = f"profile {profile.name} declares no settings and no commands"
        raise click.UsageError(f"{name}: {text}: nothing can be changed there")
    for command in commands:
        if profile.writable.command(command) is None:
            raise click.UsageError(f"{name}: profile {profile.name} declares no {command}")
    return target


def asking_call(config: Path, name: str, *commands: str, yes: bool, as_json: bool) -> Call:
    """Before anything is sent: whether the question can be asked at all."""
    call = Call(config, find_writable(config, name, *commands), as_json, yes)
    if as_json and not yes:
        raise click.UsageError("--json asks no questions: add --yes")
    if not (yes or (sys.stdin.isatty() and sys.stdout.isatty())):
        raise click.UsageError("this asks before it writes, and there is no terminal: add --yes")
    return call

"""How every sub-command of ``roclog device`` ends: its JSON, its errors, and being told to stop."""

from __future__ import annotations

import json
import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import click

from roclog.cli.output import tell
from roclog.errors import RoclogError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from types import FrameType

TERMINATED: Final = 143
"""Exit code: 128 + SIGTERM."""
_PRINTED: Final = "roclog.device.printed"
_SENT: Final = "roclog.device.sent"


class DeviceCommand(click.Command):
    """Gives one JSON object whatever happens, and tells what had left when it was stopped."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with _stopped_by_sigterm():
                return super().invoke(ctx)
        except (RoclogError, click.UsageError) as error:
            text = str(error) if isinstance(error, RoclogError) else error.format_message()
            _print_problems(ctx, text.splitlines())
            raise
        except (KeyboardInterrupt, SystemExit):
            sent = ctx.meta.get(_SENT, lambda: "nothing was written")()
            text = f"{ctx.params['device']}: interrupted; {sent}"
            tell(text)
            _print_problems(ctx, [text])
            raise


class DeviceGroup(click.Group):
    """The sub-commands of ``roclog device``."""

    command_class = DeviceCommand


def print_object(found: Mapping[str, object]) -> None:
    """The one JSON object of this call."""
    click.get_current_context().meta[_PRINTED] = True
    click.echo(json.dumps(found, default=bytes.hex))


def remember_sent(text: Callable[[], str]) -> None:
    """From now on something may leave. text: what has, for who interrupts it."""
    click.get_current_context().meta[_SENT] = text


def _print_problems(ctx: click.Context, problems: list[str]) -> None:
    """Where no object has told them."""
    if ctx.params.get("as_json") and not ctx.meta.get(_PRINTED):
        schema = f"roclog.device.{ctx.info_name}/1"
        found = {"schema": schema, "device": ctx.params["device"], "problems": problems}
        click.echo(json.dumps(found))


@contextmanager
def _stopped_by_sigterm() -> Iterator[None]:
    """SIGTERM stops in order, as Ctrl-C does. SystemExit ends an event loop as well."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _stop(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(TERMINATED)

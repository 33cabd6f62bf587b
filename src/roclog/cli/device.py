"""``roclog device``: who a device is, what it is set to, and the few things people change there."""

from __future__ import annotations

import asyncio
import errno
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import click

from roclog.cli.output import tell
from roclog.errors import DeviceError, LinkDown
from roclog.quantities import format_duration, parse_duration

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from roclog.clock import Clock
    from roclog.commanding import Outcome, State
    from roclog.config.settings import Device, Settings
    from roclog.device_settings import Plan
    from roclog.register_map import RegisterMap

T = TypeVar("T")

_TAKEN: Final = (errno.EBUSY, errno.EWOULDBLOCK)
_JSON: Final = "One JSON object on stdout."
_NOT_SAVED: Final = "after a loss of power or a reset the old values are back"


class Target(NamedTuple):
    """What CONFIG and DEVICE name. config: as the user wrote it."""

    config: Path
    settings: Settings
    device: Device
    clock: Clock

    @property
    def profile(self) -> RegisterMap:
        return self.device.profile

    @property
    def place(self) -> str:
        return self.settings.connections[self.device.connection].place

    def command(self, name: str) -> str:
        """How to call another sub-command for it."""
        return f"roclog device {name} {self.config} {self.device.name}"


def _arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    function = click.argument("device")(function)
    return click.argument("config", type=click.Path(path_type=Path))(function)


def _asking(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options of what changes a device."""
    function = click.option("--json", "as_json", is_flag=True, help=f"{_JSON} Needs --yes.")(
        function
    )
    return click.option("--yes", is_flag=True, help="Do not ask; for scripts.")(function)


def _duration(_: click.Context, parameter: click.Parameter, text: str) -> int:
    try:
        return parse_duration(text)
    except ValueError as error:
        raise click.BadParameter(str(error), param=parameter) from error


@click.group()
def device() -> None:
    """Change what a device itself is set to.

    Everything is shown before it is done and read back afterwards. Nothing is written blindly a
    second time. `record` never does any of this.

    Which settings and commands there are is part of the register map of a profile: hiac-roc has
    them.

    \b
    Example:
      roclog device get roclog.toml roc1
      roclog device set roclog.toml roc1 sample_period=20s hold_period=10s
      roclog device save roclog.toml roc1
    """


@device.command("identify")
@_arguments
@click.option("--json", "as_json", is_flag=True, help=_JSON)
def identify_command(config: Path, device: str, *, as_json: bool) -> None:
    """Print who DEVICE says it is. Nothing is written.

    \b
    Example:
      roclog device identify roclog.toml roc1
    """
    from roclog.cli.device_output import identity_object, print_identity  # noqa: PLC0415
    from roclog.commanding import read_identity  # noqa: PLC0415

    target = _target(config, device)
    if not target.profile.identity:
        text = f"devices of profile {target.profile.name} do not say who they are"
        raise click.UsageError(f"{device}: {text}")
    words = _run(read_identity(target.settings, device, target.clock))
    if as_json:
        click.echo(json.dumps(identity_object(target.device, words)))
    else:
        print_identity(target.device, words)


@device.command("get")
@_arguments
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--json", "as_json", is_flag=True, help=_JSON)
def get_command(config: Path, device: str, *, names: tuple[str, ...], as_json: bool) -> None:
    """Print the settings of DEVICE, all or those with a NAME. Nothing is written.

    \b
    Example:
      roclog device get roclog.toml roc1
      roclog device get roclog.toml roc1 sample_period hold_period
    """
    from roclog.cli.device_output import print_settings, settings_object  # noqa: PLC0415
    from roclog.device_settings import describe  # noqa: PLC0415

    target = _target(config, device, has_settings=True)
    _check_names(target, names)
    state = _look(target)
    chosen = [s for s in describe(target.profile, state.words) if not names or s.name in names]
    if as_json:
        click.echo(json.dumps(settings_object(target.device, state, chosen)))
    else:
        _say_who(target, state, err=False)
        print_settings(target.profile, chosen)


@device.command("set")
@_arguments
@click.argument("changes", nargs=-1, required=True, metavar="NAME=VALUE...")
@click.option(
    "--save", is_flag=True, help="Save as well, once everything reads back as it was set."
)
@_asking
def set_command(
    config: Path, device: str, *, changes: tuple[str, ...], save: bool, yes: bool, as_json: bool
) -> None:
    """Change settings of DEVICE, and read them back.

    Times are written as 90s, 2min or 01:30 (MM:SS), choices as their number or their word, days as
    MM-DD. What the register map does not allow is refused before anything is sent.

    A device keeps changed settings only until it loses its power, unless they are saved: with
    --save, or later with `roclog device save`.

    The HIAC ROC: `clock=now` or `clock=2026-11-23T06:00:00Z` sets registers 101-104, which its
    document calls writable and unused. limit_1 to limit_4 are the numbers in the registers (180,
    not 18.0), or none, 00, 000. node_id is the unit in the configuration, which has to be changed
    there as well.

    \b
    Example:
      roclog device set roclog.toml roc1 sample_period=20s hold_period=10s
      roclog device set roclog.toml roc1 alarm_trigger=ISO limit_1=180 --save
    """
    from roclog.device_settings import SettingErrors, parse_settings, plan  # noqa: PLC0415

    target = _target(config, device, has_settings=True)
    _check_asking(yes=yes, as_json=as_json)
    try:
        wanted = parse_settings(target.profile, changes, target.clock.now().utc)
        _check_unit(target, wanted)
        state = _look(target)
        _check_neighbour(target, state, wanted, as_json=as_json)
        planned = plan(target.profile, wanted, state.words)
        if not as_json:
            _say_who(target, state)
            _show_plan(target, planned, state)
        if not planned.steps and not save:
            _finish(target, planned, None, as_json=as_json)
            return
        what = ("Write" if planned.steps else "Save") + (
            " and save" if save and planned.steps else ""
        )
        _ask(f"{what} this?", yes=yes)
        wanted = parse_settings(target.profile, changes, target.clock.now().utc)
        planned = plan(target.profile, wanted, state.words)  # anew, since `now` has moved on
    except SettingErrors as error:
        raise click.UsageError("\n".join(error.problems)) from error
    _change(target, state, planned, save=save, as_json=as_json)


@device.command("save")
@_arguments
@_asking
def save_command(config: Path, device: str, *, yes: bool, as_json: bool) -> None:
    """Have DEVICE keep its present settings for good.

    They are printed first: after a loss of power they are not those that were set.

    \b
    Example:
      roclog device save roclog.toml roc1
    """
    from roclog.cli.device_output import print_settings  # noqa: PLC0415
    from roclog.device_settings import Plan, describe  # noqa: PLC0415
    from roclog.writable import SAVE  # noqa: PLC0415

    target = _target(config, device, has_settings=True)
    _check_command(target, SAVE)
    _check_asking(yes=yes, as_json=as_json)
    state = _look(target)
    if not as_json:
        _say_who(target, state)
        print_settings(target.profile, describe(target.profile, state.words))
    _ask("Save these values for good?", yes=yes)
    _change(target, state, Plan((), (), ()), save=True, as_json=as_json)


@device.command("reset")
@_arguments
@click.option(
    "--wait",
    default="30s",
    show_default=True,
    metavar="DURATION",
    callback=_duration,
    help="How long it may take until it answers again.",
)
@_asking
def reset_command(config: Path, device: str, *, wait: int, yes: bool, as_json: bool) -> None:
    """Have DEVICE start anew, and wait until it answers again.

    Settings that were not saved are lost, and so is a sample that was not recorded yet.

    \b
    Example:
      roclog device reset roclog.toml roc1
    """
    from roclog.cli.device_output import outcome_object, print_outcome  # noqa: PLC0415
    from roclog.commanding import reset  # noqa: PLC0415
    from roclog.writable import RESET  # noqa: PLC0415

    target = _target(config, device, has_settings=True)
    _check_command(target, RESET)
    _check_asking(yes=yes, as_json=as_json)
    state = _look(target)
    if not as_json:
        _say_who(target, state)
        click.echo("A reset loses settings that were not saved, and a sample not recorded yet.")
    _ask("Reset it?", yes=yes)
    if not as_json:
        tell(f"waiting at most {format_duration(wait)} for {device} to answer again")
    outcome = _run(reset(target.settings, device, target.clock, state, wait))
    if as_json:
        click.echo(json.dumps(outcome_object("reset", target.device, None, outcome)))
    elif not outcome.problems:
        print_outcome(f"{device} answers again, and says that it is the same device", outcome)
    _mention_unit(target, outcome)
    _fail(target, outcome)


def _target(config: Path, name: str, *, has_settings: bool = False) -> Target:
    from roclog.clock import SystemClock  # noqa: PLC0415
    from roclog.config import load  # noqa: PLC0415

    settings = load(config)
    if name not in settings.devices:
        known = ", ".join(settings.devices)
        raise click.UsageError(f"{config} has no device {name!r}; it has {known}")
    device = settings.devices[name]
    if has_settings and device.profile.writable is None:
        text = f"profile {device.profile.name} declares no settings and no commands"
        raise click.UsageError(f"{name}: {text}: nothing can be changed there")
    return Target(config, settings, device, SystemClock())


def _check_names(target: Target, names: Sequence[str]) -> None:
    from roclog.device_settings import writable_of  # noqa: PLC0415

    known = [setting.point for setting in writable_of(target.profile).settings]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise click.UsageError(f"no setting {', '.join(unknown)}; there is {', '.join(known)}")


def _check_command(target: Target, name: str) -> None:
    from roclog.device_settings import writable_of  # noqa: PLC0415

    if writable_of(target.profile).command(name) is None:
        text = f"profile {target.profile.name} declares no {name}"
        raise click.UsageError(f"{target.device.name}: {text}")


def _check_asking(*, yes: bool, as_json: bool) -> None:
    """Before anything is sent: whether the question can be asked at all."""
    if yes:
        return
    if as_json:
        raise click.UsageError("--json asks no questions: add --yes")
    if not sys.stdin.isatty():
        raise click.UsageError("this asks before it writes, and there is no terminal: add --yes")


def _check_unit(target: Target, wanted: dict[str, int]) -> None:
    """No other device of the configuration may have the new address."""
    from roclog.device_settings import writable_of  # noqa: PLC0415

    unit = wanted.get(writable_of(target.profile).unit)
    for other in target.settings.devices.values():
        same_line = other.connection == target.device.connection
        if other.name != target.device.name and same_line and other.unit == unit:
            name = writable_of(target.profile).unit
            raise click.UsageError(f"{name}: {unit} is the unit of {other.name} on the same line")


def _check_neighbour(
    target: Target, state: State, wanted: dict[str, int], *, as_json: bool
) -> None:
    from roclog.commanding import neighbour  # noqa: PLC0415
    from roclog.device_settings import writable_of  # noqa: PLC0415

    unit = wanted.get(writable_of(target.profile).unit, state.unit)
    if unit == state.unit:
        return
    name = target.device.name
    if not as_json:
        tell(f"asking whether anybody answers to unit {unit} already")
    found = _run(neighbour(target.settings, name, target.clock, state, unit))
    if found:
        raise DeviceError(f"{name} cannot become unit {unit}: {found}; nothing was written")


def _look(target: Target) -> State:
    from roclog.commanding import look  # noqa: PLC0415

    return _run(look(target.settings, target.device.name, target.clock))


def _run(work: Coroutine[Any, Any, T]) -> T:
    try:
        return asyncio.run(work)
    except LinkDown as error:
        if isinstance(error.__cause__, OSError) and error.__cause__.errno in _TAKEN:
            text = (
                "a port belongs to one program at a time: if that is `roclog record`, stop it first"
            )
            raise LinkDown(f"{error}; {text}") from error
        raise


def _ask(question: str, *, yes: bool) -> None:
    if not yes and not click.confirm(question, err=True):
        tell("nothing was written")
        raise click.exceptions.Exit(1)


def _say_who(target: Target, state: State, *, err: bool = False) -> None:
    from roclog.cli.device_output import who  # noqa: PLC0415

    text = f"{target.device.name}: {who(target.profile, state)}, unit {state.unit}"
    click.echo(f"{text} at {target.place}", err=err)


def _show_plan(target: Target, planned: Plan, state: State) -> None:
    from roclog.cli.device_output import print_plan  # noqa: PLC0415

    print_plan(target.profile, planned, state)
    for remark in planned.remarks:
        tell(f"note: {remark}")


def _change(target: Target, state: State, planned: Plan, *, save: bool, as_json: bool) -> None:
    from roclog.commanding import change  # noqa: PLC0415

    name = target.device.name
    work = change(target.settings, name, target.clock, state, planned, save=save)
    _finish(target, planned, _run(work), as_json=as_json)


def _finish(target: Target, planned: Plan, outcome: Outcome | None, *, as_json: bool) -> None:
    """outcome: None = there was nothing to do."""
    from roclog.cli.device_output import (  # noqa: PLC0415
        kept_steps,
        outcome_object,
        print_outcome,
    )

    name = target.device.name
    if as_json:
        click.echo(
            json.dumps(
                outcome_object("set" if planned.steps else "save", target.device, planned, outcome)
            )
        )
    if outcome is None:
        return
    if not as_json and not outcome.problems:
        done = f"{name}: {len(planned.steps)} written and read back" if planned.steps else name
        saved = ", saved" if planned.steps else ": saved"
        rest = "the others are what they were" if planned.steps else "read back unchanged"
        print_outcome(f"{done}{saved if outcome.saved else ''}; {rest}", outcome)
    _mention_unit(target, outcome)
    if planned.steps and not outcome.saved and not outcome.problems:
        tell(f"not saved: {_NOT_SAVED}; `{target.command('save')}` keeps the new ones")
    kept = kept_steps(target.profile, planned, outcome)
    if outcome.problems and kept and not outcome.saved:
        tell(f"{name}: written all the same, and not saved: {', '.join(kept)}")
    _fail(target, outcome)


def _mention_unit(target: Target, outcome: Outcome) -> None:
    """Where the configuration does not name the device's address any more."""
    from roclog.device_settings import describe, writable_of  # noqa: PLC0415

    state = outcome.state
    if state is None:
        return
    device, unit = target.device, state.unit
    name = writable_of(target.profile).unit
    named = next((s.value for s in describe(target.profile, state.words) if s.name == name), unit)
    change = f"set unit = {named} of [devices.{device.name}] in {target.config}"
    if unit != device.unit:
        tell(f"{device.name} answers to unit {unit} from now on: {change}")
    elif named != device.unit:
        when = "after a reset" if outcome.saved else "once it is saved or reset"
        tell(f"{device.name} answers to unit {unit} still, maybe to {named} {when}: then {change}")


def _fail(target: Target, outcome: Outcome) -> None:
    if outcome.problems:
        raise DeviceError("\n".join(f"{target.device.name}: {text}" for text in outcome.problems))

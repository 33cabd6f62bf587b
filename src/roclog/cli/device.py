"""``roclog device``: who a device is, what it is set to, and the few things people change there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from roclog.cli.device_call import Call, asking_call, find_target, find_writable
from roclog.cli.device_command import DeviceGroup, print_object, remember_sent
from roclog.cli.device_output import (
    change_object,
    change_text,
    identity_object,
    kept_text,
    print_identity,
    print_plan,
    print_settings,
    reset_object,
    reset_text,
    sent_text,
    settings_object,
)
from roclog.cli.output import tell
from roclog.cli.record import duration_option
from roclog.commanding.change import Outcome, change, reset
from roclog.commanding.settings import (
    Plan,
    SettingErrors,
    assumed,
    describe,
    parse_settings,
    plan,
    writable_of,
)
from roclog.commanding.talk import NotDone, neighbour, read_identity
from roclog.errors import DeviceError
from roclog.quantities import format_duration
from roclog.register_map.writable import RESET, SAVE

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping, Sequence

    from roclog.commanding.talk import State

_JSON: Final = "One JSON object on stdout."


def _arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    function = click.argument("device")(function)
    return click.argument("config", type=click.Path(path_type=Path))(function)


def _asking(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options of what changes a device."""
    as_json = click.option("--json", "as_json", is_flag=True, help=f"{_JSON} Needs --yes.")
    return click.option("--yes", is_flag=True, help="Do not ask; for scripts.")(as_json(function))


@click.group(cls=DeviceGroup)
def device() -> None:
    """Change what a device itself is set to.

    Everything is shown before it is done and read back afterwards. Nothing is written blindly a
    second time. `record` never does any of this.

    Exit code 4: the device does not answer, or did not when it had to be known what became of a
    write; 1: it answers, and did not do what it was told, or is not what was shown. Ctrl-C and
    SIGTERM tell what had been sent: 130 and 143.

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
    call = Call(config, find_target(config, device), as_json)
    if not call.profile.identity:
        text = f"devices of profile {call.profile.name} do not say who they are"
        raise click.UsageError(f"{device}: {text}")
    words = call.run(read_identity(call.target))
    if as_json:
        print_object(identity_object(call.target.device, words))
    else:
        print_identity(call.target.device, words)


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
    call = Call(config, find_writable(config, device), as_json)
    known = [setting.point for setting in writable_of(call.profile).settings]
    unknown = ", ".join(name for name in names if name not in known)
    if unknown:
        raise click.UsageError(f"no setting {unknown}; there is {', '.join(known)}")
    state = call.look()
    chosen = [s for s in describe(call.profile, state.words) if not names or s.name in names]
    if as_json:
        print_object(settings_object(call.target.device, state, chosen))
    else:
        print_settings(call.profile, chosen, with_notes=bool(names))


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
    --save, or later with `roclog device save`. Either saves all that the device is set to.

    The HIAC ROC: `clock=now` or `clock=2026-11-23T06:00:00Z` (UTC without a zone) sets registers
    101-104, which its document calls writable and unused. limit_1 to limit_4 are the numbers in the
    registers (180, not 18.0), or none, 00, 000. node_id is the unit in the configuration, which has
    to be changed there as well.

    \b
    Example:
      roclog device set roclog.toml roc1 sample_period=20s hold_period=10s
      roclog device set roclog.toml roc1 alarm_trigger=ISO limit_1=180 --save
    """
    call = asking_call(config, device, *([SAVE] if save else []), yes=yes, as_json=as_json)
    now = call.target.clock.now
    try:
        wanted = parse_settings(call.profile, changes, now().utc)
        _check_unit(call, wanted)
        state = call.look()
        planned = _plan(call, changes, wanted, state)
        _check_neighbour(call, state, wanted)
        _show_plan(call, planned, state, save=save)
        if planned.steps or save:
            verb = "Write" if planned.steps else "Save"
            call.ask(f"{verb}{' and save' if save and planned.steps else ''} this?")
            wanted = parse_settings(call.profile, changes, now().utc)  # `now` has moved on
            planned = _plan(call, changes, wanted, state)
    except SettingErrors as error:
        raise click.UsageError("\n".join(error.problems)) from error
    _change(call, state, planned, "set", save=save)


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
    call = asking_call(config, device, SAVE, yes=yes, as_json=as_json)
    state = call.look()
    if not as_json:
        print_settings(call.profile, describe(call.profile, state.words))
    call.ask("Save these values for good?")
    _change(call, state, Plan((), (), ()), "save", save=True)


@device.command("reset")
@_arguments
@click.option(
    "--wait",
    default="30s",
    show_default=True,
    metavar="DURATION",
    callback=duration_option,
    help="How long it may take until it answers again.",
)
@_asking
def reset_command(config: Path, device: str, *, wait: int, yes: bool, as_json: bool) -> None:
    """Have DEVICE start anew, and wait until it answers again.

    Settings that were not saved are lost, and so is a sample that was not recorded yet.

    The command has no answer. That the device was reset is known when it was silent for a while, or
    when what was not saved is gone; otherwise it is told that nothing is known, with exit code 0.

    \b
    Example:
      roclog device reset roclog.toml roc1
    """
    call = asking_call(config, device, RESET, yes=yes, as_json=as_json)
    state = call.look()
    call.note("a reset loses settings that were not saved, and a sample not recorded yet")
    call.ask("Reset it?")
    call.note(f"waiting at most {format_duration(wait)} for {device} to answer again")
    outcome = Outcome()
    _run(call, state, outcome, reset(call.target, state, outcome, wait))
    if as_json:
        print_object(reset_object(call.target.device, outcome))
    elif not outcome.problems:
        click.echo(f"{device} {reset_text(outcome)}")
    _conclude(call, outcome)


def _plan(call: Call, changes: Sequence[str], wanted: Mapping[str, int], state: State) -> Plan:
    """With what was taken for granted, for people to see."""
    found = plan(call.profile, wanted, state.words)
    return found._replace(remarks=(*assumed(changes), *found.remarks))


def _check_unit(call: Call, wanted: dict[str, int]) -> None:
    """No other device of the configuration may have the new address."""
    own = call.target.device
    name = writable_of(call.profile).unit
    unit = wanted.get(name, own.unit)
    for other in call.target.settings.devices.values():
        if other.connection == own.connection and other.unit == unit != own.unit:
            text = f"{unit} is the unit of {other.name} on the same line"
            raise click.UsageError(f"{name}: {text}")


def _check_neighbour(call: Call, state: State, wanted: dict[str, int]) -> None:
    unit = wanted.get(writable_of(call.profile).unit, state.unit)
    if unit == state.unit:
        return
    call.note(f"asking whether anybody answers to unit {unit} already")
    found = call.run(neighbour(call.target, state, unit))
    if found:
        text = f"cannot become unit {unit}: {found}; nothing was written"
        raise NotDone(f"{call.name} {text}")


def _show_plan(call: Call, planned: Plan, state: State, *, save: bool) -> None:
    if not call.as_json:
        print_plan(call.profile, planned, state)
    for remark in planned.remarks:
        call.note(f"note: {remark}")
    if save:
        call.note(f"note: saving keeps all that {call.command('get')} shows, not only these")


def _change(call: Call, state: State, planned: Plan, what: str, *, save: bool) -> None:
    outcome = Outcome(state)
    if planned.steps or save:
        _run(call, state, outcome, change(call.target, state, planned, outcome, save=save))
    if call.as_json:
        print_object(change_object(what, call.target.device, planned, outcome))
    elif not outcome.problems and (planned.steps or save):
        click.echo(f"{call.name}: {change_text(planned, outcome)}")
    if outcome.problems:
        kept = kept_text(call.profile, state, outcome)
        if kept:
            tell(f"{call.name}: {kept}")
    elif planned.steps and not save:
        lost = "after a loss of power or a reset the old values are back"
        tell(f"not saved: {lost}; {call.command('save')} keeps the new ones")
    _conclude(call, outcome)


def _run(call: Call, state: State, outcome: Outcome, work: Coroutine[Any, Any, None]) -> None:
    """Who interrupts it is told what has left so far."""

    def sent() -> str:
        text = sent_text(call.profile, state, outcome)
        return f"{text}; {call.command('get')} shows what it holds"

    remember_sent(sent)
    call.run(work)


def _conclude(call: Call, outcome: Outcome) -> None:
    """What is to be known besides, and what went wrong."""
    for remark in outcome.remarks:
        call.note(f"note: {remark}")
    _mention_unit(call, outcome)
    if outcome.problems:
        kind = DeviceError if outcome.lost else NotDone
        raise kind("\n".join(f"{call.name}: {text}" for text in outcome.problems))


def _mention_unit(call: Call, outcome: Outcome) -> None:
    """Where the configuration does not name the device's address any more, or soon will not."""
    state, own = outcome.state, call.target.device
    if state is None:
        return
    change = f"of [devices.{own.name}] in {call.config}"
    name = writable_of(call.profile).unit
    written = next((step.new for step in outcome.sent if step.name == name), own.unit)
    if state.unit != own.unit:
        now = f"{own.name} answers to unit {state.unit} from now on"
        tell(f"{now}: set unit = {state.unit} {change}")
    elif written != own.unit:
        when = "after a reset" if outcome.done else "once it is saved and reset"
        still = f"{own.name} answers to unit {own.unit} still, maybe to {written} {when}"
        tell(f"{still}: then set unit = {written} {change}")

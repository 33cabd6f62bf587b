"""What ``roclog device`` prints, as tables and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from roclog.cli.output import print_table, printable, tell
from roclog.commanding.settings import describe, expected, setting_block
from roclog.commanding.talk import identity_blocks
from roclog.decode import decode, named_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.commanding.change import Outcome
    from roclog.commanding.settings import Plan, Shown, Step
    from roclog.commanding.talk import State, Target
    from roclog.config.settings import Device
    from roclog.decode import Value
    from roclog.register_map import Block, Point, RegisterMap

_HEADINGS = ("register", "raw", "name", "value", "meaning", "may be")
_PLAN_HEADINGS = ("register", "name", "is", "will be", "word")
_NUMERIC = ("register", "raw", "word")


def print_who(target: Target, state: State) -> None:
    """The identity in one line."""
    device = target.device
    values = _identity_values(device.profile, state.identity)
    said = (str(values[block][name]).strip() for block, name in device.profile.identity)
    text = printable(" ".join(filter(None, said)) or "does not say who it is")
    place = target.settings.connections[device.connection].place
    click.echo(f"{device.name}: {text}, unit {state.unit} at {place}")


def print_identity(device: Device, words: Sequence[Sequence[int]]) -> None:
    values = _identity_values(device.profile, words)
    for block in identity_blocks(device.profile):
        rows = [
            _identity_row(block, point, values[block.name][point.name]) for point in block.points
        ]
        print_table(block.title or block.name, ("register", "name", "value", ""), rows, _NUMERIC)


def identity_object(device: Device, words: Sequence[Sequence[int]]) -> dict[str, object]:
    values = _identity_values(device.profile, words)
    return {
        **_head("identify", device, device.unit),
        "problems": [],
        "identity": {name: value for block in values.values() for name, value in block.items()},
    }


def print_settings(
    register_map: RegisterMap, settings: Sequence[Shown], *, with_notes: bool = False
) -> None:
    """with_notes: all that the document says of them, else only of values of several readings."""
    block = setting_block(register_map)
    rows = [
        (str(s.address), f"{s.word:04X}", s.name, _value(s), _meaning(s), s.allowed)
        for s in settings
    ]
    print_table(block.title or block.name, _HEADINGS, rows, _NUMERIC)
    _tell_remarks([s for s in settings if with_notes or s.readings])


def settings_object(device: Device, state: State, settings: Sequence[Shown]) -> dict[str, object]:
    return {
        **_head("get", device, state.unit),
        "problems": [],
        "settings": [_setting_object(setting) for setting in settings],
    }


def print_plan(register_map: RegisterMap, plan: Plan, state: State) -> None:
    """What will be written, and what need not be."""
    after = describe(register_map, expected(register_map, state.words, plan.steps))
    then = {setting.name: setting for setting in after}
    now = {setting.name: setting for setting in describe(register_map, state.words)}
    rows = [
        (str(s.address), s.name, _full(now[s.name]), _full(then[s.name]), f"{s.new:04X}")
        for s in plan.steps
    ]
    print_table("To be written, in this order", _PLAN_HEADINGS, rows, _NUMERIC)
    for name in plan.already:
        click.echo(f"{name} is {_full(now[name])} already, and is not written")


def change_text(plan: Plan, outcome: Outcome) -> str:
    """What was done, where all went well."""
    saved = ", saved" if outcome.done else ""
    if not plan.steps:
        return "saved; read back unchanged"
    return f"{len(plan.steps)} written and read back{saved}; the others are what they were"


def kept_text(register_map: RegisterMap, before: State, outcome: Outcome) -> str:
    """What was written before something went wrong; empty where nothing was, or all is saved."""
    if outcome.state is None:
        return sent_text(register_map, before, outcome)
    first = setting_block(register_map).address
    held = outcome.state.words
    steps = [step for step in outcome.sent if held[step.address - first] == step.new]
    if not steps or outcome.done:
        return ""
    saved = "not saved" if outcome.done is False else "perhaps saved"
    return f"written all the same, and {saved}: {_step_texts(register_map, before, steps)}"


def sent_text(register_map: RegisterMap, before: State, outcome: Outcome) -> str:
    """What has left, where nothing was read back."""
    sent = [_step_texts(register_map, before, outcome.sent)] if outcome.sent else []
    if outcome.done is not False:
        sent.append("the command to save" if outcome.sent else "the command")
    return f"sent, and not read back: {', '.join(sent)}" if sent else "nothing was written"


def _step_texts(register_map: RegisterMap, before: State, steps: Sequence[Step]) -> str:
    after = describe(register_map, expected(register_map, before.words, steps))
    texts = {setting.name: setting.text for setting in after}
    return ", ".join(f"{step.name} {texts[step.name]}" for step in steps)


def change_object(what: str, device: Device, plan: Plan, outcome: Outcome) -> dict[str, object]:
    """saved: None = not known."""
    steps = plan.steps
    return {
        **_outcome_object(what, device, outcome),
        "wanted": [
            {"name": s.name, "register": s.address, "old": s.old, "new": s.new} for s in steps
        ],
        "already": list(plan.already),
        "saved": outcome.done,
        "remarks": [*plan.remarks, *outcome.remarks],
    }


def reset_text(outcome: Outcome) -> str:
    """What is known, where nothing went wrong."""
    same = "and says that it is the same device"
    if outcome.done:
        return f"was reset, {same}"
    return f"answers, {same}; whether it was reset is not known"


def reset_object(device: Device, outcome: Outcome) -> dict[str, object]:
    """done: None = not known."""
    return {**_outcome_object("reset", device, outcome), "done": outcome.done}


def _outcome_object(what: str, device: Device, outcome: Outcome) -> dict[str, object]:
    """unit, settings: None = the device could not be read afterwards."""
    state = outcome.state
    settings = describe(device.profile, state.words) if state else []
    return {
        **_head(what, device, state.unit if state else None),
        "remarks": outcome.remarks,
        "problems": outcome.problems,
        "settings": [_setting_object(setting) for setting in settings] if state else None,
    }


def _head(what: str, device: Device, unit: int | None) -> dict[str, object]:
    return {
        "schema": f"roclog.device.{what}/1",
        "device": device.name,
        "profile": device.profile.name,
        "unit": unit,
    }


def _identity_values(
    register_map: RegisterMap, words: Sequence[Sequence[int]]
) -> dict[str, dict[str, Value | None]]:
    blocks = identity_blocks(register_map)
    return {
        block.name: named_values(block, decode(block, own))
        for block, own in zip(blocks, words, strict=True)
    }


def _identity_row(block: Block, point: Point, value: Value | None) -> tuple[str, ...]:
    meaning = dict(point.meanings).get(value, "") if isinstance(value, int) else ""
    text = "-" if value is None else str(value)
    return str(block.address + point.offset), point.name, text, meaning or point.title


def _value(setting: Shown) -> str:
    """With its unit; MM:SS needs none."""
    return setting.text if ":" in setting.text else f"{setting.text} {setting.unit}".rstrip()


def _meaning(setting: Shown) -> str:
    readings = []
    for reading in setting.readings:
        outside = ", out of range," if reading.inside is False else ""
        readings.append(f"{reading.value:f} {reading.name}{outside}")
    parts = [setting.meaning, " or ".join(readings).removesuffix(",")]
    if setting.doubtful:
        parts.append("outside what the document gives")
    return "; ".join(part for part in parts if part)


def _full(setting: Shown) -> str:
    meaning = _meaning(setting)
    return f"{setting.text}: {meaning}" if meaning else setting.text


def _tell_remarks(settings: Sequence[Shown]) -> None:
    for remark in dict.fromkeys(s.remark for s in settings if s.remark):
        tell(f"note: {remark}")


def _setting_object(setting: Shown) -> dict[str, object]:
    given = setting._asdict()
    readings = [
        {"reading": r.name, "value": float(r.value), "inside": r.inside} for r in setting.readings
    ]
    return {
        "name": given.pop("name"),
        "register": given.pop("address"),
        "raw": given.pop("word"),
        **given,
        "readings": readings,
    }

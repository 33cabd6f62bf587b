"""What ``roclog device`` prints, as tables and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from roclog.cli.output import print_table, printable, tell
from roclog.commanding import identity_blocks
from roclog.decode import decode, named_values
from roclog.device_settings import describe, expected, setting_block

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roclog.commanding import Outcome, State
    from roclog.config.settings import Device
    from roclog.decode import Value
    from roclog.device_settings import Plan, Shown
    from roclog.register_map import Block, Point, RegisterMap

_HEADINGS = ("register", "raw", "name", "value", "unit", "meaning", "may be")
_PLAN_HEADINGS = ("register", "name", "is", "will be", "word")
_NUMERIC = ("register", "raw", "word")


def who(register_map: RegisterMap, state: State) -> str:
    """The identity in one line."""
    values = _identity_values(register_map, state.identity)
    said = (str(values[block][name]).strip() for block, name in register_map.identity)
    return printable(" ".join(text for text in said if text) or "does not say who it is")


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
        "schema": "roclog.device.identify/1",
        "device": device.name,
        "profile": device.profile.name,
        "unit": device.unit,
        "identity": {name: value for block in values.values() for name, value in block.items()},
    }


def print_settings(register_map: RegisterMap, settings: Sequence[Shown]) -> None:
    block = setting_block(register_map)
    rows = [
        (str(s.address), f"{s.word:04X}", s.name, s.text, _unit(s), _meaning(s), s.allowed)
        for s in settings
    ]
    print_table(block.title or block.name, _HEADINGS, rows, _NUMERIC)
    _tell_remarks(settings)


def settings_object(device: Device, state: State, settings: Sequence[Shown]) -> dict[str, object]:
    return {
        "schema": "roclog.device.get/1",
        "device": device.name,
        "profile": device.profile.name,
        "unit": state.unit,
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


def print_outcome(text: str, outcome: Outcome) -> None:
    click.echo(text)
    for remark in outcome.remarks:
        tell(f"note: {remark}")


def kept_steps(register_map: RegisterMap, plan: Plan, outcome: Outcome) -> list[str]:
    """The settings of a plan that the device holds now, with their value."""
    if outcome.state is None:
        return []
    held = {setting.name: setting for setting in describe(register_map, outcome.state.words)}
    steps = [step for step in plan.steps if held[step.name].word == step.new]
    return [f"{step.name} {held[step.name].text}" for step in steps]


def outcome_object(
    what: str, device: Device, plan: Plan | None, outcome: Outcome | None
) -> dict[str, object]:
    """outcome: None = there was nothing to do."""
    state = outcome.state if outcome else None
    steps = plan.steps if plan else ()
    return {
        "schema": f"roclog.device.{what}/1",
        "device": device.name,
        "profile": device.profile.name,
        "unit": state.unit if state else None,
        "wanted": [
            {"name": s.name, "register": s.address, "old": s.old, "new": s.new} for s in steps
        ],
        "already": list(plan.already) if plan else [],
        "saved": outcome.saved if outcome else False,
        "remarks": [*(plan.remarks if plan else ()), *(outcome.remarks if outcome else ())],
        "problems": outcome.problems if outcome else [],
        "settings": None
        if state is None
        else [_setting_object(setting) for setting in describe(device.profile, state.words)],
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


def _unit(setting: Shown) -> str:
    """MM:SS says it itself."""
    return "" if ":" in setting.text else setting.unit


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
    return {
        "name": setting.name,
        "register": setting.address,
        "raw": setting.word,
        "value": setting.value,
        "text": setting.text,
        "unit": setting.unit,
        "meaning": setting.meaning,
        "doubtful": setting.doubtful,
        "allowed": setting.allowed,
        "readings": [
            {"reading": r.name, "value": float(r.value), "inside": r.inside}
            for r in setting.readings
        ],
        "remark": setting.remark,
    }

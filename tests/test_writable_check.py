"""Settings and commands that a register map cannot have, and the document's own."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from typing import Any

import pytest

from roclog.devices.hiac_roc import REGISTER_MAP as ROC
from roclog.devices.hiac_roc import WRITABLE
from roclog.map_check import find_flaws
from roclog.register_map.writable import Command, Range, Reading, Setting

ISO = Range(when=1, name="ISO", low=Decimal(0), high=Decimal(29))
WHOLE = (Reading(name="whole", factor=Decimal(1)),)


def setting(**more: Any) -> dict[str, Any]:
    given: dict[str, Any] = {"point": "limit_1", "selector": "alarm_trigger", "ranges": (ISO,)}
    return {"settings": (Setting(**{**given, "readings": WHOLE, **more}),), "unit": "", "clock": ()}


def command(name: str = "save", address: int = 1102, value: int = 1) -> dict[str, Any]:
    return {"commands": (Command(name=name, address=address, value=value),)}


MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "no block": ({"block": "nothing"}, "no block nothing of holding registers"),
    "block of samples": ({"block": "sample"}, "no block sample of holding registers"),
    "no point": (setting(point="nothing"), "setting nothing: no such point in the block"),
    "point twice": (
        {"settings": (*WRITABLE.settings, Setting(point="node_id"))},
        "setting node_id: named twice",
    ),
    "text": (
        {"block": "identity", **setting(point="model", selector="sensor_id")},
        "setting model: only unscaled numbers",
    ),
    "scaled": (
        {"block": "identity", **setting(point="firmware_version", selector="sensor_id")},
        "setting firmware_version: only unscaled",
    ),
    "one bound": (setting(low=Decimal(1)), "setting limit_1: low and high go together"),
    "bounds swapped": (
        setting(low=Decimal(2), high=Decimal(1)),
        "setting limit_1: 2 is larger than 1",
    ),
    "nothing bounds it": (
        setting(point="date_year", selector="", ranges=(), readings=()),
        "setting date_year: nothing says what may be written",
    ),
    "selector alone": (setting(ranges=(), readings=()), "a selector and readings need ranges"),
    "no selector": (setting(selector="nothing"), "no other point 'nothing' to select a range"),
    "its own selector": (setting(selector="limit_1"), "no other point 'limit_1'"),
    "range twice": (setting(ranges=(ISO, ISO)), "two ranges for the same number"),
    "range swapped": (
        setting(ranges=(replace(ISO, low=Decimal(30)),)),
        "range ISO: 30 is larger than 29",
    ),
    "no reading": (setting(readings=()), "ranges need a reading"),
    "reading of nothing": (
        setting(readings=(Reading(name="x", factor=Decimal(0)),)),
        "ranges need a reading, with a factor above 0",
    ),
    "unit": ({"unit": "nothing"}, "unit: nothing is not a setting"),
    "clock": ({"clock": ("date_year", "time_hour")}, "clock: must be settings for year"),
    "clock in another order": ({"clock": WRITABLE.clock[::-1]}, "clock: must be settings"),
    "command": (command("explode"), "command explode: is not one of save, reset"),
    "command twice": ({"commands": WRITABLE.commands * 2}, "command reset: named twice"),
    "command nowhere": (command(address=65536), "command save: register 65536 cannot be set"),
    "command too large": (command(value=65536), "command save: register 1102 cannot be set"),
    "command in a block": (command(address=300), "command save: register 300 is in sample"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes(name: str) -> None:
    changes, text = MISTAKES[name]
    flaws = find_flaws(replace(ROC, writable=replace(WRITABLE, **changes)))
    assert any(flaw.key == "writable" and text in flaw.text for flaw in flaws), flaws


def test_the_documents_commands() -> None:
    """Registers 1101 and 1102 of the document; there is no other, and no factory default."""
    assert find_flaws(ROC) == []
    found = {c.name: (c.address, c.value, c.answers) for c in WRITABLE.commands}
    assert found == {"reset": (1101, 0x55, False), "save": (1102, 0x5A, True)}

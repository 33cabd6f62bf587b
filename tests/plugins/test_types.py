"""Maps that no type checker has seen: what is no word is told, and every word is known."""

from __future__ import annotations

from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from roclog import register_map
from roclog.config import load
from roclog.devices import PROFILES
from roclog.map_check.types import _NAMES, type_flaws
from roclog.register_map import times, triggers, writable

EXAMPLES = Path(__file__).parents[2] / "examples"
ROC = PROFILES["hiac-roc"]
SAMPLE = ROC.samples[0]


@pytest.mark.parametrize("module", [register_map, times, triggers, writable])
def test_every_annotation_can_be_read(module: Any) -> None:
    own = [
        kind for kind in vars(module).values() if getattr(kind, "__module__", "") == module.__name__
    ]
    kinds = [kind for kind in own if isinstance(kind, type) and is_dataclass(kind)]
    assert len(kinds) > 2
    assert all(get_type_hints(kind, localns=_NAMES) for kind in kinds)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_what_a_configuration_makes_has_no_flaw(path: Path) -> None:
    devices = load(path).devices.values()
    assert devices
    for device in devices:
        assert type_flaws(device.profile) == []


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "pair": ({"cycle": ("configuration",)}, "cycle: ('configuration',) (tuple), not a tuple of 2"),
    "inner": ({"cycle": ("configuration", (1,))}, "cycle[1][0]: 1 (int), not str"),
    "none": ({"title": None}, "title: None (NoneType), not str"),
    "bool": ({"unit": True}, "unit: True (bool), not int"),
    "flag": ({"has_serial_port": 1}, "has_serial_port: 1 (int), not bool"),
    "other word": ({"serial": SAMPLE}, "serial: Block("),
    "block": ({"samples": (SAMPLE, "flow")}, "samples[1]: 'flow' (str), not Block"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_no_word_is_told(kind: str) -> None:
    changes, text = WRONG[kind]
    (flaw,) = type_flaws(replace(ROC, **changes))
    assert flaw.startswith(text)

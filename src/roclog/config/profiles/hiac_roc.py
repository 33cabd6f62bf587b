"""``profile = "hiac-roc"``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import UNSET, UnsetType

from roclog.config.profiles.device_table import Acknowledge, Cycle, DeviceTable, WordOrderKey
from roclog.devices.hiac_roc import REGISTER_MAP

if TYPE_CHECKING:
    from roclog.config.reading import Problems
    from roclog.register_map import RegisterMap


class HiacRoc(DeviceTable, kw_only=True, forbid_unknown_fields=True, tag="hiac-roc"):
    """A HIAC ROC / Filtertechnik particle counter."""

    word_order: WordOrderKey | UnsetType = UNSET
    acknowledge: Acknowledge | UnsetType = UNSET
    cycle: Cycle | UnsetType = UNSET


def register_map(table: HiacRoc, key: str, problems: Problems) -> RegisterMap:
    """The same for every such device."""
    del table, key, problems
    return REGISTER_MAP

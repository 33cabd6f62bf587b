"""The built-in register maps, by profile name."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from roclog.devices import hiac_roc, mei_timestamped, mpa_48, msx_e3317

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roclog.register_map import RegisterMap

PROFILES: Final[Mapping[str, RegisterMap]] = MappingProxyType(
    {
        register_map.name: register_map
        for register_map in (hiac_roc.REGISTER_MAP, msx_e3317.REGISTER_MAP)
    }
)
CONFIGURED: Final[Mapping[str, RegisterMap]] = MappingProxyType(
    {
        register_map.name: register_map
        for register_map in (mei_timestamped.OVERVIEW, mpa_48.OVERVIEW)
    }
)
"""Of those whose map the configuration completes, what is known before; for people, not to read
devices with."""

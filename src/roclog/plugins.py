"""Devices that other packages bring: entry points of the group ``roclog.devices``.

The name of an entry point is that of the profile, and it loads to a RegisterMap. What is installed
is read from its metadata; a package is imported only when its profile is asked for.
"""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

from roclog.errors import RegisterMapError
from roclog.map_check import find_flaws
from roclog.map_check.types import type_flaws
from roclog.register_map import RegisterMap

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP: Final = "roclog.devices"


class Plugin(NamedTuple):
    """An entry point that nobody has loaded yet."""

    name: str
    package: str
    version: str
    entry: EntryPoint

    @property
    def origin(self) -> str:
        """Package and version."""
        return f"{self.package} {self.version}"

    def __str__(self) -> str:
        return f"{self.origin}, entry point {self.name} = {self.entry.value}"


def find_plugins() -> tuple[Plugin, ...]:
    """What is installed, by name and package; nothing is imported."""
    return _find(tuple(sys.path))


def plugins_named(profile: str) -> tuple[Plugin, ...]:
    """More than one where packages collide."""
    return tuple(plugin for plugin in find_plugins() if plugin.name == profile)


@cache
def _find(path: tuple[str, ...]) -> tuple[Plugin, ...]:
    """path: where Python looks for packages, so that another one is another question."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - 10 ms that few need

    del path
    return tuple(sorted(map(_plugin, entry_points(group=GROUP)), key=lambda p: p[:3]))


def _plugin(entry: EntryPoint) -> Plugin:
    package, version = "", ""
    if entry.dist is not None:
        package, version = entry.dist.name, entry.dist.version
    return Plugin(entry.name, package or "a package without a name", version or "?", entry)


def load_plugin(profile: str) -> RegisterMap:
    """The register map of a profile that is not built in.

    Raises:
        RegisterMapError: with everything that keeps it from being used, naming the package.
        KeyError: no package has it.
    """
    plugins = plugins_named(profile)
    if not plugins:
        raise KeyError(profile)
    if len(plugins) > 1:
        text = f"{' and '.join(map(str, plugins))}: have the same name, remove all but one"
        raise RegisterMapError(profile, [text])
    return _load(plugins[0])


@cache
def _load(plugin: Plugin) -> RegisterMap:
    """A thousand devices of one profile are one look at it."""
    try:
        with redirect_stdout(sys.stderr):  # stdout is for data
            loaded = plugin.entry.load()
    except (Exception, SystemExit) as error:
        text = f"{plugin}: cannot be imported: {_told(error)}"
        raise RegisterMapError(plugin.name, [text]) from error
    problems = [f"{plugin}: {flaw}" for flaw in _plugin_flaws(plugin, loaded)]
    if problems:
        raise RegisterMapError(plugin.name, problems)
    assert isinstance(loaded, RegisterMap)
    return loaded


def _plugin_flaws(plugin: Plugin, loaded: object) -> list[str]:
    flaws = map_flaws(loaded)
    if isinstance(loaded, RegisterMap) and loaded.name != plugin.name:
        flaws.insert(0, f"name: the register map is called {loaded.name!r}, not {plugin.name!r}")
    return flaws


def map_flaws(loaded: object) -> list[str]:
    """Everything that is wrong with what should be a register map."""
    if not isinstance(loaded, RegisterMap):
        return [f"is a {type(loaded).__name__}, not a roclog.register_map.RegisterMap"]
    return type_flaws(loaded) or [str(flaw) for flaw in find_flaws(loaded)]


def _told(error: BaseException) -> str:
    """In one line that a terminal shows and does not obey."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return text if text.isprintable() else ascii(text)

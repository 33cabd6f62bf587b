"""Packages that look as if they had been installed, and one that really has been."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]


def install(source: Path, target: Path) -> None:
    """With what is on this machine: no network, and nothing beside the package."""
    quiet = ["--quiet", "--disable-pip-version-check", "--no-warn-script-location"]
    alone = ["--no-index", "--no-deps", "--no-build-isolation"]
    command = [sys.executable, "-m", "pip", "install", *quiet, *alone, "--target"]
    command += [str(target), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="session", name="install")
def installer() -> Callable[[Path, Path], None]:
    return install


@pytest.fixture(scope="session")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where ``examples/plugin`` is installed; its sources are beside, in ``source``."""
    folder = tmp_path_factory.mktemp("example")
    source = folder / "source"
    shutil.copytree(ROOT / "examples" / "plugin", source)
    install(source, folder / "site")
    return folder / "site"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Writes what an installed package leaves behind: its module and its metadata."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def write(name: str, entries: dict[str, str], module: str = "", code: str = "") -> None:
        metadata = site / f"{name.replace('-', '_')}-1.2.dist-info"
        metadata.mkdir()
        text = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n"
        (metadata / "METADATA").write_text(text)
        lines = [f"{profile} = {target}\n" for profile, target in entries.items()]
        (metadata / "entry_points.txt").write_text("[roclog.devices]\n" + "".join(lines))
        if module:
            (site / f"{module}.py").write_text(code)

    return write

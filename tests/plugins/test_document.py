"""docs/device-plugins.md: its package is built and installed, its programs run."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import roclog.testing

if TYPE_CHECKING:
    from collections.abc import Callable

TEXT = (Path(__file__).parents[2] / "docs" / "device-plugins.md").read_text()


def code(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


def test_the_page_works(install: Callable[[Path, Path], None], tmp_path: Path) -> None:
    package, table = code("toml")
    module, checks = code("python")
    source, site = tmp_path / "source", tmp_path / "site"
    source.mkdir()
    (source / "pyproject.toml").write_text(package)
    (source / "roclog_acme.py").write_text(module)
    install(source, site)
    config = tmp_path / "roclog.toml"
    config.write_text(f"[connections.plant]\ntransport = 'tcp'\nhost = '127.0.0.1'\n{table}")
    config.chmod(0o644)
    environment = os.environ | {"PYTHONPATH": str(site)}

    def run(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        done = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("-c", checks)
    assert "  roclog-acme 1.0.0  " in run("-m", "roclog", "profiles")
    assert "ACME flow meter" in run("-m", "roclog", "profiles", "acme-flow")
    assert "meter: acme-flow, unit 1 on plant" in run("-m", "roclog", "check", str(config))


def test_the_page_names_what_there_is() -> None:
    named = set(re.findall(r"^\| `(\w+)\(", TEXT, re.MULTILINE))
    assert named == set(roclog.testing.__all__) - {"Values"}
    for block in code("python"):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("roclog."):
                assert node.module in {"roclog.register_map", "roclog.testing"}

"""Every command of the README is run, in order, as its reader would; its Python as well."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
NOT_RUN = {". .venv/bin/activate", "./test"}
"""The environment of the test run is the reader's environment, and ./test is what runs this."""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


def named_files() -> dict[str, str]:
    """Files that the reader is asked to write."""
    found = re.findall(r"^`([\w.-]+)`:\n\n```\w+\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
    return dict(found)


def commands() -> list[str]:
    lines = [line for block in blocks("console") for line in block.splitlines()]
    return [line[2:].partition("  #")[0].strip() for line in lines if line.startswith("$ ")]


@pytest.mark.timeout(180)
def test_the_readme_works(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": "120",
    }
    for name, text in named_files().items():
        (tmp_path / name).write_text(text)
    background: list[subprocess.Popen[bytes]] = []
    ran = []
    try:
        for command in commands():
            if command in NOT_RUN:
                continue
            ran.append(command)
            command = re.sub(r"^\./demo$", "roclog demo", command)  # noqa: PLW2901 - set up already
            if command.endswith("&"):
                start = ["sh", "-c", f"exec {command[:-1]}"]
                background.append(subprocess.Popen(start, cwd=tmp_path, env=environment))
                continue
            wait_for_simulator = command.startswith("roclog check --probe")
            done = run(command, tmp_path, environment, patient=wait_for_simulator)
            assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    finally:
        for process in background:
            process.send_signal(signal.SIGTERM)
            process.wait(10)
    assert len(ran) >= 10
    for code in blocks("python"):
        done = run(f"{sys.executable} -", tmp_path, environment, text=code)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("\n") > 50
    assert all(process.returncode == 0 for process in background)


def run(
    command: str,
    folder: Path,
    environment: dict[str, str],
    *,
    text: str = "",
    patient: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Run in a shell; ``patient`` tries again while a background process starts."""
    for _ in range(50 if patient else 1):
        done = subprocess.run(
            ["sh", "-c", command],
            cwd=folder,
            env=environment,
            input=text,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode == 0:
            break
    return done


def test_the_promise_is_the_same_everywhere() -> None:
    design = (ROOT / "DESIGN.md").read_text()
    start = README.index("*Committed* means")
    promise = README[start : README.index("## The files")].strip()
    assert promise in design


def test_every_example_configuration_is_valid() -> None:
    from roclog.config import load  # noqa: PLC0415

    for path in sorted((ROOT / "examples").glob("*.toml")):
        assert load(path).devices

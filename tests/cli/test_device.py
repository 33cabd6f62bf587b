"""``roclog device``: what is said without any device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from roclog.cli import cli

if TYPE_CHECKING:
    from pathlib import Path

    from click.testing import Result

CONFIG = (
    '[connections.net]\ntransport = "tcp"\nhost = "127.0.0.1"\nport = 1\n'
    '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "net"\n'
)
SUBCOMMANDS = ("identify", "get", "set", "save", "reset")


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["device", *arguments], prog_name="roclog")


def test_help_names_every_sub_command() -> None:
    result = invoke("--help")
    assert result.exit_code == 0
    for name in SUBCOMMANDS:
        assert f"\n  {name} " in result.stdout


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_help_of_a_sub_command(name: str) -> None:
    result = invoke(name, "--help")
    assert result.exit_code == 0
    assert f"roclog device {name} " in result.stdout
    assert f"  roclog device {name} roclog.toml roc1" in result.stdout
    assert "--json" in result.stdout
    assert ("--yes" in result.stdout) == (name not in {"identify", "get"})


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_arguments_are_needed(name: str) -> None:
    assert invoke(name).exit_code == 2
    assert invoke(name, "roclog.toml").exit_code == 2


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_a_device_that_is_not_configured(tmp_path: Path, name: str) -> None:
    config = tmp_path / "roclog.toml"
    config.write_text(CONFIG)
    more = ("sample_period=10s",) if name == "set" else ()
    result = invoke(name, str(config), "roc2", *more)
    assert result.exit_code == 2
    assert "has no device 'roc2'; it has roc1" in result.stderr


def test_wait_is_a_duration(tmp_path: Path) -> None:
    result = invoke("reset", "roclog.toml", "roc1", "--wait", "soon")
    assert result.exit_code == 2
    assert "'soon' is not a duration" in result.stderr

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from roclog.config import Settings, load
from roclog.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def load_text(tmp_path: Path) -> Callable[[str], Settings]:
    """Settings of a configuration given as text."""

    def load_one(text: str) -> Settings:
        path = tmp_path / "roclog.toml"
        path.write_text(text, encoding="utf-8")
        path.chmod(0o644)
        return load(path)

    return load_one


@pytest.fixture
def refusal(load_text: Callable[[str], Settings]) -> Callable[[str], list[str]]:
    """All problems of a configuration that must be refused, as the lines that people see."""

    def refuse_one(text: str) -> list[str]:
        with pytest.raises(ConfigError) as caught:
            load_text(text)
        return [str(problem) for problem in caught.value.problems]

    return refuse_one

"""The files under test are made by a module of its own, so that the fuzzer can use it as well."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "lib"))


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody writes the hot segments of these tests, so waiting for more is in vain."""
    monkeypatch.setattr("roclog.recording.segment_reader.PATIENCE", 0.0)

"""What every test may use, and the rule about skipped tests."""

from __future__ import annotations

import os
import signal
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

NO_SKIPS = os.environ.get("ROCLOG_NO_SKIPS") == "1"
NOBODY = 65534


def pytest_configure() -> None:
    """Behind a shell's & SIGINT is ignored, and what the tests start would inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Where everything is installed, a skipped test is a failure."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if NO_SKIPS and reporter is not None and reporter.stats.get("skipped"):
        reporter.write_line("skipped tests are not allowed here (ROCLOG_NO_SKIPS=1)", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture
def unprivileged_path() -> Iterator[Path]:
    """A folder that an ordinary user owns; the test runs as one, whoever started it."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name)
        path.chmod(0o755)
        with _ordinary_user(path):
            yield path


@contextmanager
def _ordinary_user(path: Path) -> Iterator[None]:
    if os.geteuid() != 0:
        yield
        return
    os.chown(path, NOBODY, NOBODY)
    os.setresuid(NOBODY, NOBODY, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)

"""What may be written to a device: a 0 to register 300, or nothing at all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from bench.judge import compare
from bench.peer import Roc
from bench.recorder import Recorder
from bench.recording import csv_rows

if TYPE_CHECKING:
    from pathlib import Path

MODES: dict[str, dict[str, Any]] = {
    "plain": {},
    "plc": {"plc": True},
    "refusing": {"refuse_clear": "exception"},
    "silent": {"refuse_clear": "silent"},
    "restarting": {"reboot_at": 4},
    "torn": {"tear": True},
    "live": {"live": True},
    "faulty": {"line": "pty", "late": 0.05, "corrupt": 0.05, "drop": 0.05, "garbage": 0.05},
}
WRITES = ("clear", "write", "refused", "reset", "exception")


@pytest.mark.parametrize("acknowledge", [False, True])
def test_writes(tmp_path: Path, acknowledge: bool) -> None:
    """Every mode at once, in one recorder."""
    rocs: list[Roc] = []
    try:
        for name, options in MODES.items():
            rocs.append(Roc(tmp_path, name, cycle=0.5, samples=10**6, **options))
        device = f'poll = "100ms"\ncycle = "500ms"\nacknowledge = {str(acknowledge).lower()}'
        recorder = Recorder(tmp_path, *(roc.toml(device=device) for roc in rocs))
        with recorder.start() as child:

            def seen() -> bool:
                return all(len(roc.truth.made) >= 8 for roc in rocs)

            child.while_it_runs(seen, "eight samples of each")
            assert child.stop() == 0
        truths = {roc.name: roc.end() for roc in rocs}
    finally:
        for roc in rocs:
            roc.child.kill()
    for name, truth in truths.items():
        writes = [line for line in truth.lines if line["event"] in WRITES]
        if acknowledge:
            assert {line["event"] for line in writes} <= {"clear", "refused"}, name
            assert all(line["function"] == 6 for line in writes), name
        else:
            assert writes == [], name
    for name in ("plain", "plc", "live"):
        rows = csv_rows(recorder.directory, tmp_path / "csv", name)
        comparison = compare(rows, truths[name])
        assert comparison.clean, name
        assert comparison.found == list(range(1, len(comparison.found) + 1)), name
        assert len(comparison.found) >= 7, name


def test_settings_and_commands_are_never_written(tmp_path: Path) -> None:
    """A recorder that starts anew, loses its device and is stopped; only 300 is ever written."""
    with Roc(tmp_path, cycle=0.3, samples=10**6, reboot_at=3) as roc:
        recorder = Recorder(tmp_path, roc.toml(device='poll = "100ms"\ncycle = "300ms"'))
        for least in (2, 6):
            with recorder.start() as child:
                child.while_it_runs(lambda: len(roc.truth.cleared) >= least, "clears")  # noqa: B023
                assert child.stop() == 0
        truth = roc.end()
    assert truth.count("power") == 2
    assert truth.count("clear") >= 6
    others = [line for line in truth.lines if line["event"] in ("write", "reset", "exception")]
    assert others == []

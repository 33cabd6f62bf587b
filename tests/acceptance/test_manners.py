"""Each manner of the independent device, all in one recorder: rows are the truth, gaps the rest."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest
from bench.judge import Comparison, GapCheck, check_gaps, compare
from bench.peer import Roc
from bench.process import until
from bench.recorder import Recorder
from bench.recording import csv_rows, gaps

if TYPE_CHECKING:
    from pathlib import Path

    from bench.truth import Truth

SAMPLES = 16
MANNERS: dict[str, tuple[dict[str, Any], str]] = {
    "zeros": ({"zeros_at_start": True}, ""),
    "live": ({"live": True}, ""),
    "torn": ({"tear": True}, ""),
    "torn_flag_first": ({"tear_flag_first": True}, ""),
    "refusing": ({"refuse_clear": "exception"}, ""),
    "silent": ({"refuse_clear": "silent", "silent_effect": "no"}, 'timeout = "100ms"'),
    "silent_effect": ({"refuse_clear": "silent", "silent_effect": "yes"}, 'timeout = "100ms"'),
    "plc": ({"plc": True}, ""),
    "plc_alone": ({"plc": True}, ""),
    "identical": ({"identical_every": 4}, ""),
    "reboot": ({"reboot_at": 6}, 'timeout = "150ms"'),
    "drop_tcp": ({"drop_link_every": 1.3}, ""),
    "drop_pty": ({"line": "pty", "drop_link_every": 2.2}, ""),
}


@dataclass
class Result:
    truth: Truth
    comparison: Comparison
    gaps: GapCheck
    stderr: str


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Result]:
    folder: Path = tmp_path_factory.mktemp("manners")
    with ExitStack() as stack:
        rocs = []
        parts = []
        for number, (name, (options, connection)) in enumerate(MANNERS.items()):
            settings = {"cycle": 0.5, "samples": SAMPLES, "linger": 60, "seed": number, **options}
            roc = stack.enter_context(Roc(folder, name, **settings))
            device = 'poll = "100ms"\ncycle = "500ms"\n'
            device += "acknowledge = false\n" if name == "plc_alone" else ""
            rocs.append(roc)
            parts.append(roc.toml(connection, device))
        recorder = Recorder(folder, *parts, segment="3s")
        child = stack.enter_context(recorder.start())

        def finished() -> bool:
            return all(_last_was_read(roc) for roc in rocs)

        until(finished, "every last sample", 40)
        assert child.stop() == 0, child.talk()
        truths = {roc.name: roc.end() for roc in rocs}
        talk = child.talk()
    found = {}
    for name, truth in truths.items():
        comparison = compare(csv_rows(recorder.directory, folder / "csv", name), truth)
        check = check_gaps(comparison.missing, truth, gaps(recorder.directory, name))
        found[name] = Result(truth, comparison, check, talk)
    return found


def _last_was_read(roc: Roc) -> bool:
    reads = [line for line in roc.truth.of("read") if line["k"] == SAMPLES]
    return len([line for line in reads if line["fate"] == "ok"]) >= 3


@pytest.mark.parametrize("name", [n for n in MANNERS if not n.startswith(("reboot", "drop"))])
def test_every_sample_is_there(results: dict[str, Result], name: str) -> None:
    result = results[name]
    assert result.comparison.wrong == []
    assert result.comparison.twice == []
    assert result.comparison.missing == []
    assert result.gaps.clean, result.gaps


@pytest.mark.parametrize("name", ["reboot", "drop_tcp", "drop_pty"])
def test_what_could_not_be_read_is_told(results: dict[str, Result], name: str) -> None:
    result = results[name]
    delivered = {line["k"] for line in result.truth.of("read") if line["fate"] == "ok"}
    assert result.comparison.wrong == []
    assert result.comparison.twice == []
    assert not set(result.comparison.missing) & delivered
    assert result.gaps.uncovered == []
    assert result.comparison.found[-1] == SAMPLES
    power = [line["wall_ns"] for line in result.truth.of("power")]
    if power:  # nobody can tell a device without power from one that is out of reach
        off, on = power
        around = [gap for gap in result.gaps.empty if off - 1e9 < gap.since and gap.to < on + 4e9]
        assert result.gaps.empty == around
    else:
        assert result.gaps.empty == []

"""Another ROC stands where one stood: it is told from the first, in a run and between two."""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING, Self

import pytest
from bench.judge import compare
from bench.outage_cases import Cable
from bench.peer import Roc
from bench.process import until
from bench.recorder import Recorder
from bench.recording import csv_rows, events, gaps, items, metadata

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bench.process import Child

DEVICE = 'poll = "50ms"\ncycle = "200ms"'
LONG = 30
"""Samples of 0.2 s: longer than the 5 s in which nobody is asked again who it is."""
FIRST, SECOND = "1203270042", "1203279999"


class Bench:
    """Two counters of their own, and one address that leads to one of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.recorder: Recorder
        self.port = "0"
        self.cables: list[Cable] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for cable in self.cables:
            cable.close()

    def lead_to(self, roc: Roc) -> None:
        for cable in self.cables:
            cable.close()
        to = f"127.0.0.1:{roc.address}"
        cable = Cable(self.folder, "--tcp", f"127.0.0.1:{self.port}", "--to", to)
        self.cables.append(cable)
        self.port = cable.name
        self.recorder = Recorder(
            self.folder,
            f'[connections.net]\ntransport = "tcp"\nhost = "127.0.0.1"\nport = {self.port}\n'
            f'[devices.roc1]\nprofile = "hiac-roc"\nconnection = "net"\nunit = 138\n{DEVICE}\n',
        )

    def check(self, first: Roc, second: Roc) -> None:
        """Every sample is found under the epoch of the counter that made it."""
        directory = self.recorder.directory
        rows = csv_rows(directory, self.folder / "csv")
        epochs = list(dict.fromkeys(i.values.epoch for i in items(directory, "/roc1/sample")))
        assert len(epochs) == 2
        messages = items(directory, "/roc1/sample")
        assert len(rows) == len(messages)
        for roc, epoch in ((first, epochs[0]), (second, epochs[1])):
            own = [i for i in messages if i.values.epoch == epoch]
            assert [i.sequence for i in own] == list(range(1, len(own) + 1))
            kept = [row for row, i in zip(rows, messages, strict=True) if i.values.epoch == epoch]
            truth = roc.end()
            comparison = compare(kept, truth)
            assert (comparison.wrong, comparison.twice) == ([], [])
            assert set(truth.cleared) <= set(comparison.found)
        (text,) = events(directory, "roc1.identity")
        assert text == (
            f"another device answers: identity.serial_number {SECOND!r} instead of {FIRST!r}; "
            "a new epoch begins"
        )
        (gap,) = [gap for gap in gaps(directory, "roc1") if gap.reason == "replaced"]
        last, new = ([i.values for i in messages if i.values.epoch == epoch] for epoch in epochs)
        assert last[-1].previous_read_at <= gap.since < gap.to <= new[0].read_at
        assert gap.possible


def more(child: Child, roc: Roc, number: int) -> None:
    """Clears of that counter, beyond those so far."""
    before = len(roc.truth.cleared)
    child.while_it_runs(lambda: len(roc.truth.cleared) >= before + number, "clears")


@pytest.fixture
def pair(tmp_path: Path) -> Callable[[], tuple[Roc, Roc, Bench]]:
    def make() -> tuple[Roc, Roc, Bench]:
        first = Roc(tmp_path, "one", samples=10**6, serial_number=FIRST)
        second = Roc(tmp_path, "two", samples=10**6, serial_number=SECOND, seed=2)
        return first, second, Bench(tmp_path)

    return make


def test_changed_in_the_course_of_a_run(pair: Callable[[], tuple[Roc, Roc, Bench]]) -> None:
    first, second, bench = pair()
    with first, second, bench:
        bench.lead_to(first)
        with bench.recorder.start() as child:
            more(child, first, LONG)
            bench.lead_to(second)
            more(child, second, 6)
            assert child.stop() == 0
            assert "Traceback" not in child.talk()
        bench.check(first, second)
    # Each segment's metadata is of one counter.
    told = [
        json.loads(metadata(path)["roclog.device.roc1"]["identity"])["serial_number"]
        for path in bench.recorder.sealed()
    ]
    assert told == [FIRST, SECOND]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_changed_between_two_runs(pair: Callable[[], tuple[Roc, Roc, Bench]], number: int) -> None:
    first, second, bench = pair()
    with first, second, bench:
        bench.lead_to(first)
        with bench.recorder.start() as child:
            more(child, first, 6)
            child.stop(number)
        bench.lead_to(second)
        for _ in range(2):  # the second run knows the new one from the first
            with bench.recorder.start() as child:
                more(child, second, 4)
                child.stop(number)
        assert bench.recorder.directory.exists()
        bench.check(first, second)


def test_killed_right_after_the_change(pair: Callable[[], tuple[Roc, Roc, Bench]]) -> None:
    first, second, bench = pair()
    with first, second, bench:
        bench.lead_to(first)
        with bench.recorder.start() as child:
            more(child, first, LONG)
            bench.lead_to(second)
            log = bench.recorder.directory
            until(
                lambda: sum(path.stat().st_size > 0 for path in log.rglob("*.mcap")) > 1,
                "the segment of the second counter",
            )
            child.stop(signal.SIGKILL)
        with bench.recorder.start() as child:
            more(child, second, 3)
            assert child.stop() == 0
        directory = bench.recorder.directory
        epochs = {i.values.epoch for i in items(directory, "/roc1/sample")}
        assert len(epochs) == 2
        assert len(events(directory, "roc1.identity")) <= 1


def test_the_same_one_after_an_outage_goes_on(tmp_path: Path) -> None:
    with Roc(tmp_path, "one", samples=10**6, serial_number=FIRST) as roc, Bench(tmp_path) as bench:
        bench.lead_to(roc)
        with bench.recorder.start() as child:
            more(child, roc, LONG)
            bench.lead_to(roc)
            more(child, roc, 3)
            assert child.stop() == 0
        directory = bench.recorder.directory
        assert len({i.values.epoch for i in items(directory, "/roc1/sample")}) == 1
        assert events(directory, "roc1.identity") == []

"""A network that loses a fifth of all datagrams each way, doubles some and lets some be overtaken.

What the client sent and was sent is told by the network alone, in octets.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import pytest
from bench.judge import check_gaps, compare, excuse
from bench.msx import DECLARATIONS, Msx
from bench.peer import Roc
from bench.process import Child
from bench.recorder import Recorder
from bench.recording import csv_rows, export, gaps, items, nanoseconds, number, read_csv
from bench.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Self

    from bench.recording import Item, Row
    from bench.truth import Line

    Order = Literal["big", "little"]

_PEER: Final = Path(__file__).parents[1] / "peers/datagrams.py"
ROUGH: Final = {"lose": 0.2, "twice": 0.1, "late": 0.15, "held_for": 0.4}
TIMEOUT: Final = 60_000_000
MARGIN: Final = 2_000_000
"""Nanoseconds by which two processes may disagree on when something happened."""

CLOCK, VALUES, INFORMATION = 10500, 15300, 15450
CHANNELS: Final = {"clock": CLOCK, "values": VALUES, "information": INFORMATION}
PERIODS: Final = {CLOCK: 200_000_000, VALUES: 250_000_000, INFORMATION: 300_000_000}
"""Each far above the time-out, so that a call is never left out because others took long."""
_FUNCTION: Final = "[[devices.msx1.functions]]"
_VALUES, _INFORMATION = DECLARATIONS.split(_FUNCTION)[1:3]
MODULE: Final = _FUNCTION.join(
    (
        'poll = "200ms"\ncalls = ["clock"]\n',
        _VALUES.replace('"100ms"', '"250ms"'),
        _INFORMATION.replace('"200ms"', '"300ms"\nrepeatable = true'),
    )
)
TOLD: Final = {
    "clock": ("seconds", "microseconds"),
    "values": ("counter",),
    "information": ("serial", "text", "gain", "revision", "offset", "key", "comment"),
}
"""Fields that the module's log calls as the recording does."""

CYCLE: Final = 0.4
_READ, _WRITE = 3, 6
_FLAG: Final = 300


class Network:
    """Options are those of tests/peers/datagrams.py, by their Python names."""

    def __init__(self, folder: Path, to: int | str, **options: Any) -> None:
        self._log = folder / "network.truth.jsonl"
        command = [sys.executable, str(_PEER), "--to", f"127.0.0.1:{to}"]
        command += ["--truth", str(self._log)]
        for name, value in options.items():
            command += ["--" + name.replace("_", "-"), str(value)]
        self.child = Child(command, folder / "network")
        try:
            self.child.while_it_runs(lambda: self.child.said().endswith("\n"), "it to listen")
        except BaseException:
            self.child.kill()
            raise
        self.port = int(self.child.said().split()[1])

    @property
    def truth(self) -> Truth:
        return Truth(self._log)

    def end(self) -> Truth:
        self.child.stop()
        return self.truth

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()


@dataclass(frozen=True)
class Request:
    """As the client sent it. arrived: when its answers reached the client, and their PDUs."""

    at: int
    transaction: int
    function: int
    address: int
    second: int
    arrived: tuple[tuple[int, bytes], ...]

    @property
    def first(self) -> int | None:
        """When its first answer reached the client."""
        return min((at for at, _ in self.arrived), default=None)


class Wire:
    """What the client sent, in order, with what reached it; the device's byte order."""

    def __init__(self, truth: Truth, order: Order = "big") -> None:
        octets = {(line["way"], line["n"]): line["octets"] for line in truth.of("came")}
        back: dict[int, list[tuple[int, bytes]]] = {}
        for line in truth.of("sent"):
            if line["way"] == "answer":
                frame = bytes.fromhex(octets["answer", line["n"]])
                transaction = int.from_bytes(frame[:2], order)
                back.setdefault(transaction, []).append((line["wall_ns"], frame[7:]))
        self.requests: list[Request] = []
        for line in truth.of("came"):
            if line["way"] == "request":
                frame = bytes.fromhex(line["octets"])
                words = [int.from_bytes(frame[at : at + 2], order) for at in (0, 8, 10)]
                arrived = tuple(back.get(words[0], ()))
                sent = line["wall_ns"], words[0], frame[7], words[1], words[2], arrived
                self.requests.append(Request(*sent))

    def to(self, address: int, function: int = _READ) -> list[Request]:
        return [r for r in self.requests if (r.function, r.address) == (function, address)]


def check_that_it_was_rough(truth: Truth) -> None:
    """Every fate befell several datagrams each way, and each went on as often as it should."""
    sent = Counter((line["way"], line["n"]) for line in truth.of("sent"))
    kept = Counter((line["way"], line["n"]) for line in truth.of("kept"))
    times = {"lost": 0, "ok": 1, "late": 1, "twice": 2}
    for line in truth.of("came"):
        key = line["way"], line["n"]
        assert sent[key] + kept[key] == times[line["fate"]], line
    fates = Counter((line["way"], line["fate"]) for line in truth.of("came"))
    assert all(fates[way, fate] > 2 for way in ("request", "answer") for fate in times), fates
    assert sum(line["behind"] > 0 for line in truth.of("sent")) > 4


def check_that_none_was_sent_again(directory: Path, wire: Wire) -> None:
    """Each request is one of its own, and the recording knows of each."""
    numbers = [request.transaction for request in wire.requests]
    assert len(set(numbers)) == len(numbers)
    links = items(directory, "/msx1/link") or items(directory, "/roc1/link")
    assert sum(item.values.requests for item in links) == len(numbers)


def record(
    recorder: Recorder, enough: Callable[[], bool], network: Network, device: Msx | Roc
) -> tuple[Truth, Truth]:
    """Until it is enough; what the network and the device say. The recording is exported."""
    with recorder.start() as child:
        child.while_it_runs(enough, "enough of it", 60)
        assert child.stop() == 0, child.talk()
        assert "Traceback" not in child.talk()
    export(recorder.directory, recorder.folder / "csv")
    return network.end(), device.end()


def is_answer(item: Item, register: int, wire: Wire, raw: bytes) -> bool:
    """Whether these octets reached the client for a request of its own, between asking and reading.

    An answer that was overtaken belongs to an older request, a copy to one that is settled.
    """
    asked, read = item.values.asked_at - MARGIN, item.values.read_at + MARGIN
    return any(
        pdu[2:] == raw and at <= read
        for request in wire.to(register)
        if asked <= request.at <= read
        for at, pdu in request.arrived
    )


def is_told(name: str, row: Row, answer: Line) -> bool:
    """Whether the row has the numbers that the module gave."""
    told = {key: answer[key] for key in TOLD[name]}
    if name == "values":
        told |= {f"value_{place + 1}": value for place, value in enumerate(answer["values"])}
    if name == "clock":
        time = 10**9 * answer["seconds"] + 1000 * answer["microseconds"]
        if nanoseconds(row["device_time"]) != time:
            return False
    return all(_same(row[key], value) for key, value in told.items())


def _same(cell: str, value: object) -> bool:
    return cell == value if isinstance(value, str) else number(cell) == Decimal(str(value))


def check_module(directory: Path, out: Path, wire: Wire, module: Truth) -> Mapping[str, int]:
    """No wrong row, and none that was lost on the way to the disk; how many there are of each."""
    answers: dict[str, Line] = {}
    for line in module.of("answer"):
        answers[line["pdu"][4:]] = line
    kept = {}
    for name, register in CHANNELS.items():
        rows = read_csv(out / f"msx1.{name}.csv")
        messages = items(directory, f"/msx1/{name}")
        kept[name] = len(rows)
        for row, item in zip(rows, messages, strict=True):
            raw = bytes(item.values.raw)
            assert is_answer(item, register, wire, raw), row
            assert is_told(name, row, answers[raw.hex()]), row
    raws = [bytes(item.values.raw) for item in items(directory, "/msx1/clock")]
    assert len(set(raws)) == len(raws)
    in_time = [r for r in wire.to(CLOCK) if r.first is not None and r.first - r.at < TIMEOUT // 2]
    assert {r.arrived[0][1][2:] for r in in_time} <= set(raws)
    return kept


@pytest.mark.parametrize("order", ["big", "little"])
def test_no_wrong_value_and_no_second_call_of_a_module(tmp_path: Path, order: Order) -> None:
    with (
        Msx(tmp_path, "udp", order, acquisition=0.15) as module,
        Network(tmp_path, module.port, **ROUGH, seed=11) as network,
    ):
        module.port = network.port
        recorder = Recorder(tmp_path, module.toml('timeout = "60ms"', MODULE))

        def enough() -> bool:
            return len(Wire(network.truth, order).to(CLOCK)) >= 45

        said, truth = record(recorder, enough, network, module)
    check_that_it_was_rough(said)
    wire = Wire(said, order)
    check_that_none_was_sent_again(recorder.directory, wire)
    kept = check_module(recorder.directory, tmp_path / "csv", wire, truth)
    assert min(kept.values()) > 8, kept
    check_calls(wire)
    check_gaps_of_module(recorder.directory, wire)


def check_calls(wire: Wire) -> None:
    """By schedule alone, whatever is lost; a repeatable one once more where its answer was."""
    for register, period in PERIODS.items():
        calls = wire.to(register)
        due = (calls[-1].at - calls[0].at) // period + 2
        if register == INFORMATION:
            assert due < len(calls) <= 2 * due
        else:
            assert 0.8 * due <= len(calls) <= due
    again = [
        first
        for first, later in pairwise(wire.to(INFORMATION))
        if later.at - first.at < PERIODS[INFORMATION] // 3
    ]
    assert len(again) > 3
    assert all(r.first is None or r.first - r.at > TIMEOUT - MARGIN for r in again)


def check_gaps_of_module(directory: Path, wire: Wire) -> None:
    """The clock: each turn brought a sample or is told. The values: their counter says how many."""
    everything = gaps(directory, "msx1")
    told = [gap for gap in everything if gap.block == "clock"]
    reads = [item.values.read_at for item in items(directory, "/msx1/clock")]
    for before, after in pairwise(reads):
        if after - before > 1.6 * PERIODS[CLOCK]:
            assert any(abs(gap.since - before) + abs(gap.to - after) < MARGIN for gap in told)
    calls = wire.to(CLOCK)
    turns = (calls[-1].at - wire.requests[0].at) // PERIODS[CLOCK] + 1  # at first, who is it?
    found = len(reads) + sum(gap.expected for gap in told)
    assert len(calls) <= found
    assert abs(found - turns) <= 1
    counters = [item.values.counter for item in items(directory, "/msx1/values")]
    missed = sum(gap.expected for gap in everything if gap.reason == "overwritten")
    assert missed == sum(after - before - 1 for before, after in pairwise(counters)) > 0


def check_clears(directory: Path, wire: Wire) -> int:
    """Each was sent because of a flag that was seen up after the one before, for a sample kept."""
    kept = [
        (item.values.read_at, bytes(item.values.raw)) for item in items(directory, "/roc1/sample")
    ]
    clears = wire.to(_FLAG, _WRITE)
    before = 0
    for clear in clears:
        assert clear.second == 0
        seen = [
            (at, pdu[2:])
            for read in wire.to(_FLAG)
            if before < read.at < clear.at
            for at, pdu in read.arrived
            if at < clear.at and len(pdu) == 56 and pdu[2:4] == b"\0\1"
        ]
        assert seen, f"a clear at {clear.at}, and no flag was seen up since {before}"
        blocks = {block for _, block in seen}
        assert any(raw in blocks and at <= clear.at + MARGIN for at, raw in kept), clear
        before = clear.at
    return len(clears)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_sample_of_a_counter_is_kept_or_in_a_gap(tmp_path: Path, seed: int) -> None:
    """Clears that come late or twice may take down the flag of a sample that nobody has read."""
    with (
        Roc(tmp_path, cycle=CYCLE, samples=10**6, seed=seed) as roc,
        Network(tmp_path, roc.address, over="tcp", **ROUGH, seed=seed) as network,
    ):
        toml = (
            f'[connections.line]\ntransport = "udp"\nhost = "127.0.0.1"\nport = {network.port}\n'
            'timeout = "60ms"\n[devices.roc1]\nprofile = "hiac-roc"\nconnection = "line"\n'
            f'unit = 138\npoll = "80ms"\ncycle = "{round(CYCLE * 1000)}ms"\n'
        )
        recorder = Recorder(tmp_path, toml)

        def enough() -> bool:
            return len(roc.truth.made) >= 30

        said, truth = record(recorder, enough, network, roc)
    check_that_it_was_rough(said)
    wire = Wire(said)
    check_that_none_was_sent_again(recorder.directory, wire)
    found = compare(csv_rows(recorder.directory, tmp_path / "csv"), truth)
    assert found.wrong == []
    assert found.twice == []
    assert len(found.found) > 20
    before_the_last = [k for k in found.missing if k < found.found[-1]]
    check = check_gaps(before_the_last, truth, gaps(recorder.directory, "roc1"))
    excuse(check, truth, CYCLE)
    assert check.uncovered == []
    assert check.empty == []
    assert check_clears(recorder.directory, wire) > 8

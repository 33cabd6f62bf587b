"""When a read is a sample: every trigger through the real command, each sample told once."""

from __future__ import annotations

import signal
import time
from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, Any

from bench.recorder import Recorder, roclog
from bench.registers import COILS, HOLDING, INPUT, Block, Cell, Device
from bench.registers_judge import Judge, check_requests

if TYPE_CHECKING:
    from pathlib import Path

    from bench.recording import Gap


def number(counts: tuple[int, ...] = (1, 2**32 - 1, 1), name: str = "number") -> Cell:
    """counts: first, last, start."""
    kind, type_ = ("u32", "uint32") if counts[1] > 0xFFFF else ("u16", "uint16")
    own, octets = (', word_order = "ABCD"', "1234") if kind == "u32" else ("", "")
    return Cell(name, kind, (), f'type = "{type_}"{own}', (), octets, counts=counts)


VALUE = Cell("value", "f32", (1.5, -2.25, 1e9), 'type = "float32", word_order = "ABCD"', (), "1234")


def announced(
    name: str, area: int, at: int, toml: str, *, every: float = 0.3, cells: Any = (), **group: Any
) -> Block:
    """Numbered samples."""
    cells = cells or (number(), VALUE)
    return Block(name, area, at, tuple(cells), toml, group={"every": every, **group})


def flagged(every: float = 0.4) -> Block:
    """A handshake as the ROC's, elsewhere and with other numbers."""
    tells = {"how": "client", "area": HOLDING, "at": 108, "mask": 0xFFFF, "up": 2, "down": 7}
    toml = 'trigger = { flag = 8, new = 2, clear = 7, payload = ["number", "value"] }'
    made = announced("flagged", HOLDING, 100, toml, every=every, tells=tells)
    return replace(made, count=9)


def cleared_by_reading() -> tuple[Block, ...]:
    """The flag in the block, in another table, and in a coil."""
    inside = {"how": "read", "area": INPUT, "at": 204, "mask": 0x0010, "up": 0x0010}
    outside = {"how": "read", "area": HOLDING, "at": 2, "mask": 0x0004, "up": 0x0004}
    coil = {"how": "read", "area": COILS, "at": 3, "mask": 1, "up": 1}
    blocks = (
        ("inside", 200, "address = 204, mask = 0x0010", inside),
        ("outside", 220, 'table = "holding_registers", address = 2, mask = 4', outside),
        ("by_coil", 240, 'table = "coils", address = 3', coil),
    )
    return tuple(
        replace(
            announced(
                name,
                INPUT,
                at,
                f"trigger = {{ clear_on_read = {{ {said} }} }}",
                tells={**tells, "reads": [INPUT, at, at + 4]},
            ),
            count=5,
        )
        for name, at, said, tells in blocks
    )


GATES = ((HOLDING, 2), (COILS, 3))
MORE = ((HOLDING, 2, 2), (COILS, 3, 3))


def record(
    folder: Path, device: Device, toml: str, samples: dict[str, int], connection: str = ""
) -> Judge:
    """Until these samples were told, and a bit more."""
    recorder = Recorder(folder, device.toml(toml, connection=connection))
    with recorder.start() as child:

        def enough() -> bool:
            return all(device.read(name) >= k for name, k in samples.items())

        child.while_it_runs(enough, f"samples {samples}", 40)
        assert child.stop() == 0, child.talk()
        assert "Traceback" not in child.talk()
    truth = device.end()
    assert check_requests(truth, device.blocks, GATES) == []
    return Judge(recorder.directory, folder / "csv", device)


def test_a_flag_is_cleared_when_its_sample_is_on_disk(tmp_path: Path) -> None:
    """And never, where it is somebody else's."""
    toml = 'poll = "50ms"\ncycle = "400ms"'
    disk = tmp_path / "recordings"
    with (
        Device(tmp_path, flagged(), name="own", check_disk=disk) as own,
        Device(tmp_path, flagged(), name="foreign") as foreign,
    ):
        other = foreign.toml(toml + "\nacknowledge = false")
        recorder = Recorder(tmp_path, own.toml(toml), other)
        with recorder.start() as child:
            devices = (own, foreign)
            child.while_it_runs(
                lambda: all(device.read("flagged") >= 8 for device in devices), "samples", 30
            )
            assert child.stop() == 0, child.talk()
        truth = own.end()
        assert check_requests(truth, own.blocks) == []
        assert check_requests(foreign.end(), foreign.blocks) == []
    clears = list(truth.of("clear"))
    assert all(line["on_disk"] and line["was_up"] and not line["errors"] for line in clears)
    assert [line["k"] for line in clears] == list(range(1, len(clears) + 1))
    assert len(clears) >= 7
    assert foreign.truth.count("clear") == 0
    for device in devices:
        judge = Judge(disk, tmp_path / "csv", device)
        found = judge.block(flagged())
        assert found.wrong == [], device.name
        assert found.samples == list(range(1, len(found.samples) + 1)), device.name
        assert len(found.samples) >= 7
        assert [gap for gap in judge.gaps() if not gap.possible] == []


def counters() -> tuple[Block, ...]:
    """One that runs over, one of nine numbers, one that is faster than it is read."""
    return (
        announced("over", HOLDING, 300, 'trigger = { counter = "number" }',
                  cells=(number((0, 65535, 65533)), VALUE), at_once=True),
        announced("nine", HOLDING, 310, 'trigger = { counter = "number", first = 1, last = 9 }',
                  cells=(number((1, 9, 8)), VALUE), at_once=True),
        announced("fast", HOLDING, 320, 'trigger = { counter = "number" }\nperiod = "200ms"',
                  cells=(number(), VALUE), every=0.07, at_once=True),
    )  # fmt: skip


def changing() -> Block:
    """A state that is there twice in a row, one that comes back, and a word that does not count."""
    state = Cell("state", "u16", (1, 2, 2, 3, 2, 4), 'type = "uint16"')
    live = Cell("live", "u16", (10, 11, 12, 13, 14, 15), 'type = "uint16"')
    toml = 'trigger = { change = ["state"] }'
    return announced("changing", HOLDING, 330, toml, cells=(state, live))


def test_each_sample_is_told_apart_and_recorded_once(tmp_path: Path) -> None:
    blocks = (*cleared_by_reading(), *counters(), changing())
    with Device(tmp_path, *blocks, more=MORE) as device:
        judge = record(tmp_path, device, 'poll = "100ms"', dict.fromkeys(("inside", "nine"), 11))
    for block in cleared_by_reading():
        found = judge.block(block)
        assert found.wrong == []
        took = [
            line["took"][block.name]
            for line in judge.truth.of("read")
            if block.name in line["took"]
        ]
        assert found.samples == took == list(range(1, len(took) + 1)), block.name
        assert len(took) >= 10
        assert [gap for gap in judge.gaps() if gap.possible] == [], block.name
    over, nine, fast = (judge.block(block) for block in counters())
    assert over.wrong == nine.wrong == fast.wrong == []
    check_counted(over.samples, 10)
    check_counted(nine.samples, 10)
    assert fast.twice == []
    missed = fast.samples[-1] - fast.samples[0] + 1 - len(fast.samples)
    assert missed > 20
    told = judge.gaps()
    assert sum(gap.expected for gap in told) == missed
    assert {(gap.reason, gap.possible) for gap in told} == {("overwritten", False)}
    check_inside(judge, "fast", fast.samples, told)
    found = judge.block(changing())
    assert found.wrong == []
    assert [k for k in found.samples if k] == [
        k for k in range(1, found.samples[-1] + 1) if k % 6 != 3
    ]


def check_counted(samples: list[int], least: int) -> None:
    assert samples == list(range(1, len(samples) + 1))
    assert len(samples) >= least


def check_inside(judge: Judge, block: str, samples: list[int], told: list[Gap]) -> None:
    """Each missing sample completed in a gap."""
    lost = set(range(1, max(samples))) - set(samples)
    for line in judge.truth.of("made"):
        if line["group"] == block and line["k"] in lost:
            at = line["wall_ns"]
            of_block = [gap for gap in told if gap.block == block]
            assert any(gap.since <= at <= gap.to for gap in of_block), line


def test_a_lost_answer_may_have_taken_a_sample(tmp_path: Path) -> None:
    """Only where a read lowers the flag; the others read what they missed at the next turn."""
    blocks = (*cleared_by_reading(), *counters()[:1], changing())
    lost = {block.name: 4 + n for n, block in enumerate(blocks)}
    blocks = tuple(
        replace(b, group={**b.group, "every": 0.4, "lose": [lost[b.name]]}) for b in blocks
    )
    with Device(tmp_path, *blocks, more=MORE) as device:
        samples = dict.fromkeys(("inside", "over"), 11)
        judge = record(tmp_path, device, 'poll = "50ms"', samples, 'timeout = "150ms"')
    told = judge.gaps()
    assert {(gap.reason, gap.possible, gap.expected) for gap in told} == {("unread", True, 0)}
    for block in blocks[:3]:
        found = judge.block(block)
        assert found.wrong == []
        made = range(1, found.samples[-1] + 1)
        assert found.samples == [k for k in made if k != lost[block.name]], block.name
        assert found.samples[-1] >= 10
        check_inside(judge, block.name, found.samples, told)
    over, change = (judge.block(block) for block in blocks[3:])
    assert over.wrong == change.wrong == []
    check_counted(over.samples, 10)
    assert [k for k in change.samples if k][:8] == [1, 2, 4, 5, 6, 7, 8, 10]
    assert sum(line["fate"] == "lost" for line in judge.truth.of("read")) == len(blocks)


def test_a_device_that_begins_again_at_zero(tmp_path: Path) -> None:
    """No claim that thousands of samples are missing, and nothing twice."""
    low = announced("low", HOLDING, 300, 'trigger = { counter = "number", first = 1 }',
                    cells=(number((1, 65535, 1)), VALUE), at_once=True,
                    restart_after=5)  # fmt: skip
    high = announced("high", HOLDING, 310, 'trigger = { counter = "number" }',
                     cells=(number((0, 65535, 40000)), VALUE), at_once=True)  # fmt: skip
    with Device(tmp_path, low, high, changing()) as device:
        toml = 'poll = "50ms"\ncycle = "300ms"'
        judge = record(tmp_path, device, toml, {"low": 9, "high": 9})
    for block in (low, high, changing()):
        found = judge.block(block)
        assert found.wrong == []
        own = [k for k in found.samples if k]
        assert own == [k for k in range(1, own[-1] + 1) if block.name != "changing" or k % 6 != 3]
        assert own[-1] >= 8
    told = judge.events("counter")
    assert [text.partition(":")[0] for text in told].count("counter_reset") == 3
    assert any(text.startswith("counter_outside: 00 00") for text in told)
    assert all(gap.possible for gap in judge.gaps())


def test_kills_cost_what_was_missed_meanwhile(tmp_path: Path) -> None:
    random = Random(7)
    over, _, fast = counters()
    blocks = (over, fast, *cleared_by_reading(), changing())
    with Device(tmp_path, *blocks, more=MORE) as device:
        recorder = Recorder(tmp_path, device.toml('poll = "50ms"'), segment="2s")
        for _ in range(3):
            with recorder.start() as child:
                recorder.wait_for_hot(child)
                time.sleep(random.uniform(0.3, 1.2))  # the instant of the kill is drawn
                child.send(signal.SIGKILL)
                child.wait()
        last = device.read("fast")
        with recorder.start() as child:
            child.while_it_runs(lambda: device.read("fast") > last + 20, "twenty samples")
            assert child.stop() == 0, child.talk()
        truth = device.end()
        judge = Judge(recorder.directory, tmp_path / "csv", device)
    assert check_requests(truth, blocks, GATES) == []
    told = judge.gaps()
    missed = 0
    for block in blocks:
        found = judge.block(block)
        assert found.wrong == [], block.name
        assert found.twice in ([], [0]), block.name
        own = [k for k in found.samples if k]
        assert own == sorted(own), block.name
        if block in (over, fast):
            missed += own[-1] - len(own)
        if block.name != "changing":
            check_inside(judge, block.name, own, told)
    assert missed > 10
    assert sum(gap.expected for gap in told if not gap.possible) == missed
    assert sum(gap.reason == "downtime" and gap.possible for gap in told) >= 3
    done = roclog("verify", recorder.directory)
    assert "0 damaged parts, 0 holes, 0 conflicts" in done.stdout

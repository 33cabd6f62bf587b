"""What is known of each input survives a crash: the states behind a segment's head count."""

from __future__ import annotations

import os
import random
import shutil
from typing import TYPE_CHECKING, Any

import pytest
import recording_bench
from recording_bench import START, ManualClock, open_bench

from roclog.bus.bus import Answer
from roclog.changes import Change, ChangeKind, ChangeMemory, State
from roclog.clock import Instant
from roclog.recording import directory
from roclog.recording.directory import Directory
from roclog.recording.entries import plain_channel
from roclog.recording.writer import Limits
from roclog.register_map import Table
from roclog.schema import stamped_type
from roclog.stamped_messages import StampedMaker

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from roclog.recording.entries import Entry

EPOCH, PROFILE = b"e" * 16, "mei-timestamped"
TABLES = (Table.DISCRETE_INPUTS, Table.INPUT_REGISTERS)
DISCRETE, REGISTERS = (f"/rtu7/{table}" for table in TABLES)


@pytest.fixture(autouse=True)
def stamped_channels(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [
        plain_channel("rtu7", table, stamped_type(PROFILE, table, 7), profile=PROFILE, states="1")
        for table in TABLES
    ]
    monkeypatch.setattr(recording_bench, "CHANNELS", [recording_bench.CHANNELS[0], *found])


def maker(table: Table, seq: int = 0, epoch: bytes = EPOCH) -> StampedMaker:
    return StampedMaker("rtu7", PROFILE, table, epoch, seq)


def entry(
    source: StampedMaker, address: int, state: State, at: int = START, previous: int = 0
) -> Entry:
    instant = Instant(at, 10**9)
    answer = Answer(b"", instant, instant, instant)
    return source.message(Change(address, ChangeKind.CHANGED, state), answer, previous)


def killed(root: Path, copy: Path) -> dict[str, dict[str, Any]]:
    """What the next run inherits of a folder whose recorder was killed at this instant."""
    shutil.copytree(root, copy)
    after = Directory(copy)
    try:
        return after.inherit().carry
    finally:
        after.release()


def text(states: Mapping[int, State]) -> str:
    memory = ChangeMemory()
    for address, state in states.items():
        memory.restore(address, state)
    return memory.text()


def drawn(rng: random.Random, *, bits: bool) -> State:
    value = rng.randrange(2 if bits else 0x10000)
    stamp = rng.randbytes(rng.choice((4, 7)))
    return State(value, stamp, rng.randrange(2**63), rng.randrange(2**32))


def test_every_state_that_is_in_the_file_is_known_after_a_crash(
    tmp_path: Path, clock: ManualClock
) -> None:
    """Segments turn over on the way, so heads and messages both matter."""
    rng = random.Random(1)
    bench = open_bench(tmp_path / "r", clock, Limits(duration=40 * 10**9, size=2**26))
    makers = {table: maker(table) for table in TABLES}
    known: dict[Table, dict[int, State]] = {table: {} for table in TABLES}
    memories = {table: ChangeMemory() for table in TABLES}
    for step in range(100):
        clock.advance(10**9)
        for table in TABLES:
            address = rng.randrange(40)
            state = drawn(rng, bits=table.has_bits)
            message = entry(makers[table], address, state, clock.utc, clock.utc - 5)
            memories[table].keep(Change(address, ChangeKind.CHANGED, state))
            makers[table].update(memories[table], clock.utc - 5)
            bench.writer.commit([message]).result(10)
            memories[table].committed(Change(address, ChangeKind.CHANGED, state))
            memories[table].give_up(Change(address, ChangeKind.CHANGED, state))
            known[table][address] = state
        if step % 7 == 0:
            carry = killed(bench.root, tmp_path / f"copy{step}")
            for table in TABLES:
                found = carry[f"/rtu7/{table}"]
                assert found["states"] == text(known[table])
                assert found["seq"] == step + 1
                assert found["read_at"] == clock.utc - 5
                assert found["epoch"] == EPOCH.hex()
    bench.close()


def test_another_epoch_begins_with_nothing(tmp_path: Path, clock: ManualClock) -> None:
    bench = open_bench(tmp_path / "r", clock)
    old, new = State(1, bytes(7), 5), State(0, b"\1" * 7, 6)
    bench.writer.commit([entry(maker(TABLES[0]), 1, old)]).result(10)
    later = maker(TABLES[0], epoch=b"f" * 16)
    bench.writer.commit([entry(later, 2, new)]).result(10)
    carry = killed(bench.root, tmp_path / "copy")[DISCRETE]
    assert (carry["epoch"], carry["states"]) == ((b"f" * 16).hex(), text({2: new}))
    assert REGISTERS not in killed(bench.root, tmp_path / "again")
    bench.close()


def test_states_before_the_damage_are_known(tmp_path: Path, clock: ManualClock) -> None:
    bench = open_bench(tmp_path / "r", clock)
    source = maker(TABLES[1])
    states = {n: State(n, bytes([n] * 4), n) for n in range(1, 9)}
    sizes = []
    for address, state in states.items():
        bench.writer.commit([entry(source, address, state)]).result(10)
        (path,) = bench.directory.hot_segments()
        sizes.append(path.stat().st_size)
    shutil.copytree(bench.root, tmp_path / "torn")
    os.truncate(tmp_path / "torn/hot" / path.name, sizes[4] + 9)
    carry = killed(tmp_path / "torn", tmp_path / "copy")[REGISTERS]
    assert carry["states"] == text({n: states[n] for n in range(1, 6)})
    assert carry["seq"] == 5
    bench.close()


def test_the_memory_is_taken_apart_once(
    tmp_path: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = open_bench(tmp_path / "r", clock)
    source, made = maker(TABLES[1]), 0
    state = State(7, bytes(4))
    bench.writer.commit([entry(source, n % 300, state) for n in range(3000)]).result(10)

    class Counted(ChangeMemory):
        def __init__(self, text: str = "") -> None:
            nonlocal made
            made += 1
            super().__init__(text)

    monkeypatch.setattr(directory, "ChangeMemory", Counted)
    carry = killed(bench.root, tmp_path / "copy")[REGISTERS]
    assert (carry["states"], carry["seq"], made) == (
        text(dict.fromkeys(range(300), state)),
        3000,
        1,
    )
    bench.close()


def test_a_carried_text_that_is_no_use_is_left_to_the_next_run(
    tmp_path: Path, clock: ManualClock
) -> None:
    bench = open_bench(tmp_path / "r", clock)
    broken = {"epoch": EPOCH.hex(), "seq": 3, "read_at": 4, "states": "00"}
    bench.writer.carry(REGISTERS, broken).result(10)
    bench.close()
    again = open_bench(tmp_path / "r", clock)
    message = entry(maker(TABLES[1], 3), 1, State(7, bytes(4)))
    again.writer.commit([message]).result(10)
    assert killed(again.root, tmp_path / "copy")[REGISTERS]["states"] == "00"
    again.close()


def test_inputs_that_a_new_run_has_not_read_yet_were_seen_by_the_last_one_only(
    tmp_path: Path, clock: ManualClock
) -> None:
    """A gap that begins at the first message of the new run would be too short for them."""
    bench = open_bench(tmp_path / "r", clock)
    source, memory = maker(TABLES[1]), ChangeMemory()
    message = entry(source, 1, State(7, bytes(4)), START, START - 5)
    source.update(memory, START - 5)
    bench.writer.commit([message]).result(10)
    bench.close()
    again = open_bench(tmp_path / "r", clock)
    source = maker(TABLES[1], 1)
    again.writer.commit([entry(source, 1, State(8, b"\1" * 4), START + 90)]).result(10)
    assert killed(again.root, tmp_path / "one")[REGISTERS]["read_at"] == START - 5
    again.writer.commit([entry(source, 1, State(9, bytes(4)), START + 99, START + 80)]).result(10)
    assert killed(again.root, tmp_path / "two")[REGISTERS]["read_at"] == START + 80
    again.close()

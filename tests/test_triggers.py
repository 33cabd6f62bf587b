"""What a read means under each trigger; counters against a device that is played."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roclog.register_map import (
    Block,
    Change,
    ClearOnRead,
    Counter,
    FlagAndClear,
    Point,
    Table,
    WordOrder,
    WordType,
)
from roclog.schema import Origin
from roclog.triggers import Finding, Known, Note, counter_range, is_raised, judge

PROPERTY = settings(derandomize=True, deadline=None)
HOLDING = Table.HOLDING_REGISTERS


def block(trigger: Any, type_: WordType = WordType.U16, count: int = 4, **more: Any) -> Block:
    number = Point(name="record", offset=0, type=type_)
    given = {"table": HOLDING, "address": 100, **more}
    return Block(name="b", count=count, points=(number,), trigger=trigger, **given)


def test_without_a_trigger_every_read_is_a_sample() -> None:
    assert judge(block(None), Known(7), [0] * 4) == (Known(8), Finding(Origin.CYCLIC))


def test_a_flag_to_clear_is_judged_elsewhere() -> None:
    trigger = FlagAndClear(flag=3, payload=((0, 1),))
    with pytest.raises(ValueError, match=r"roclog\.handshake"):
        judge(block(trigger), Known(), [0] * 4)


# Clear on read


def test_a_flag_inside_the_block() -> None:
    made = block(ClearOnRead(table=HOLDING, address=103, mask=4, new=4))
    assert judge(made, Known(1), [9, 9, 9, 0b1101]) == (Known(2), Finding(Origin.FLAG))
    assert judge(made, Known(1), [9, 9, 9, 0b1011]) == (Known(1), Finding())


@pytest.mark.parametrize(("table", "address"), [(HOLDING, 2), (Table.INPUT_REGISTERS, 103)])
def test_a_flag_elsewhere_is_asked_before_the_block(table: Table, address: int) -> None:
    trigger = ClearOnRead(table=table, address=address, mask=4, new=4)
    assert trigger.offset_in(block(trigger)) is None
    assert is_raised(trigger, 0b1111)
    assert not is_raised(trigger, 0b1011)
    assert judge(block(trigger), Known(1), [0] * 4) == (Known(2), Finding(Origin.FLAG))


def test_equal_samples_behind_a_flag_are_two_samples() -> None:
    made = block(ClearOnRead(table=HOLDING, address=103))
    known, _ = judge(made, Known(), [5, 5, 5, 1])
    assert judge(made, known, [5, 5, 5, 1]) == (Known(2), Finding(Origin.FLAG))


# Counters


def count_up(made: Block, numbers: list[int], most: int | None = None) -> list[Finding]:
    known, found = Known(), []
    for number in numbers:
        known, finding = judge(made, known, [number, 0, 0, 0], most=most)
        found.append(finding)
    return found


COUNTED = Finding(Origin.FLAG)


def test_a_counter() -> None:
    found = count_up(block(Counter(point="record")), [5, 5, 6, 9, 9])
    missed = Finding(Origin.FLAG, missed=2)
    assert found == [COUNTED, Finding(), COUNTED, missed, Finding()]


def test_a_counter_that_begins_again() -> None:
    found = count_up(block(Counter(point="record")), [65534, 65535, 0, 1, 65535])
    reset = Finding(Origin.FLAG, 65535, possible=True, note=Note.COUNTER_RESET)
    assert found == [COUNTED, COUNTED, COUNTED, COUNTED, reset]
    assert count_up(block(Counter(point="record")), [65530, 3])[1] == Finding(Origin.FLAG, missed=8)


@pytest.mark.parametrize(("last", "number", "is_told_apart"), [
    (65_000, 3064, True),  # an hour at 1 Hz, or 3064 since a reset at the very end of the numbers
    (65_500, 3, True),
    (65_000, 5, False),
    (40_000, 1, False),
])  # fmt: skip
def test_a_counter_that_went_back_far(last: int, number: int, is_told_apart: bool) -> None:
    """It ran over, or the device began anew; the more the first one claims, the less it is sure."""
    _, found = count_up(block(Counter(point="record")), [last, number])
    assert found.missed == 65_535 - last + number
    assert found.possible is not is_told_apart
    assert (found.note is Note.COUNTER_RESET) is not is_told_apart
    known = count_up(block(Counter(point="record")), [last, number], most=40_000)[1]
    assert known == Finding(Origin.FLAG, missed=found.missed), "where the time allows it"


def test_a_counter_from_1_to_65535() -> None:
    """As the event records of ABB's relays; 0 is no record."""
    made = block(Counter(point="record", first=1))
    none = Finding(note=Note.COUNTER_OUTSIDE)
    assert count_up(made, [0, 1, 65535, 1, 0, 2])[:2] == [none, COUNTED]
    assert count_up(made, [65534, 65535, 1, 0, 2]) == [COUNTED, COUNTED, COUNTED, none, COUNTED]


def test_a_counter_that_was_reset() -> None:
    found = count_up(block(Counter(point="record")), [1000, 3])
    assert found[1] == Finding(Origin.FLAG, 3, possible=True, note=Note.COUNTER_RESET)
    # Where the time between samples is known, a jump forward can be told from a reset as well.
    assert count_up(block(Counter(point="record")), [1000, 9000])[1].missed == 7999
    found = count_up(block(Counter(point="record")), [1000, 9000], most=5)
    assert found[1] == Finding(Origin.FLAG, 9000, possible=True, note=Note.COUNTER_RESET)
    found = count_up(block(Counter(point="record")), [65000, 0], most=5)
    assert found[1] == Finding(Origin.FLAG, 1, possible=True, note=Note.COUNTER_RESET)


@PROPERTY
@given(
    st.integers(0, 3),
    st.integers(1, 200),
    st.lists(st.integers(0, 300), min_size=1, max_size=30),
)
def test_whatever_a_counter_does_no_sample_is_lost_unseen(
    first: int, length: int, steps: list[int]
) -> None:
    """A device completes samples between reads; seen and missed add up while a turn is not lost."""
    trigger = Counter(point="record", first=first, last=first + length)
    made = block(trigger)
    numbers = counter_range(made, trigger)
    completed, seen, known, before = 0, 0, Known(), 0
    for step in [0, *steps]:
        completed += step % max(1, len(numbers) // 2)
        words = [numbers[completed % len(numbers)], 0, 0, 0]
        went_back, before = words[0] < before, words[0]
        known, finding = judge(made, known, words)
        if finding.origin is not None:
            seen += 1 + finding.missed
        assert went_back or not finding.possible
        assert seen == completed + 1
    assert known.seq <= seen


@pytest.mark.parametrize("order", WordOrder)
def test_a_counter_of_two_registers_in_any_order(order: WordOrder) -> None:
    made = block(Counter(point="record"), WordType.U32)
    swap = order in (WordOrder.BADC, WordOrder.DCBA)
    pair = [0x0100, 0x0200] if swap else [0x0001, 0x0002]
    words = [*(reversed(pair) if order in (WordOrder.CDAB, WordOrder.DCBA) else pair), 0, 0]
    known, _ = judge(made, Known(), words, order)
    assert known.payload == (0x00010002).to_bytes(8)


def test_the_counter_tells_what_was_missed_while_nothing_ran() -> None:
    made = block(Counter(point="record"))
    known, _ = judge(made, Known(), [10, 0, 0, 0])
    again = Known(known.seq, bytes.fromhex((known.payload or b"").hex()))  # as the recording has it
    assert judge(made, again, [14, 0, 0, 0])[1].missed == 3
    assert judge(made, again, [10, 7, 7, 7]) == (again, Finding())


# Change


CHANGED = Finding(Origin.CHANGED)


def test_a_change_of_the_payload() -> None:
    made = block(Change(payload=((0, 1), (3, 1))))
    known, first = judge(made, Known(), [1, 2, 3, 4])
    assert (known, first) == (Known(1, b"\0\1\0\4"), CHANGED)
    assert judge(made, known, [1, 9, 9, 4]) == (known, Finding())
    assert judge(made, known, [1, 2, 3, 5]) == (Known(2, b"\0\1\0\5"), CHANGED)


def test_a_change_of_anything() -> None:
    made = block(Change())
    known, _ = judge(made, Known(), [1, 2, 3, 4])
    assert judge(made, known, [1, 2, 3, 4]) == (known, Finding())
    for offset in range(4):
        words = [1, 2, 3, 4]
        words[offset] ^= 0x8000
        assert judge(made, known, words)[1] == CHANGED


@pytest.mark.parametrize("payload", [(), ((0, 12),), ((11, 1),)])
def test_a_change_of_a_coil(payload: Any) -> None:
    made = block(Change(payload=payload), WordType.BIT, 12, table=Table.COILS)
    known, _ = judge(made, Known(), [0] * 12)
    assert judge(made, known, [0] * 12) == (known, Finding())
    assert judge(made, known, [0] * 11 + [1])[1] == CHANGED
    known, _ = judge(made, known, [0] * 11 + [1])
    first = judge(made, known, [1, *[0] * 10, 1])[1]
    assert first == (Finding() if payload == ((11, 1),) else CHANGED)

"""The ROC against PDUs written by hand from its document."""

from __future__ import annotations

import csv
import io

import pytest

from roclog.simulators.hiac_roc import SimulatedRoc
from roclog.simulators.oil import Measurement

READ_BLOCK = "03 01 2C 00 1B"
CLEAR_FLAG = "06 01 2C 00 00"
RESET = "06 04 4D 00 55"
SAVE = "06 04 4E 00 5A"


class StillFluid:
    """Always the same oil; keeps what it was asked for."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []

    def measure(self, *, elapsed_s: int, period_s: int) -> Measurement:
        self.asked.append((elapsed_s, period_s))
        return Measurement(
            counts_per_ml=(700.0, 20.0, 1.3, 0.01),
            temperature_cel=40.0,
            laser_current_ma=50.0,
            photo_diode_power_v=4.7,
        )


def ask(roc: SimulatedRoc, request: str) -> str | None:
    answer = roc.answer(bytes.fromhex(request))
    return None if answer is None else answer.hex(" ").upper()


def words(roc: SimulatedRoc, address: int, count: int) -> list[int]:
    answer = roc.answer(bytes((3,)) + address.to_bytes(2, "big") + count.to_bytes(2, "big"))
    assert answer is not None
    assert answer[:2] == bytes((3, 2 * count))
    return [int.from_bytes(answer[at : at + 2], "big") for at in range(2, len(answer), 2)]


def write(roc: SimulatedRoc, address: int, *values: int) -> bytes | None:
    body = b"".join(value.to_bytes(2, "big") for value in values)
    head = bytes((16,)) + address.to_bytes(2, "big") + len(values).to_bytes(2, "big")
    return roc.answer(head + bytes((len(body),)) + body)


def test_identity_block() -> None:
    roc = SimulatedRoc(138, seed=7)
    text = "".join(chr(word >> 8) + chr(word & 0xFF) for word in words(roc, 0, 48))
    assert text[:30] == "HIAC".ljust(30, "\0")
    assert text[30:50] == "ROC".ljust(20, "\0")
    assert text[50:60] == "000007-138"
    assert text[60:68] == "HIAC ROC"
    assert text[82:] == "2089263-1 RevC"
    assert words(roc, 34, 7) == [0, 0, 0, 0, 104, 100, 0]
    assert ask(roc, "03 00 00 00 02") == "03 04 48 49 41 43"


def test_configuration_block_as_delivered() -> None:
    assert ask(SimulatedRoc(seed=1), "03 00 64 00 0E") == (
        "03 1C 00 8A 00 00 00 00 00 00 00 00 00 0A 00 05 00 00 00 01 00 00 FF FD FF FD FF FD FF FD"
    )


def test_block_is_zeros_until_the_first_sample_then_the_flag_rises() -> None:
    roc = SimulatedRoc(seed=1, fluid=StillFluid())
    roc.step(9.999)
    assert words(roc, 300, 27) == [0] * 27
    roc.step(0.001)
    assert ask(roc, READ_BLOCK) == (
        "03 36 00 01 00 00 00 00 00 00 00 00 00 0A 00 00 00 00 "
        "00 01 11 70 00 00 07 D0 00 00 00 82 00 00 00 01 "
        "00 A1 00 6E 00 46 00 00 00 03 00 02 00 07 00 03 00 02 FF FE 01 90"
    )


def test_clear_lowers_the_flag_and_nothing_else() -> None:
    roc = SimulatedRoc(seed=1)
    roc.step(10)
    before = words(roc, 300, 27)
    assert ask(roc, CLEAR_FLAG) == CLEAR_FLAG
    assert words(roc, 300, 27) == [0, *before[1:]]
    roc.step(14.9)
    assert words(roc, 300, 1) == [0]
    roc.step(0.1)
    assert words(roc, 300, 1) == [1]


def test_low_word_first() -> None:
    roc = SimulatedRoc(seed=1, fluid=StillFluid(), word_order="CDAB")
    roc.step(10)
    assert words(roc, 308, 2) == [0x1170, 0x0001]


@pytest.mark.parametrize(
    ("request_pdu", "answer"),
    [
        ("04 01 2C 00 1B", "84 01"),
        ("01 00 00 00 08", "81 01"),
        ("2B 0E 01 00", "AB 01"),
        ("17 01 2C 00 01 01 2C 00 01 02 00 00", "97 01"),
        ("03 01 2C 00 1C", "83 02"),  # 300-327 touches the expansion range
        ("03 00 2F 00 02", "83 02"),  # 47-48
        ("03 00 71 00 02", "83 02"),  # 113-114
        ("03 00 63 00 02", "83 02"),  # 99-100
        ("03 01 2B 00 02", "83 02"),  # 299-300
        ("03 FF FF 00 02", "83 02"),
        ("03 04 4C 00 01", "83 02"),  # factory use only
        ("03 04 4D 00 01", "83 02"),  # write only
        ("03 04 4E 00 01", "83 02"),
        ("03 00 00 00 00", "83 03"),
        ("03 00 00 00 7D", "83 02"),
        ("03 00 00 00 7E", "83 03"),
        ("03 01 2C 00", "83 03"),
        ("03 01 2C 00 1B 00", "83 03"),
        ("06 01 2C 00 01", "86 03"),  # only 0 may be written
        ("06 01 2D 00 00", "86 02"),  # read only
        ("06 00 00 00 00", "86 02"),
        ("06 00 72 00 00", "86 02"),
        ("06 04 4C 00 00", "86 02"),
        ("06 04 4D 00 54", "86 03"),
        ("06 04 4E 00 59", "86 03"),
        ("06 01 2C", "86 03"),
        ("06 01 2C 00 00 00", "86 03"),
        ("10 01 2C 00 01 02 00 00", "10 01 2C 00 01"),
        ("10 01 2C 00 01 02 00 01", "90 03"),
        ("10 01 2C 00 02 04 00 00 00 00", "90 02"),
        ("10 01 2C 00 00 00", "90 03"),
        ("10 01 2C 00 01 04 00 00", "90 03"),
        ("10 01 2C 00 01 02 00", "90 03"),
        ("10 01 2C 00 01", "90 03"),
        ("10 01 2C 00 7C F8" + " 00" * 248, "90 03"),
        ("10 01 2C 00 7B F6" + " 00" * 246, "90 02"),
        ("10 00 69 00 02 04 00 3B 00 02", "10 00 69 00 02"),
    ],
)
def test_answers(request_pdu: str, answer: str) -> None:
    assert ask(SimulatedRoc(seed=1), request_pdu) == answer


def test_refused_write_changes_nothing() -> None:
    roc = SimulatedRoc(seed=1)
    before = words(roc, 100, 14)
    assert write(roc, 105, 0x0014, 0x0001) == bytes.fromhex("90 03")
    assert write(roc, 113, 0, 0) == bytes.fromhex("90 02")
    assert words(roc, 100, 14) == before


def test_limits_are_judged_by_the_trigger_of_the_same_request() -> None:
    roc = SimulatedRoc(seed=1)
    assert write(roc, 107, 2, 1, 0, 290) == bytes.fromhex("90 03")
    assert write(roc, 107, 1, 1, 0, 290) == bytes.fromhex("10 00 6B 00 04")
    assert words(roc, 107, 4) == [1, 1, 0, 290]


def test_periods_take_effect_with_the_next_sample() -> None:
    fluid = StillFluid()
    roc = SimulatedRoc(seed=1, fluid=fluid)
    roc.step(3)
    write(roc, 105, 0x0114, 0x0002)
    assert words(roc, 105, 2) == [0x0114, 0x0002]
    roc.step(7 + 5)
    assert words(roc, 305, 1) == [0x000A]
    roc.step(79.9)
    assert words(roc, 305, 1) == [0x000A]
    roc.step(0.1)
    assert words(roc, 305, 1) == [0x0114]
    roc.step(2 + 80)
    assert fluid.asked == [(10, 10), (85, 80), (82, 80)]


def test_reset_is_silent_and_brings_back_what_was_saved() -> None:
    roc = SimulatedRoc(seed=1)
    write(roc, 105, 0x0014)
    assert ask(roc, SAVE) == SAVE
    write(roc, 106, 0x0009)
    roc.step(10)
    assert ask(roc, RESET) is None
    assert words(roc, 105, 2) == [0x0014, 0x0005]
    assert words(roc, 300, 27) == [0] * 27
    roc.step(19.9)
    assert words(roc, 300, 1) == [0]
    roc.step(0.1)
    assert words(roc, 300, 1) == [1]


def test_reset_by_function_16_is_silent_too() -> None:
    roc = SimulatedRoc(seed=1)
    roc.step(10)
    assert write(roc, 1101, 0x55) is None
    assert words(roc, 300, 27) == [0] * 27


def test_node_id_moves_at_reset_and_only_when_saved() -> None:
    roc = SimulatedRoc(5, seed=1)
    assert words(roc, 100, 1) == [5]
    write(roc, 100, 6)
    assert (roc.unit, words(roc, 100, 1)) == (5, [6])
    ask(roc, RESET)
    assert (roc.unit, words(roc, 100, 1)) == (5, [5])
    write(roc, 100, 6)
    ask(roc, SAVE)
    assert roc.unit == 5
    ask(roc, RESET)
    assert (roc.unit, words(roc, 100, 1)) == (6, [6])


def test_alarms_follow_the_configuration_at_the_end_of_the_sample() -> None:
    roc = SimulatedRoc(seed=1, fluid=StillFluid())
    write(roc, 107, 1, 0, 0, 100)
    roc.step(10)
    assert words(roc, 306, 2) == [0, 1 << 8]


def truth_of(steps: list[float], *, seed: int = 1, unit: int = 138) -> str:
    truth = io.StringIO()
    roc = SimulatedRoc(unit, seed=seed, truth=truth)
    for seconds in steps:
        roc.step(seconds)
    return truth.getvalue()


def test_same_seed_gives_the_same_samples_however_time_is_cut() -> None:
    whole = truth_of([1_000.0])
    assert whole == truth_of([0.02] * 50_000)
    assert whole == truth_of([333.25, 600.5, 66.25])
    assert whole != truth_of([1_000.0], seed=2)
    assert whole != truth_of([1_000.0], unit=7)


def test_truth_is_what_the_registers_say() -> None:
    truth = io.StringIO()
    roc = SimulatedRoc(seed=3, truth=truth)
    seen = []
    for _ in range(60):
        roc.step(15)
        seen.append(words(roc, 300, 27))
    rows = list(csv.DictReader(io.StringIO(truth.getvalue())))
    assert [row["sample"] for row in rows] == [str(number) for number in range(1, 61)]
    for row, block in zip(rows, seen, strict=True):
        assert float(row["count_1"]) == (block[8] << 16 | block[9]) / 100
        assert float(row["count_4"]) == (block[14] << 16 | block[15]) / 100
        assert float(row["iso_code_2"]) == block[17] / 10
        assert int(row["nas_class_2_3"]) == block[20]
        assert float(row["temperature"]) == block[26] / 10
        assert int(row["alarms"]) == block[7]
        assert row["sample_period"] == "10"


def test_samples_are_numbered_over_a_reset() -> None:
    truth = io.StringIO()
    roc = SimulatedRoc(seed=1, truth=truth)
    roc.step(10)
    ask(roc, RESET)
    roc.step(10)
    assert [line.split(",")[0] for line in truth.getvalue().splitlines()] == ["sample", "1", "2"]


def test_wrong_arguments() -> None:
    for unit in (0, 248):
        with pytest.raises(ValueError, match="unit"):
            SimulatedRoc(unit, seed=1)
    with pytest.raises(ValueError, match="word order"):
        SimulatedRoc(seed=1, word_order="BADC")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="backwards"):
        SimulatedRoc(seed=1).step(-1)

"""``roclog.testing``, as the author of a device uses it."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from importlib.resources import files
from typing import Any

import pytest

from roclog.decode import Decoded, decode
from roclog.devices import PROFILES
from roclog.devices.mpa_48 import mpa_48
from roclog.modbus.library import crc
from roclog.register_map import (
    Block,
    Cp56,
    Point,
    RegisterMap,
    SecondsMicroseconds,
    SerialDefaults,
    Table,
    WordOrder,
    WordType,
)
from roclog.testing import Vector, check_register_map, decode_block, request_pdu

MPA = mpa_48({"channel_1": "model-15", "channel_2": "model-10"})
OXYGEN = "Insite IG MPA-48 manual, p. 25: 8.30 ppm, 25.0 degrees"
RATE = Point(name="rate", offset=0, type=WordType.F32, unit="kg/s")
TOTAL = Point(name="total", offset=2, type=WordType.U32, unit="kg", scale=Decimal("0.1"))


def meter(*points: Point, **more: Any) -> RegisterMap:
    given = {"table": Table.HOLDING_REGISTERS, "address": 3000, "count": 10, **more}
    return RegisterMap(
        name="meter",
        title="A meter",
        source="several manuals",
        unit=1,
        serial=SerialDefaults(baudrate=9600),
        answer_limit=10**9,
        samples=(Block(name="flow", points=points, **given),),
    )


def refusal(register_map: Any, *vectors: Vector) -> list[str]:
    with pytest.raises(AssertionError) as caught:
        check_register_map(register_map, vectors)
    return [line.partition(": ")[2] for line in str(caught.value).splitlines()]


def test_octets_as_the_manual_prints_them() -> None:
    values = decode_block(MPA, "channel_2", "0000 033E 00FA")
    assert values == {"status": 0, "dissolved_oxygen": 8.3, "temperature": 25.0}
    assert decode_block(MPA, "channel_2", "00 00 03 3e 00 fa") == values
    assert decode_block(MPA, "channel_2", {3: "0000 033E", 5: "00FA"}) == values


def test_bits_as_the_manual_prints_them() -> None:
    """MPA-48 manual, p. 23: 01 01 01 05, relays 1 and 3 are on."""
    on = {name for name, value in decode_block(MPA, "relays", "05").items() if value}
    assert on == {"relay_1", "relay_3"}
    assert request_pdu(MPA, "relays") == bytes.fromhex("01 00 00 00 08")


def test_a_measurement_that_does_not_count_is_none() -> None:
    values = decode_block(MPA, "channel_2", "0001 033E 00FA")
    assert values == {"status": 1, "dissolved_oxygen": None, "temperature": None}


def test_only_what_the_given_registers_tell() -> None:
    assert decode_block(MPA, "channel_2", {3: "0002"}) == {"status": 2}
    assert decode_block(MPA, "channel_2", {4: "033E"}) == {}  # whether it counts is not given
    assert decode_block(meter(RATE, TOTAL), "flow", {3002: "0000 007B"}) == {"total": 12.3}
    assert decode_block(meter(RATE, TOTAL), "flow", {3001: "0000 007B"}) == {}


def test_a_text_is_told_up_to_its_end() -> None:
    """Met One 6000, table 16, note 1, of a block with the same identity (registers 15-24)."""
    roc = PROFILES["hiac-roc"]
    assert decode_block(roc, "identity", {15: "3838 3031 0000"})["model"] == "8801"
    assert "model" not in decode_block(roc, "identity", {15: "3838 3031"})
    assert "model" not in decode_block(roc, "identity", {16: "3031 0000"})


def test_word_order() -> None:
    """Siemens SITRANS F, A5E00753974-AB, B.8: 40 C3 52 93 is 6.10383 kg/s."""
    printed = decode_block(meter(RATE), "flow", {3000: "40C3 5293"})["rate"]
    assert printed == pytest.approx(6.10383, rel=1e-6)
    swapped = decode_block(meter(RATE), "flow", {3000: "5293 40C3"}, word_order=WordOrder.CDAB)
    assert swapped == {"rate": printed}


def test_device_time() -> None:
    """MSX-E: 10500 is seconds and microseconds of 1970, two words each."""
    msx = PROFILES["msx-e3317"]
    values = decode_block(msx, "clock", "6922 A4E5 0007 A120")
    assert values["device_time"] == "2025-11-23T06:08:37.5Z"
    assert decode_block(msx, "clock", "0000 0000 0000 0000")["device_time"] is None
    timed = meter(RATE, time=SecondsMicroseconds(seconds=6, microseconds=4))
    assert "device_time" not in decode_block(timed, "flow", {3006: "6922 A4E5", 3004: "0007"})
    told = decode_block(timed, "flow", {3004: "0007 A120 6922 A4E5"})
    assert told == {"device_time": "2025-11-23T06:08:37.5Z"}
    assert decode_block(meter(RATE, time=Cp56(offset=2)), "flow", {3002: "0000 0000"}) == {}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("0000 033E", "block channel_2 has 6 octets, not 4"),
        ("0000 033E 00FG", "non-hexadecimal"),
        ({3: "00"}, "'00' is not a number of whole registers"),
        ({2: "0000"}, "registers 2 to 2 are not all in block channel_2, 3 to 5"),
        ({4: "0000 0000 0000"}, "registers 4 to 6 are not all in block channel_2, 3 to 5"),
        ({3: "0000 033E", 4: "033F"}, "register 4 is given twice"),
    ],
)
def test_octets_that_do_not_fit(words: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        decode_block(MPA, "channel_2", words)


def test_blocks_that_do_not_fit() -> None:
    with pytest.raises(KeyError):
        decode_block(MPA, "channel_7", "00")
    with pytest.raises(ValueError, match="block relays has no registers"):
        decode_block(MPA, "relays", {0: "0005"})


def test_the_request_that_the_manual_prints() -> None:
    """RMF CMS 2, 201.028 REV 1: CC 04 00 00 00 7D 20 36 reads 125 registers of unit 204."""
    cms = meter(RATE, table=Table.INPUT_REGISTERS, address=0, count=125)
    frame = bytes([204]) + request_pdu(cms, "flow")
    assert frame + crc(frame) == bytes.fromhex("CC 04 00 00 00 7D 20 36")


def test_a_map_without_flaws() -> None:
    check_register_map(MPA, [Vector(OXYGEN, "channel_2", "0000 033E 00FA", {"temperature": 25.0})])
    check_register_map(
        meter(RATE), [Vector("Siemens", "flow", {3000: "40C3 5293"}, {"rate": 6.10383})]
    )


def test_all_flaws_are_told() -> None:
    flaws = refusal(replace(meter(RATE, count=1), unit=300))
    assert flaws == [
        "unit: 300 is not 0 to 255",
        "block flow: point rate: offset 0 with 2 words is outside the block, which has 1",
    ]
    assert refusal({}) == ["is a dict, not a roclog.register_map.RegisterMap"]
    assert refusal(meter(replace(RATE, unit=""))) == [
        "block flow: point rate: has neither title nor unit nor named bits"
    ]
    assert refusal(meter(replace(RATE, scale=0.5))) == [  # type: ignore[arg-type]
        "samples[0].points[0].scale: 0.5 (float), not Decimal or None"
    ]


@pytest.mark.parametrize(
    ("vector", "text"),
    [
        (
            Vector(OXYGEN, "channel_2", "0000 033E 00FA", {"temperature": 25.1}),
            "block channel_2: temperature: 25.0, not 25.1",
        ),
        (
            Vector(OXYGEN, "channel_2", "0001 033E 00FA", {"temperature": 25.0}),
            "block channel_2: temperature: None, not 25.0",
        ),
        (
            Vector(OXYGEN, "channel_2", {3: "0000"}, {"temperature": 25.0}),
            "block channel_2: temperature: there is no such field, or the words do not tell it",
        ),
        (
            Vector(OXYGEN, "channel_3", "0000", {}),
            "block channel_3: the map has no such block",
        ),
        (
            Vector(OXYGEN, "channel_2", "0000", {}),
            "block channel_2: block channel_2 has 6 octets, not 2",
        ),
    ],
)
def test_vectors_that_do_not_hold(vector: Vector, text: str) -> None:
    assert refusal(MPA, vector) == [f"{OXYGEN}: {text}"]


def test_six_digits_of_a_binary32_are_compared() -> None:
    wrong = Vector("Siemens", "flow", {3000: "40C3 5293"}, {"rate": 6.10385})
    assert len(refusal(meter(RATE), wrong)) == 1


def test_words_that_do_not_decode(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(block: Block, words: list[int]) -> Decoded:
        if words[0] == 0x8000:
            raise OverflowError("too large")
        return decode(block, words)

    monkeypatch.setattr("roclog.testing.decode", fail)
    assert refusal(meter(RATE)) == ["block flow: of words 0x8000 only: OverflowError: too large"]


def test_types_are_shipped() -> None:
    assert (files("roclog") / "py.typed").is_file()


def test_a_vector_that_tests_nothing() -> None:
    empty = Vector(OXYGEN, "channel_2", "0000 033E 00FA", {})
    assert refusal(MPA, empty) == [
        f"{OXYGEN}: block channel_2: no values, so that nothing is tested"
    ]


def test_what_is_no_vector() -> None:
    for wrong in (MPA, "0000", (OXYGEN, "channel_2", "0000 033E 00FA", {"status": 0})):
        with pytest.raises(ValueError, match=r"vectors\[0\] is .*, not a Vector"):
            check_register_map(MPA, [wrong])  # type: ignore[list-item]


def test_a_word_order_in_words() -> None:
    text = "word order 'CDAB' is not one of WordOrder.ABCD, WordOrder.CDAB, "
    vector = Vector(OXYGEN, "channel_2", "0000 033E 00FA", {"status": 0}, "CDAB")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=text):
        check_register_map(MPA, [vector])
    with pytest.raises(ValueError, match=text):
        decode_block(MPA, "channel_2", "0000 033E 00FA", word_order="CDAB")  # type: ignore[arg-type]

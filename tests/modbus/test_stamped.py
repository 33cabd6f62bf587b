"""Time-stamped inputs: requests, answers and layouts, against the octets of the document."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from wire import crc16, mbap_frame

from roclog.errors import ExceptionAnswer, WrongAnswer
from roclog.modbus.mbap import MbapExchange, MbapStream
from roclog.modbus.request import (
    Mei,
    ReadRegisters,
    ReadStamped,
    WriteRegister,
    check_answer,
    is_read,
)
from roclog.modbus.stamped import Layout, LayoutProbe, parse, plausible_layout, split

VECTORS: dict[str, Any] = tomllib.loads(
    (Path(__file__).parents[1] / "vectors/stamped/frames.toml").read_text(encoding="utf-8")
)
PROPERTY = settings(derandomize=True, deadline=None, max_examples=300)
REGISTERS = (Mei.REGISTERS_7, Mei.REGISTERS_4)
DISCRETE_7 = ReadStamped(Mei.DISCRETE_7, 196, 22)
REGISTERS_4 = ReadStamped(Mei.REGISTERS_4, 8, 2)


def vectors(key: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("vector", VECTORS[key], ids=lambda v: v["source"][:50])


def request_of(vector: dict[str, Any]) -> ReadStamped:
    return ReadStamped(Mei(vector["mei"]), vector["address"], vector["count"])


def stamps(count: int, size: int) -> list[bytes]:
    """No two alike."""
    return [bytes((i, 0xA0, *range(size - 2))) for i in range(count)]


@vectors("frame")
def test_frames_of_the_document(vector: dict[str, Any]) -> None:
    octets = bytes.fromhex(vector["octets"])
    assert crc16(octets[:-2]).to_bytes(2, "little") == octets[-2:]


@vectors("request")
def test_requests_of_the_document(vector: dict[str, Any]) -> None:
    request = request_of(vector)
    assert request.pdu == bytes.fromhex(vector["pdu"])
    assert request.head == bytes.fromhex(vector["head"])
    assert request.answer_size == 3 + request.head[2]
    assert request.stamps_size == vector.get("stamps", request.stamps_size)


@vectors("registers")
def test_registers_of_the_document(vector: dict[str, Any]) -> None:
    request, answer = request_of(vector), bytes.fromhex(vector["answer"])
    check_answer(request, answer)
    parsed = parse(request, answer, Layout(vector["layout"]))
    assert [point.address for point in parsed.points] == [8, 9]
    assert [point.value for point in parsed.points] == vector["values"]
    assert [point.stamp.hex(" ").upper() for point in parsed.points] == vector["stamps"]
    if vector["layout"] == "interleaved":
        assert parse(request, answer) == parsed


@pytest.mark.parametrize("mei", [Mei.DISCRETE_7, Mei.DISCRETE_4])
def test_discrete_inputs_of_the_document(mei: Mei) -> None:
    request = ReadStamped(mei, 196, 22)
    given_stamps = stamps(22, mei.stamp_size)
    size = 22 * mei.stamp_size
    status = bytes.fromhex(VECTORS["status"]["octets"])
    answer = bytes([0x2B, mei, 5 + size, 3, *status, size]) + b"".join(given_stamps)
    check_answer(request, answer)
    parsed = parse(request, answer)
    assert [p.address + 1 for p in parsed.points if p.value] == VECTORS["status"]["on"]
    assert [p.address for p in parsed.points] == list(range(196, 218))
    assert [p.stamp for p in parsed.points] == given_stamps
    assert parsed.spare_bits == 0
    assert parse(request, answer, Layout.GROUPED) == parsed


@pytest.mark.parametrize(("octet", "spare"), [(0x75, 1), (0xB5, 2), (0xF5, 3)])
def test_spare_bits_are_told_and_change_no_value(octet: int, spare: int) -> None:
    right = bytes.fromhex("2B 82 9F 03 AC DB 35 9A") + bytes(154)
    bent = right.replace(b"\x35", bytes([octet]), 1)
    check_answer(DISCRETE_7, bent)
    assert parse(DISCRETE_7, bent).spare_bits == spare
    assert parse(DISCRETE_7, bent).points == parse(DISCRETE_7, right).points


def test_the_printed_answer_of_section_2_2_is_refused() -> None:
    printed = bytes.fromhex(VECTORS["misprint"]["head"]) + bytes(22 * 4)
    asked = ReadStamped(Mei.DISCRETE_4, 196, 22)
    with pytest.raises(WrongAnswer, match="does not answer MEI type 0x92"):
        check_answer(asked, printed)
    with pytest.raises(WrongAnswer, match="byte count"):
        check_answer(asked, printed[:1] + b"\x92" + printed[2:])
    with pytest.raises(WrongAnswer, match="148 octets of stamps instead of 88"):
        check_answer(asked, printed[:1] + b"\x92\x5d" + printed[3:])
    check_answer(asked, printed[:1] + b"\x92\x5d" + printed[3:7] + b"\x58" + printed[8:])


@pytest.mark.parametrize("mei", Mei)
def test_most_is_what_fits_253_octets(mei: Mei) -> None:
    discrete = mei in (0x82, 0x92)
    values = {n: 2 + -(-n // 8) if discrete else 2 * n for n in range(1, 80)}
    sizes = {n: 3 + values[n] + n * mei.stamp_size for n in values}
    assert mei.most == max(n for n, size in sizes.items() if size <= 253)
    for n in range(1, mei.most + 1):
        assert ReadStamped(mei, 0, n).answer_size == sizes[n]


@pytest.mark.parametrize(
    ("mei", "most", "requests"), [(0x82, 34, 9), (0x84, 27, 12), (0x92, 60, 5), (0x94, 41, 8)]
)
def test_splitting_a_list(mei: int, most: int, requests: int) -> None:
    parts = split(Mei(mei), 196, 300)
    assert len(parts) == requests
    assert [a for r in parts for a in range(r.address, r.address + r.count)] == list(
        range(196, 496)
    )
    assert max(part.count for part in parts) == most
    assert split(Mei(mei), 0xFFFF, 1) == (ReadStamped(Mei(mei), 0xFFFF, 1),)


@pytest.mark.parametrize(("address", "count"), [(0, 0), (-1, 1), (0xFFFF, 2), (0, 0x10001)])
def test_lists_that_do_not_exist(address: int, count: int) -> None:
    with pytest.raises(ValueError, match="do not exist"):
        split(Mei.DISCRETE_7, address, count)


@pytest.mark.parametrize("mei", Mei)
@pytest.mark.parametrize(("address", "beyond"), [(0, 1), (-1, 0), (0x10000, 0), (0xFFFF, -1)])
def test_requests_that_cannot_be_asked(mei: Mei, address: int, beyond: int) -> None:
    with pytest.raises(ValueError):
        ReadStamped(mei, address, mei.most + beyond)
    with pytest.raises(ValueError):
        ReadStamped(mei, 0, 0)


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        pytest.param(REGISTERS_4, "", id="nothing"),
        pytest.param(REGISTERS_4, "2B", id="function only"),
        pytest.param(REGISTERS_4, "2B 94", id="no count"),
        pytest.param(REGISTERS_4, "2B 94 0C" + "00" * 11, id="short"),
        pytest.param(REGISTERS_4, "2B 94 0C" + "00" * 13, id="long"),
        pytest.param(REGISTERS_4, "2B 94 0D" + "00" * 12, id="another byte count"),
        pytest.param(REGISTERS_4, "2B 84 0C" + "00" * 12, id="another MEI type"),
        pytest.param(REGISTERS_4, "2B 0E 0C" + "00" * 12, id="device identification"),
        pytest.param(REGISTERS_4, "04 94 0C" + "00" * 12, id="another function"),
        pytest.param(REGISTERS_4, "2B 94 00 08 00 02", id="echo of the request"),
        pytest.param(REGISTERS_4, "AB", id="exception without code"),
        pytest.param(REGISTERS_4, "AB 84 02", id="exception of another MEI type"),
        pytest.param(REGISTERS_4, "AB 94 02 00", id="exception with too much"),
        pytest.param(REGISTERS_4, "84 02", id="exception of another function"),
        pytest.param(DISCRETE_7, "2B 82 9F 02 AC DB 35 9A" + "00" * 154, id="status count"),
        pytest.param(DISCRETE_7, "2B 82 9F 03 AC DB 35 99" + "00" * 154, id="stamp count"),
        pytest.param(DISCRETE_7, "2B 82 9F 04 AC DB 35 00 9A" + "00" * 153, id="n = N + 1"),
    ],
)
def test_wrong_answers(request_: ReadStamped, answer: str) -> None:
    with pytest.raises(WrongAnswer) as caught:
        check_answer(request_, bytes.fromhex(answer))
    assert caught.value.raw == bytes.fromhex(answer)


@vectors("exception")
def test_exceptions_of_the_document(vector: dict[str, Any]) -> None:
    with pytest.raises(ExceptionAnswer) as caught:
        check_answer(ReadStamped(Mei.REGISTERS_7, 8, 2), bytes.fromhex(vector["pdu"]))
    assert (caught.value.function, caught.value.code) == (43, vector["code"])


@pytest.mark.parametrize("mei", Mei)
def test_exceptions_over_tcp_by_length(mei: Mei) -> None:
    request = ReadStamped(mei, 8, 2)
    forms = [(bytes([0xAB, mei, code]), code) for code in range(256)]
    forms += [(bytes([0xAB, code]), code) for code in range(256)]
    for pdu, code in forms:
        pending = MbapExchange(1, request, 7, MbapStream())
        assert pending.feed(mbap_frame(7, 1, pdu)) == pdu
        with pytest.raises(ExceptionAnswer) as caught:
            check_answer(request, pdu)
        assert caught.value.code == code


@pytest.mark.parametrize("request_", [ReadRegisters(3, 0, 1), WriteRegister(0, 0)])
def test_only_function_43_has_the_longer_exception(request_: ReadRegisters | WriteRegister) -> None:
    octet = request_.pdu[0] | 0x80
    with pytest.raises(WrongAnswer):
        check_answer(request_, bytes([octet, request_.pdu[1], 2]))


def test_what_only_reads() -> None:
    for function in range(256):
        assert is_read(bytes([function, 0, 0, 0, 1])) == (1 <= function <= 4)
        assert is_read(bytes([0x2B, function, 0, 0, 0, 1])) == (
            function in (0x82, 0x84, 0x92, 0x94)
        )
    assert not is_read(b"")
    for octets in ("2B", "2B 82", "2B 82 00 00 00", "2B 82 00 00 00 01 00", "AB 82 00 00 00 01"):
        assert not is_read(bytes.fromhex(octets))
    for request in (ReadRegisters(3, 0, 1), ReadRegisters(4, 0, 1), DISCRETE_7, REGISTERS_4):
        assert is_read(request.pdu)
    assert not is_read(WriteRegister(300, 0).pdu)


# Layouts. A stamp is judged by a mark in its last octets here; what is plausible is not decided in
# this module.


def body(points: list[tuple[int, bytes]], *, grouped: bool) -> bytes:
    """Written from the document once more: the table (grouped) or the example."""
    if grouped:
        return b"".join(v.to_bytes(2) for v, _ in points) + b"".join(s for _, s in points)
    return b"".join(v.to_bytes(2) + s for v, s in points)


def answer_of(request: ReadStamped, points: list[tuple[int, bytes]], layout: Layout) -> bytes:
    octets = body(points[: request.count], grouped=layout is Layout.GROUPED)
    return bytes([0x2B, request.mei, len(octets)]) + octets


def is_marked(stamp: bytes) -> bool:
    return stamp[-2:] == b"\xfe\xed"


@pytest.mark.parametrize("mei", REGISTERS)
@pytest.mark.parametrize("layout", Layout)
@pytest.mark.parametrize("count", [2, 3, 27])
def test_plausible_stamps_tell_the_layout(mei: Mei, layout: Layout, count: int) -> None:
    request = ReadStamped(mei, 8, count)
    points = [(i, bytes(mei.stamp_size - 2) + b"\xfe\xed") for i in range(count)]
    assert plausible_layout(request, answer_of(request, points, layout), is_marked) is layout


@pytest.mark.parametrize("mei", REGISTERS)
def test_where_plausible_stamps_tell_nothing(mei: Mei) -> None:
    two, one = ReadStamped(mei, 8, 2), ReadStamped(mei, 8, 1)
    marked = bytes(mei.stamp_size - 2) + b"\xfe\xed"
    points = [(1, marked), (2, marked)]
    answer = answer_of(two, points, Layout.GROUPED)
    assert plausible_layout(two, answer, lambda stamp: True) is None
    assert plausible_layout(two, answer, lambda stamp: False) is None
    assert plausible_layout(one, answer_of(one, points, Layout.GROUPED), is_marked) is None
    zeros = bytes([0x2B, mei, two.head[2]]) + bytes(two.head[2])
    assert plausible_layout(two, zeros, lambda stamp: not any(stamp)) is None
    assert plausible_layout(DISCRETE_7, DISCRETE_7.head + bytes(156), is_marked) is None


def run(probe: LayoutProbe, device: list[list[tuple[int, bytes]]], layout: Layout) -> int:
    """Answer until the probe is over; ``device`` has the registers from 8 on at each request."""
    asked = 0
    while (request := probe.request) is not None:
        now = device[min(asked, len(device) - 1)]
        answer = answer_of(request, now[request.address - 8 :], layout)
        check_answer(request, answer)
        probe.take(answer)
        asked += 1
    return asked


@pytest.mark.parametrize("mei", REGISTERS)
@pytest.mark.parametrize("layout", Layout)
def test_three_requests_tell_the_layout(mei: Mei, layout: Layout) -> None:
    points = list(enumerate(stamps(2, mei.stamp_size)))
    probe = LayoutProbe(mei, [8])
    assert probe.request == ReadStamped(mei, 8, 1)
    assert run(probe, [points], layout) == 3
    assert probe.layout is layout


@pytest.mark.parametrize("layout", Layout)
def test_a_register_that_changes_meanwhile_is_asked_for_again(layout: Layout) -> None:
    first, second = stamps(2, 7)
    restless = [[(i, bytes([i]) + first[1:]), (9, second)] for i in range(3)]
    probe = LayoutProbe(Mei.REGISTERS_7, [8])
    assert run(probe, restless, layout) == 5
    assert probe.layout is layout


def test_a_register_that_never_rests_leaves_it_open() -> None:
    restless = [[(i, bytes([i] * 7)), (9, bytes(7)), (10, bytes(7))] for i in range(99)]
    probe = LayoutProbe(Mei.REGISTERS_7, [8])
    assert run(probe, restless, Layout.GROUPED) == 7
    assert probe.layout is None
    assert probe.request is None


def test_registers_that_say_nothing_or_cannot_be_read_are_passed_over() -> None:
    zeros = (0, bytes(4))
    points = [zeros, zeros, zeros, (7, b"\1\2\3\4"), (8, b"\5\6\7\x08")]
    probe = LayoutProbe(Mei.REGISTERS_4, [8, 9, 11])
    assert run(probe, [points], Layout.GROUPED) == 3 + 3 + 3
    assert probe.layout is Layout.GROUPED
    refused = LayoutProbe(Mei.REGISTERS_4, [30, 8])
    refused.skip()
    assert refused.request == ReadStamped(Mei.REGISTERS_4, 8, 1)
    refused.skip()
    refused.skip()
    assert refused.request is None
    assert refused.layout is None


def test_probes_that_make_no_sense() -> None:
    with pytest.raises(ValueError, match="one layout"):
        LayoutProbe(Mei.DISCRETE_7, [8])
    with pytest.raises(ValueError, match="do not exist"):
        LayoutProbe(Mei.REGISTERS_7, [0xFFFF])


points_4 = st.tuples(st.sampled_from([0, 1, 0x0101]), st.sampled_from([*stamps(6, 4), bytes(4)]))


@PROPERTY
@given(st.lists(st.tuples(points_4, points_4), min_size=9, max_size=9), st.sampled_from(Layout))
def test_a_probe_never_tells_the_wrong_layout(
    history: list[tuple[tuple[int, bytes], tuple[int, bytes]]], layout: Layout
) -> None:
    """Whatever the registers do, if a state does not come back under the very same stamp."""
    firsts = [state[0] for state in history]
    changes = [a for a, b in zip(firsts, [None, *firsts], strict=False) if a != b]
    assume(len(changes) == len(set(changes)))
    probe = LayoutProbe(Mei.REGISTERS_4, [8])
    run(probe, [list(state) for state in history], layout)
    assert probe.layout in (layout, None)


@PROPERTY
@given(st.data())
def test_whatever_a_device_says_comes_back(data: st.DataObject) -> None:
    mei = data.draw(st.sampled_from(Mei))
    count = data.draw(st.integers(1, mei.most))
    layout = data.draw(st.sampled_from(Layout))
    size = mei.stamp_size
    highest = 1 if mei in (0x82, 0x92) else 0xFFFF
    values = data.draw(st.lists(st.integers(0, highest), min_size=count, max_size=count))
    octets = data.draw(st.lists(st.binary(min_size=size, max_size=size), min_size=count,
                                max_size=count))  # fmt: skip
    points = list(zip(values, octets, strict=True))
    request = ReadStamped(mei, 100, count)
    if highest == 1:
        bits = "".join(str(v) for v in reversed(values))
        status = int(bits, 2).to_bytes(-(-count // 8), "little")
        rest = bytes([len(status)]) + status + bytes([count * size]) + b"".join(octets)
        answer = bytes([0x2B, mei, len(rest)]) + rest
    else:
        answer = answer_of(request, points, layout)
    check_answer(request, answer)
    parsed = parse(request, answer, layout)
    assert [(p.value, p.stamp) for p in parsed.points] == points
    assert [p.address for p in parsed.points] == list(range(100, 100 + count))
    assert parsed.spare_bits == 0

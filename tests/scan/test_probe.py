"""What `check --probe` asks, how often, and what it makes of the answers."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from bus_fakes import MS, RTU, TCP, make, now, run
from wire import mbap_frame, rtu_frame

from roclog.bus.timing import Framing
from roclog.config import load
from roclog.modbus.dialect import MSX_E
from roclog.probe import ProbeResult, State, probe_device

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from roclog.bus.timing import Timing
    from roclog.config import Device

NET = '[connections.net]\ntransport = "tcp"\nhost = "plant"\n'
ANALYSER = (
    NET
    + """
[devices.basin]
profile = "mpa-48"
connection = "net"
unit = 3
sensors = { channel_1 = "model-10", channel_2 = "model-15", channel_3 = "model-51" }
addresses = { channel_3 = 100 }
"""
)
RELAYS, CHANNEL_1, CHANNEL_2, CHANNEL_3 = (
    bytes.fromhex(text) for text in ("0100000008", "0400000003", "0400030003", "0400640003")
)
ANSWERS = {RELAYS: b"\x01\x01\x05"} | dict.fromkeys(
    (CHANNEL_1, CHANNEL_2, CHANNEL_3), bytes.fromhex("04 06 0000 033E 00FA")
)
UDP = replace(TCP, framing=Framing.MBAP_DATAGRAM)


def device(tmp_path: Path, text: str) -> Device:
    config = tmp_path / "roclog.toml"
    config.write_text(text)
    (found,) = load(config).devices.values()
    return found


def probed(
    found: Device, answer: Callable[[bytes], bytes | None], timing: Timing = RTU
) -> tuple[ProbeResult, list[bytes], int]:
    """The result, the PDUs that were asked, and how many nanoseconds it took."""
    results: list[tuple[ProbeResult, list[bytes], int]] = []

    async def main() -> None:
        link, bus = make(timing)
        asked: list[bytes] = []
        begin = now()

        def hear(adu: bytes) -> None:
            is_line = timing.framing is Framing.RTU
            unit, pdu = (adu[0], adu[1:-2]) if is_line else (adu[6], adu[7:])
            asked.append(pdu)
            said = answer(pdu)
            if said is None:
                return
            frame = rtu_frame(unit, said)
            if not is_line:
                frame = mbap_frame(int.from_bytes(adu[:2]), unit, said)
            link.say(frame, len(adu) * MS)

        link.on_send = hear
        results.append((await probe_device(bus, found), asked, now() - begin))

    run(main())
    return results[0]


def problems(result: ProbeResult) -> list[str]:
    return [f"{part.state}: {part.place}: {part.problem}" for part in result.problems]


def test_every_block_is_asked_once(tmp_path: Path) -> None:
    result, asked, _ = probed(device(tmp_path, ANALYSER), ANSWERS.get)
    assert (result.state, result.text) == (State.ANSWERS, "4 of 4 blocks read")
    assert asked == [RELAYS, CHANNEL_1, CHANNEL_2, CHANNEL_3]
    assert problems(result) == []


def test_a_channel_at_a_wrong_address_is_named(tmp_path: Path) -> None:
    result, _, _ = probed(
        device(tmp_path, ANALYSER), lambda pdu: {**ANSWERS, CHANNEL_3: b"\x84\x02"}[pdu]
    )
    assert (result.state, result.text) == (State.PARTLY, "3 of 4 blocks read")
    place = "input registers 100 to 102 (channel_3)"
    problem = "exception 2 (illegal data address) to function 4"
    assert problems(result) == [f"refuses: {place}: {problem}"]


def test_a_first_block_that_is_refused_says_nothing_of_the_others(tmp_path: Path) -> None:
    result, _, _ = probed(
        device(tmp_path, ANALYSER), lambda pdu: {**ANSWERS, RELAYS: b"\x81\x01"}[pdu]
    )
    assert (result.state, result.text) == (State.PARTLY, "3 of 4 blocks read")
    assert problems(result)[0].startswith("refuses: coils 0 to 7 (relays): exception 1 ")


@pytest.mark.parametrize(("lost", "state"), [(2, State.ANSWERS), (3, State.SILENT)])
def test_what_was_lost_is_asked_three_times(tmp_path: Path, lost: int, state: State) -> None:
    """And then, where nothing has been heard yet, nothing else."""
    count = 0

    def answer(pdu: bytes) -> bytes | None:
        nonlocal count
        count += 1
        return ANSWERS[pdu] if count > lost else None

    result, asked, _ = probed(device(tmp_path, ANALYSER), answer, UDP)
    assert result.state is state
    assert asked[:3] == [RELAYS] * 3
    if state is State.SILENT:
        assert len(asked) == 3
        assert problems(result) == ["silent: coils 0 to 7 (relays): fake: no answer within 500 ms"]
        assert result.left_out == ("3 more, since it was silent",)


def test_one_silent_block_does_not_end_it(tmp_path: Path) -> None:
    result, asked, _ = probed(
        device(tmp_path, ANALYSER), lambda pdu: {**ANSWERS, CHANNEL_1: None}[pdu]
    )
    assert (result.state, result.text) == (State.PARTLY, "3 of 4 blocks read")
    assert asked == [RELAYS, *[CHANNEL_1] * 3, CHANNEL_2, CHANNEL_3]


def test_a_big_device_that_falls_silent_does_not_take_for_ever(tmp_path: Path) -> None:
    blocks = "".join(
        f'[[devices.meter.blocks]]\nname = "b{n}"\ntable = "holding_registers"\n'
        f'address = {10 * n}\npoints = [{{ name = "x", offset = 0, type = "uint16" }}]\n'
        for n in range(200)
    )
    meter = '[devices.meter]\nprofile = "registers"\nconnection = "net"\nunit = 1\n'
    first = bytes.fromhex("03 0000 0001")
    found = device(tmp_path, NET + meter + blocks)
    result, asked, took = probed(found, lambda pdu: b"\x03\2\0\7" if pdu == first else None)
    assert (result.state, len(asked)) == (State.PARTLY, 1 + 3 * 3)
    assert result.left_out == ("196 more, since it was silent",)
    assert took < 10_000 * MS


@pytest.mark.parametrize("timing", [RTU, UDP])
def test_a_wrong_answer_is_no_silence(tmp_path: Path, timing: Timing) -> None:
    result, asked, _ = probed(device(tmp_path, ANALYSER), lambda _: b"\x03\x02\0\0", timing)
    assert result.state is State.WRONG
    assert len(asked) == 4 * 3
    assert len(result.problems) == 4
    assert all("octets" in part.problem for part in result.problems)


def test_a_damaged_answer_is_no_silence(tmp_path: Path) -> None:
    found = device(tmp_path, ANALYSER)
    results = []

    async def main() -> None:
        link, bus = make(RTU)

        def hear(adu: bytes) -> None:
            frame = rtu_frame(adu[0], ANSWERS[adu[1:-2]])
            link.say(frame[:-1] + bytes([frame[-1] ^ 1]), 20 * MS)

        link.on_send = hear
        results.append(await probe_device(bus, found))

    run(main())
    assert results[0].state is State.WRONG
    assert "octets 03 01 01 05" in results[0].problems[0].problem


def test_a_link_that_is_cut_at_one_block_is_opened_for_the_next(tmp_path: Path) -> None:
    """Some servers close the connection instead of refusing."""
    found = device(tmp_path, ANALYSER)
    results = []

    async def main() -> None:
        link, bus = make(TCP)

        def hear(adu: bytes) -> None:
            if adu[7:] == RELAYS:
                link.break_off("closed")
            else:
                link.say(mbap_frame(int.from_bytes(adu[:2]), 3, ANSWERS[adu[7:]]), MS)

        link.on_send = hear
        blocks = (*found.profile.samples[1:3], found.profile.samples[0], found.profile.samples[3])
        profile = replace(found.profile, samples=blocks)
        results.append(await probe_device(bus, replace(found, profile=profile)))

    run(main())
    assert results[0].state is State.PARTLY
    assert problems(results[0]) == ["silent: coils 0 to 7 (relays): fake: closed"]


MODULE = (
    NET
    + """
[devices.msx1]
profile = "msx-e3317"
connection = "net"
calls = ["clock"]
[[devices.msx1.functions]]
name = "values"
register = 15300
period = "1s"
layout = [{ name = "x", type = "uint32" }]
[[devices.msx1.functions]]
name = "again"
register = 15400
period = "1s"
repeatable = true
layout = [{ name = "x", type = "uint32" }]
"""
)


def module(pdu: bytes) -> bytes:
    """Function 3, count of octets, zeros: a text that is empty, a clock at 1970."""
    octets = 2 * int.from_bytes(pdu[3:5])
    return bytes([3, octets]) + bytes(octets)


def test_a_function_that_may_act_is_not_called(tmp_path: Path) -> None:
    found = device(tmp_path, MODULE)
    result, asked, _ = probed(found, module, replace(TCP, dialect=MSX_E))
    assert [int.from_bytes(pdu[1:3]) for pdu in asked] == [10200, 10500, 15400]
    assert [part.place for part in result.parts] == [
        "function 10200 (module_type)",
        "function 10500 (clock)",
        "function 15400 (again)",
    ]
    assert result.left_out == (
        "function 15300 (values), since a call may act: repeatable = true says it does not",
    )


def test_a_function_whose_answer_was_lost_is_called_again_only_where_that_is_declared(
    tmp_path: Path,
) -> None:
    lost = Counter[int]()

    def once(pdu: bytes) -> bytes | None:
        register = int.from_bytes(pdu[1:3])
        lost[register] += 1
        return None if register != 10200 and lost[register] == 1 else module(pdu)

    result, asked, _ = probed(device(tmp_path, MODULE), once, replace(TCP, dialect=MSX_E))
    assert [int.from_bytes(pdu[1:3]) for pdu in asked] == [10200, 10500, 15400, 15400]
    assert [part.state for part in result.parts] == [State.ANSWERS, State.SILENT, State.ANSWERS]


def test_an_answer_of_the_old_kind_is_told_as_wrong(tmp_path: Path) -> None:
    """Its byte count has 16 bits, as functions below 1000 answer."""

    def old(pdu: bytes) -> bytes:
        octets = 2 * int.from_bytes(pdu[3:5])
        return b"\3" + octets.to_bytes(2) + bytes(octets)

    result, _, _ = probed(device(tmp_path, MODULE), old, replace(TCP, dialect=MSX_E))
    assert result.state is State.WRONG
    assert problems(result)[0].startswith(
        "wrong: function 10200 (module_type): the byte count of the answer has 16 bits, register "
        "10200 of this device has 8"
    )


def test_what_a_read_clears_is_not_read(tmp_path: Path) -> None:
    meter = (
        '[devices.meter]\nprofile = "registers"\nconnection = "net"\nunit = 1\n'
        '[[devices.meter.blocks]]\nname = "b"\ntable = "holding_registers"\naddress = 7\n'
        'points = [{ name = "x", offset = 0, type = "uint16" }]\n'
        "trigger = { clear_on_read = { address = 7 } }\n"
    )
    result, asked, _ = probed(device(tmp_path, NET + meter), lambda _: None)
    assert (result.state, asked) == (State.UNASKED, [])
    assert result.left_out == ("holding registers 7 (b), since a read clears it",)

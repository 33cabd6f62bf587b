"""Which units are there: silence, refusals, late and damaged answers, lost links."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import pytest
from bus_fakes import LATE, MS, RTU, SILENCE, START, TCP, FakeLink, make, now, run
from wire import mbap_frame, rtu_frame

from roclog.bus.timing import Framing
from roclog.config import load
from roclog.errors import LinkDown
from roclog.scan import SERVER_UNITS, Scan, State, hurried, questions, refusal, silent_cost

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from roclog.bus.timing import Timing
    from roclog.config import Device

ILLEGAL_FUNCTION = b"\x91\x01"
METER = b"\x11\x11\xfa\xffPM710PowerMeter"
IDENTIFIED = b"\x2b\x0e\x01\x01\x00\x00\x02\x00\x12Schneider Electric\x01\x05PM710"
LINE = """
[connections.line]
transport = "rtu"
port = "/dev/null"
[connections.plant]
transport = "tcp"
host = "plant"
[devices.roc1]
profile = "hiac-roc"
connection = "line"
unit = 5
[devices.flow]
profile = "registers"
connection = "line"
unit = 7
[[devices.flow.blocks]]
name = "flow"
table = "holding_registers"
address = 0
count = 1
points = [{ name = "rate", offset = 0, type = "uint16" }]
"""


def nobody(_what: str, _done: int, _total: int) -> None:
    """No progress bar."""


def line(link: FakeLink, answers: Mapping[tuple[int, int], bytes], delay: int = 10 * MS) -> None:
    """Units and functions that are answered with a PDU; nothing else is."""

    def hear(adu: bytes) -> None:
        pdu = answers.get((adu[0], adu[1]))
        if pdu is not None:
            link.say(rtu_frame(adu[0], pdu), len(adu) * MS + delay)

    link.on_send = hear


def server(link: FakeLink, answer: Callable[[int, bytes], bytes | None]) -> None:
    def hear(adu: bytes) -> None:
        pdu = answer(adu[6], adu[7:])
        if pdu is not None:
            link.say(mbap_frame(int.from_bytes(adu[:2]), adu[6], pdu), 5 * MS)

    link.on_send = hear


def devices(tmp_path: Path) -> list[Device]:
    config = tmp_path / "roclog.toml"
    config.write_text(LINE)
    return list(load(config).devices.values())


def scan(
    timing: Timing,
    units: range | tuple[int, ...],
    prepare: Callable[[FakeLink], None],
    configured: list[Device] | None = None,
) -> tuple[Scan, FakeLink, int]:
    """The scan, the link, and how many nanoseconds it took."""
    found: list[tuple[Scan, FakeLink, int]] = []

    async def main() -> None:
        link, bus = make(timing)
        prepare(link)
        one = Scan(bus, units, configured or [])
        await one.run(nobody)
        assert not link.is_open
        found.append((one, link, now() - START))

    run(main())
    return found[0]


def states(one: Scan) -> dict[int, State]:
    return {unit: finding.state for unit, finding in one.findings.items()}


def test_any_answer_proves_a_unit() -> None:
    answers = {
        (2, 17): ILLEGAL_FUNCTION,
        (4, 17): METER,
        (4, 43): IDENTIFIED,
        (5, 17): b"\x91\x06",
        (5, 43): b"\xab\x01",
    }
    one, link, took = scan(RTU, range(1, 7), lambda link: line(link, answers))
    there = [unit for unit, finding in one.findings.items() if finding.is_there]
    assert there == [2, 4, 5]
    assert {one.findings[unit].state for unit in (1, 3, 6)} == {State.SILENT}
    assert one.findings[2].answer == "exception 1 (illegal function)"
    assert (one.findings[2].exception, one.findings[5].exception) == (1, 6)
    assert one.findings[4].identity == "Schneider Electric, PM710"
    assert one.findings[4].identification == ((0, "Schneider Electric"), (1, "PM710"))
    assert one.findings[4].pdu == METER
    sent = [adu[:-2].hex() for _, adu in link.sent]
    asked = [f"{unit:02x}11" for unit in range(1, 7)]
    assert sent == [*asked, "022b0e0100", "042b0e0100", "052b0e0100"]
    assert one.alike == frozenset()
    assert took < 4 * (LATE + SILENCE) + 1000 * MS


def test_a_silent_unit_costs_what_the_estimate_says(tmp_path: Path) -> None:
    devices(tmp_path)
    settings = load(tmp_path / "roclog.toml")
    connection = settings.connections["line"]
    assert silent_cost(connection) == connection.late_answer == 2 * connection.timeout
    quick = hurried(connection, 100 * MS)
    assert (quick.timeout, quick.late_answer) == (100 * MS, 200 * MS)
    assert hurried(connection, None) is connection
    plant = hurried(settings.connections["plant"], 100 * MS)
    assert (silent_cost(plant), plant.late_answer) == (100 * MS, None)
    timing = replace(
        RTU,
        timeout=quick.timeout,
        late_answer=200 * MS,
        silence=quick.silence,
        character=quick.character,
    )
    _, link, took = scan(timing, range(1, 248), lambda _: None)
    assert len(link.sent) == 247
    assert abs(took - 247 * silent_cost(quick)) < 10 * MS


def test_a_late_answer_is_its_own_units() -> None:
    """Within the quarantine it is used; beyond it the next unit is asked again."""
    for delay, expected in ((700 * MS, ""), (1200 * MS, "too late, when unit 4 was asked")):
        answers = {(3, 17): ILLEGAL_FUNCTION}
        one, link, _ = scan(RTU, range(3, 6), partial(line, answers=answers, delay=delay))
        assert states(one) == {3: State.ANSWERS, 4: State.SILENT, 5: State.SILENT}
        assert not expected or one.findings[3].answer == expected
        asked = [adu[0] for _, adu in link.sent if adu[1] == 17]
        assert asked == ([3, 4, 4, 5] if expected else [3, 4, 5])


def test_a_late_answer_in_front_of_the_next_ones() -> None:
    def prepare(link: FakeLink) -> None:
        def hear(adu: bytes) -> None:
            if adu[:2] == b"\x03\x11":
                link.say(rtu_frame(3, METER), LATE + SILENCE + 20 * MS)
            if adu[:2] == b"\x04\x11":
                link.say(rtu_frame(4, ILLEGAL_FUNCTION), 100 * MS)

        link.on_send = hear

    one, _, _ = scan(RTU, (3, 4), prepare)
    assert states(one) == {3: State.SILENT, 4: State.ANSWERS}
    assert one.findings[4].pdu == ILLEGAL_FUNCTION
    assert one.stray_octets == len(rtu_frame(3, METER))


def test_damaged_twice_is_unclear_and_once_is_not() -> None:
    def prepare(link: FakeLink) -> None:
        seen: list[int] = []

        def hear(adu: bytes) -> None:
            seen.append(adu[0])
            frame = bytearray(rtu_frame(adu[0], ILLEGAL_FUNCTION))
            if adu[0] == 2 or seen.count(adu[0]) == 1:
                frame[-1] ^= 1
            link.say(bytes(frame), 20 * MS)

        link.on_send = hear

    one, _, _ = scan(RTU, (1, 2), prepare)
    assert states(one) == {1: State.ANSWERS, 2: State.UNCLEAR}
    assert "octets 02 91 01" in one.findings[2].answer


def test_an_intact_answer_of_another_kind_counts() -> None:
    one, _, _ = scan(RTU, (9,), lambda link: line(link, {(9, 17): b"\x03\x02\x12\x34"}))
    assert states(one) == {9: State.ANSWERS}
    assert one.findings[9].pdu == b"\x03\x02\x12\x34"


def test_a_line_that_echoes_has_no_units_of_its_own() -> None:
    def prepare(link: FakeLink) -> None:
        def hear(adu: bytes) -> None:
            link.say(adu, len(adu) * MS)
            if adu[0] == 2:
                link.say(rtu_frame(2, METER if adu[1] == 17 else IDENTIFIED), 40 * MS)

        link.on_send = hear

    one, _, _ = scan(RTU, (1, 2, 3), prepare)
    assert states(one) == {1: State.SILENT, 2: State.ANSWERS, 3: State.SILENT}
    assert one.findings[2].identity == "Schneider Electric, PM710"


def test_configured_units(tmp_path: Path) -> None:
    """A ROC is asked for its identity; others not even for their device identification."""
    text = b"".join(name.ljust(size, b"\0") for name, size in ((b"HIAC", 30), (b"ROC", 20)))
    identity = b"\x03\x60" + text.ljust(96, b"\0")
    answers = {(5, 3): identity, (7, 17): ILLEGAL_FUNCTION, (6, 17): ILLEGAL_FUNCTION}
    one, link, _ = scan(RTU, (5, 6, 7), lambda link: line(link, answers), devices(tmp_path))
    assert one.findings[5].identity == "HIAC, ROC"
    assert [f.devices for f in one.findings.values()] == [("roc1",), (), ("flow",)]
    sent = [adu[:-2].hex() for _, adu in link.sent]
    assert sent == ["050300000030", "0611", "0711", "062b0e0100"]


def test_a_configured_unit_that_is_not_there(tmp_path: Path) -> None:
    one, link, _ = scan(RTU, (5, 7), lambda _: None, devices(tmp_path))
    assert states(one) == {5: State.SILENT, 7: State.SILENT}
    assert one.findings[5].devices == ("roc1",)
    assert len(link.sent) == 2


def test_a_server_that_does_not_look_at_the_unit() -> None:
    one, link, _ = scan(
        TCP, SERVER_UNITS, lambda link: server(link, lambda _, pdu: bytes([pdu[0] | 0x80, 1]))
    )
    assert one.alike == frozenset(SERVER_UNITS)
    assert [adu[6] for _, adu in link.sent] == [*SERVER_UNITS, 0]
    assert link.sent[-1][1][7:] == b"\x2b\x0e\x01\x00"


def test_the_units_behind_a_gateway() -> None:
    """Who is absent is told by the gateway; few that say the same are many devices."""

    def answer(unit: int, pdu: bytes) -> bytes | None:
        if pdu[0] == 43:
            return b"\xab\x01"
        return ILLEGAL_FUNCTION if unit in (3, 4, 8) else b"\x91\x0b"

    one, link, _ = scan(TCP, range(1, 11), lambda link: server(link, answer))
    there = [unit for unit, finding in one.findings.items() if finding.is_there]
    assert there == [3, 4, 8]
    assert one.findings[1].state is State.ABSENT
    assert one.alike == frozenset()
    assert len(link.opened) == 3  # nothing follows a question for an identification


def test_answers_that_come_too_late_over_tcp_are_counted() -> None:
    def prepare(link: FakeLink) -> None:
        def hear(adu: bytes) -> None:
            frame = mbap_frame(int.from_bytes(adu[:2]), adu[6], ILLEGAL_FUNCTION)
            link.say(frame, 700 * MS if adu[6] == 1 else 10 * MS)

        link.on_send = hear

    one, _, _ = scan(TCP, (1, 2), prepare)
    assert states(one)[1] is State.SILENT
    assert one.late_units == [1]  # unit 2 had answered before
    one, _, _ = scan(TCP, (1, 3), _both_late)
    assert one.late_units == [1, 3]


@pytest.mark.parametrize("timing", [TCP, replace(TCP, framing=Framing.MBAP_DATAGRAM)])
def test_a_late_answer_of_the_last_unit_is_waited_for(timing: Timing) -> None:
    one, _, took = scan(timing, (7,), _both_late)
    assert states(one) == {7: State.SILENT}
    assert one.late_units == [7]
    assert took == pytest.approx(2 * TCP.timeout, abs=10 * MS)
    _, _, took = scan(timing, (7,), lambda link: server(link, lambda *_: ILLEGAL_FUNCTION))
    assert took < TCP.timeout


def _both_late(link: FakeLink) -> None:
    link.on_send = lambda adu: link.say(
        mbap_frame(int.from_bytes(adu[:2]), adu[6], ILLEGAL_FUNCTION), 700 * MS
    )


def test_an_answer_of_another_unit_is_unclear_over_tcp() -> None:
    def prepare(link: FakeLink) -> None:
        link.on_send = lambda adu: link.say(
            mbap_frame(int.from_bytes(adu[:2]), 1, ILLEGAL_FUNCTION), 5 * MS
        )

    one, _, _ = scan(TCP, (4,), prepare)
    assert states(one) == {4: State.UNCLEAR}
    assert one.findings[4].answer.startswith("asked unit 4, unit 1 answered")


def test_a_damaged_datagram_is_unclear() -> None:
    def prepare(link: FakeLink) -> None:
        link.on_send = lambda adu: link.say(
            mbap_frame(int.from_bytes(adu[:2]), adu[6], METER)[:-4], 5 * MS
        )

    one, _, _ = scan(replace(TCP, framing=Framing.MBAP_DATAGRAM), (4,), prepare)
    assert states(one) == {4: State.UNCLEAR}
    assert "that is not one answer" in one.findings[4].answer
    assert one.findings[4].pdu == b""


def test_an_answer_of_another_kind_counts_over_tcp() -> None:
    one, _, _ = scan(TCP, (4,), lambda link: server(link, lambda *_: b"\x03\x02\x12\x34"))
    assert states(one) == {4: State.ANSWERS}


def test_progress_never_goes_back() -> None:
    told: list[tuple[str, int, int]] = []

    async def main() -> None:
        link, bus = make(RTU)
        line(link, {(unit, 17): ILLEGAL_FUNCTION for unit in range(1, 6)})
        await Scan(bus, range(1, 8), []).run(lambda *what: told.append(what))

    run(main())
    assert told == [
        *(("asking", n, 7) for n in range(1, 8)),
        *(("identifying", n, 5) for n in range(1, 6)),
    ]


@pytest.mark.parametrize("timing", [RTU, TCP, replace(TCP, framing=Framing.MBAP_DATAGRAM)])
def test_a_link_that_cannot_be_opened(timing: Timing) -> None:
    async def main() -> None:
        link, bus = make(timing)
        link.open_failures = [OSError(16, "another program has it open")]
        with pytest.raises(LinkDown, match="another program has it open"):
            await Scan(bus, (1, 2), []).run(nobody)
        assert link.sent == []

    run(main())


def test_a_link_that_comes_back() -> None:
    def prepare(link: FakeLink) -> None:
        def hear(adu: bytes) -> None:
            if len(link.sent) == 2:
                link.open_failures = [OSError(2, "No such file or directory")] * 2
                link.break_off()
            else:
                link.say(rtu_frame(adu[0], ILLEGAL_FUNCTION), 20 * MS)

        link.on_send = hear

    one, _, _ = scan(RTU, (1, 2, 3), prepare)
    assert set(states(one).values()) == {State.ANSWERS}
    assert one.problem == ""


def test_a_link_that_stays_away() -> None:
    def prepare(link: FakeLink) -> None:
        def hear(adu: bytes) -> None:
            if adu[0] == 3:
                link.open_failures = [OSError(2, "No such file or directory")] * 99
                link.break_off()
            else:
                link.say(rtu_frame(adu[0], ILLEGAL_FUNCTION), 20 * MS)

        link.on_send = hear

    one, _, took = scan(RTU, range(1, 9), prepare)
    assert list(one.findings) == [1, 2]
    assert one.problem
    assert took < 6000 * MS


def test_a_peer_that_closes_instead_of_answering() -> None:
    one, link, _ = scan(
        TCP, range(1, 9), lambda link: setattr(link, "on_send", lambda _: link.break_off("closed"))
    )
    assert one.problem == "fake: closed"
    assert len(link.sent) == 3
    assert set(states(one).values()) <= {State.UNCLEAR}


def test_silence_does_not_open_a_connection_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """As it does elsewhere: nobody is there, and each opening would take its time."""
    monkeypatch.setattr(FakeLink, "is_deaf", property(lambda _: True))
    one, link, took = scan(TCP, range(1, 21), lambda _: None)
    assert set(states(one).values()) == {State.SILENT}
    assert len(link.opened) == 1
    assert abs(took - 21 * TCP.timeout) < 10 * MS  # the last one's answer may be late


def test_what_is_asked_where(tmp_path: Path) -> None:
    devices(tmp_path)
    settings = load(tmp_path / "roclog.toml")
    assert questions(settings.connections["line"]) == tuple(range(1, 248))
    assert questions(settings.connections["plant"]) == (0, *range(1, 248), 255)


@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_no_msx_is_asked_by_any_name(tmp_path: Path, transport: str) -> None:
    config = tmp_path / "roclog.toml"
    other = "udp" if transport == "tcp" else "tcp"
    config.write_text(
        f'[connections.lab]\ntransport = "{transport}"\nhost = "Module"\nport = 512\n'
        f'[connections.same]\ntransport = "{other}"\nhost = "module"\nport = 512\n'
        f'[connections.plant]\ntransport = "{other}"\nhost = "plant"\nport = 512\n'
        '[devices.msx1]\nprofile = "msx-e3317"\nconnection = "lab"\n'
    )
    settings = load(config)
    for name in ("lab", "same"):
        assert "msx1 (msx-e3317) is there" in refusal(settings, name)
    assert refusal(settings, "plant") == ""


def test_no_msx_is_asked_by_its_address(tmp_path: Path) -> None:
    config = tmp_path / "roclog.toml"
    config.write_text(
        '[connections.lab]\ntransport = "udp"\nhost = "127.0.0.1"\nport = 512\n'
        '[connections.same]\ntransport = "tcp"\nhost = "localhost"\nport = 512\n'
        '[connections.other]\ntransport = "tcp"\nhost = "localhost"\nport = 502\n'
        '[devices.msx1]\nprofile = "msx-e3317"\nconnection = "lab"\n'
    )
    settings = load(config)
    assert "msx1 (msx-e3317) is there" in refusal(settings, "same")
    assert refusal(settings, "other") == ""

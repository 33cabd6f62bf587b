"""Everything a register map can say of values, through the real command against a real device."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from bench.recorder import Recorder, roclog
from bench.recording import files, items, metadata
from bench.registers import (
    COILS,
    DISCRETE,
    HOLDING,
    INPUT,
    OCTETS,
    Block,
    Cell,
    Device,
    Doubtful,
)
from bench.registers_judge import Judge, check_requests, facts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


NO_DIGITS = Doubtful(None)
"""Missing, and named as doubtful as well: the words are none that the type knows."""
WIDE: dict[str, tuple[str, tuple[Any, ...], tuple[Any, ...]]] = {
    "u32": ("uint32", (0, 4294967295, 0x01020304), ()),
    "i32": ("int32", (-2147483648, 2147483647, 0x01020304), ()),
    "f32": ("float32", (1.5, -3.4028234663852886e38, 1e-45), ()),
    "d8": ("bcd32", (0, 99999999, "1234567A"), (0, 99999999, NO_DIGITS)),
    "u64": ("uint64", (0, 18446744073709551615, 0x0102030405060708), ()),
    "i64": ("int64", (-9223372036854775808, 9223372036854775807, 0x0102030405060708), ()),
    "f64": ("float64", (0.1, -1.7976931348623157e308, 5e-324), ()),
    "d16": ("bcd64", (0, 9999999999999999, "12F4567812345678"), (0, 9999999999999999, NO_DIGITS)),
}
"""Kind of the device: type of the configuration, what it has, what is recorded if that differs."""
ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")
MS = 10**6
EVERY = {"every": 0.15}


def wide(default: str) -> Block:
    """Every type of several registers, in the device's order and in each of its own."""

    def cells() -> Iterator[Cell]:
        for kind, (type_, gives, means) in WIDE.items():
            size = 4 if kind in ("u32", "i32", "f32", "d8") else 8
            toml = f'type = "{type_}"'
            yield Cell(f"{kind}_own", kind, gives, toml, means, OCTETS[default][size])
            for order in ORDERS:
                said = f'{toml}, word_order = "{order}"'
                name = f"{kind}_{order.lower()}"
                yield Cell(name, kind, gives, said, means, OCTETS[order][size])

    return Block("wide", HOLDING, 1000, tuple(cells()), group=EVERY)


def narrow() -> Block:
    """Types of one register, of which only the octets can be swapped."""
    shapes: list[tuple[str, str, tuple[Any, ...], tuple[Any, ...]]] = [
        ("u16", "uint16", (0, 65535, 258), ()),
        ("i16", "int16", (-32768, 32767, 258), ()),
        ("d4", "bcd16", (0, 9876, "1A34"), (0, 9876, NO_DIGITS)),
        ("pair", "minutes_seconds", ([0, 0], [59, 58], [1, 60]), (0, 3598, Doubtful(120))),
        ("pair", "month_day", ([0, 0], [12, 31], [13, 1]), (0, 1231, Doubtful(1301))),
    ]
    cells = []
    for kind, type_, gives, means in shapes:
        for order, own in (("", ""), ("AB", ', word_order = "AB"'), ("BA", ', word_order = "BA"')):
            octets = OCTETS[order][2] if order else ""
            name = f"{type_}_{order.lower() or 'own'}"
            cells.append(Cell(name, kind, gives, f'type = "{type_}"{own}', means, octets))
    for order in ("AB", "BA"):
        toml = f'type = "text", words = 3, word_order = "{order}"'
        cells.append(
            Cell(
                f"text_{order.lower()}", "chars:6", ("ab", "", "=1+2x"), toml, (), OCTETS[order][2]
            )
        )
    return Block("narrow", INPUT, 0, tuple(cells), group=EVERY)


def meaning() -> Block:
    """Scale, add, range, sentinels, a status that says so, bits, parts and names of numbers."""
    gated = 'valid_when = { point = "status", values = [0, 7] }'
    nan, inf = math.nan, math.inf
    cells = (
        Cell("status", "u16", (0, 7, 1), 'type = "uint16", meanings = { 0 = "good", 1 = "bad" }'),
        Cell(
            "temperature",
            "i16",
            (215, -3, 9999),
            'type = "int16", scale = 0.1, unit = "Cel", range = [-40, 85.5]',
            (21.5, -0.3, Doubtful(999.9)),
        ),
        Cell("orp", "u16", (1500, 0, 65535), 'type = "uint16", add = -2000',
             (-500.0, -2000.0, 63535.0)),
        Cell(
            "line",
            "i32",
            (57, -57, 2147483647),
            'type = "int32", scale = 0.01, add = 0.5, word_order = "ABCD"',
            (1.07, -0.07, 21474836.97),
            "1234",
        ),
        Cell(
            "sensor",
            "i16",
            (-32768, 12, -32767),
            'type = "int16", scale = 0.5, sentinels = { -32768 = "no sensor", 0x8001 = "broken" }',
            (None, 6.0, None),
        ),
        Cell(
            "level",
            "u16",
            (65535, 1, 2),
            'type = "uint16", sentinels = { 65535 = "no answer of the probe" }',
            (None, 1, 2),
        ),
        Cell(
            "single",
            "f32",
            (-9999.5, 1.25, inf),
            'type = "float32", word_order = "ABCD", sentinels = { "-9999.5" = "off" }',
            (None, 1.25, Doubtful(inf)),
            "1234",
        ),
        Cell("own_nan", "f64", (nan, -inf, -0.0), 'type = "float64", word_order = "ABCD"',
             (nan, Doubtful(-inf), -0.0), "12345678"),
        Cell("flow", "u16", (5, 6, 7), f'type = "uint16", scale = 0.1, {gated}', (0.5, 0.6, None)),
        Cell("count", "u32", (5, 6, 7), f'type = "uint32", word_order = "ABCD", {gated}',
             (5, 6, None), "1234"),
        Cell(
            "alarms",
            "u16",
            (0x0001, 0x8A05, 0xFFFF),
            'type = "uint16", bits = { 0 = "running", 15 = "fault", 1-3 = "mode", 8-11 = "stage" }',
            more={
                "running": (True, True, True),
                "fault": (False, True, True),
                "mode": (0, 2, 7),
                "stage": (0, 10, 15),
            },
        ),
        Cell(
            "wide_alarms",
            "u32",
            (0x80000001, 0, 0x00FF0000),
            'type = "uint32", word_order = "CDAB", bits = { 31 = "top", 16-23 = "octet" }',
            order="3412",
            more={"top": (True, False, False), "octet": (0, 0, 255)},
        ),
        Cell("by_bit", "u16", (1, 2, 3),
             'type = "uint16", valid_when = { point = "fault", values = [0] }', (1, None, None)),
        Cell("by_part", "u16", (1, 2, 3),
             'type = "uint16", valid_when = { point = "stage", values = [0, 15] }', (1, None, 3)),
        Cell("tight", "u64", (2**53 + 1, 2**53 + 2, 2**53 + 3),
             f'type = "uint64", word_order = "ABCD", range = [0, {2**53 + 2}]',
             (2**53 + 1, 2**53 + 2, Doubtful(2**53 + 3)), "12345678"),
    )  # fmt: skip
    return Block("meaning", HOLDING, 1200, cells, group=EVERY)


def bits(name: str, area: int, at: int, count: int) -> Block:
    """One cell for each bit; the last one is behind a gap, and gates the one before."""
    cells = tuple(
        Cell(f"{name}_{n}", "bit", tuple((n * s) % 3 == 1 for s in (1, 2, 5)), 'type = "bit"')
        for n in range(count)
    )
    gates = cells[0].gives
    last = Cell(
        "gated",
        "bit",
        (True, False, True),
        f'type = "bit", valid_when = {{ point = "{name}_1", values = [1] }}',
        tuple(v if ok else None for v, ok in zip((True, False, True), cells[1].gives, strict=True)),
    )
    assert gates
    return Block(name, area, at, (*cells, last), group=EVERY, at_of={"gated": count + 3})


def loose(name: str, at: int, count: int) -> Block:
    """Words that stand still, so that it does not matter when each is read."""
    first = Cell("first", "u16", (at,), 'type = "uint16"')
    last = Cell("last", "u32", (at * 65537,), 'type = "uint32", word_order = "ABCD"', (), "1234")
    toml = 'atomic = false\nperiod = "300ms"'
    return Block(name, INPUT, at, (first, last), toml, at_of={"last": count - 2}, count=count)


LOOSE = (loose("left", 3000, 10), loose("right", 3010, 20), loose("large", 3100, 300))
IDENTITY = Block(
    "identity",
    HOLDING,
    100,
    (
        Cell("maker", "chars:20", ("Small & Sons",), 'type = "text", words = 10'),
        Cell("model", "chars:8", ("AB-1234",), 'type = "text", words = 4, word_order = "BA"',
             (), "21"),
        Cell("firmware", "u16", (135,), 'type = "uint16", scale = 0.01', (1.35,)),
        Cell("option", "u16", (65535,),
             'type = "uint16", scale = 0.1, sentinels = { 65535 = "none" }', (None,)),
        Cell("plain", "u16", (9,), 'type = "uint16", sentinels = { 9 = "not fitted" }', (None,)),
        Cell("own_nan", "f32", (math.nan,), 'type = "float32", word_order = "ABCD"', (None,),
             "1234"),
        Cell("serial", "u64", (2**60 + 1,), 'type = "uint64", word_order = "DCBA"', (), "87654321"),
        Cell("switches", "u16", (5,),
             'type = "uint16", bits = { 0 = "heater", 1 = "pump", 2-3 = "fan" }',
             more={"heater": (True,), "pump": (False,), "fan": (1,)}),
    ),
    'read = "once"',
)  # fmt: skip
NAMEPLATE = Block(
    "nameplate",
    HOLDING,
    200,
    (
        Cell("first", "chars:4", ("head",), 'type = "text", words = 2'),
        Cell("last", "chars:4", ("tail",), 'type = "text", words = 2'),
    ),
    'read = "once"\natomic = false',
    at_of={"last": 198},
)
FITTED = Block(
    "fitted",
    COILS,
    500,
    (
        Cell("spare", "bit", (True,), 'type = "bit"'),
        Cell("second", "bit", (False,), 'type = "bit"'),
    ),
    'read = "once"',
)


@pytest.mark.parametrize(("line", "default"), [("tcp", "CDAB"), ("udp", "DCBA"), ("pty", "BADC")])
def test_the_whole_vocabulary(tmp_path: Path, line: str, default: str) -> None:
    moving = (
        wide(default),
        narrow(),
        meaning(),
        bits("coil", COILS, 7, 13),
        bits("input", DISCRETE, 100, 21),
    )
    blocks = (*moving, *LOOSE, IDENTITY, NAMEPLATE, FITTED)
    refuse = [{"area": COILS, "first": 7, "last": 7, "code": 4, "times": 2}]
    with Device(tmp_path, *blocks, line=line, refuse=refuse) as device:
        toml = device.toml(f'poll = "100ms"\nword_order = "{default}"')
        recorder = Recorder(tmp_path, toml)
        with recorder.start() as child:

            def enough() -> bool:
                return min(device.read(b.name) for b in moving) >= 8

            child.while_it_runs(enough, "eight samples", 30)
            assert child.stop() == 0, child.talk()
        truth = device.end()
        judge = Judge(recorder.directory, tmp_path / "csv", device)
    assert check_requests(truth, blocks) == []
    for block in (*moving, *LOOSE):
        found = judge.block(block)
        assert found.wrong == [], block.name
        assert set(found.samples) >= ({1} if block in LOOSE else set(range(1, 7))), block.name
    refused, again = judge.events("refused")
    assert refused.startswith("block coil refused, asked for all the same: exception 4")
    assert again == "block coil answered again"
    shapes = {(r["at"], r["count"]) for r in truth.of("read") if r["area"] == INPUT and r["at"]}
    assert shapes == {(3000, 30), (3100, 125), (3225, 125), (3350, 50)}
    at = [r["mono_ns"] for r in truth.of("read") if (r["area"], r["at"]) == (INPUT, 3000)]
    assert (at[-1] - at[0]) / (len(at) - 1) == pytest.approx(0.3e9, rel=0.05)
    check_facts(recorder.directory)
    check_ndjson(recorder.directory, tmp_path / "json")


def test_a_faulty_line_changes_no_value(tmp_path: Path) -> None:
    """Late, lost, short and spoiled answers: nothing wrong, and what was left out is told."""
    blocks = (wide("ABCD"), narrow(), bits("coil", COILS, 7, 13))
    shares = dict.fromkeys(("late", "drop", "corrupt", "garbage", "short"), 0.04)
    faults: dict[str, Any] = {**shares, "late_by": 0.15, "seed": 4}
    with Device(tmp_path, *blocks, line="pty", **faults) as device:
        toml = device.toml('poll = "100ms"', connection='timeout = "100ms"')
        recorder = Recorder(tmp_path, toml)
        with recorder.start() as child:
            wanted = 75

            def enough() -> bool:
                return device.truth.count("read") > wanted

            child.while_it_runs(enough, f"{wanted} answers", 40)
            assert child.stop() == 0, child.talk()
        fates = [line["fate"] for line in device.end().of("read")]
        judge = Judge(recorder.directory, tmp_path / "csv", device)
    assert check_requests(judge.truth, blocks) == []
    assert len(set(fates)) >= 5, fates
    links = [item.values for item in items(recorder.directory, f"/{device.name}/link")]
    polls, skipped = sum(link.polls for link in links), sum(link.skipped for link in links)
    for block in blocks:
        found = judge.block(block)
        assert found.wrong == [], block.name
        reads = [message.values.read_at for message in found.messages]
        told = [gap for gap in judge.gaps() if gap.block == block.name]
        for before, after in pairwise(reads):
            is_told = any(gap.since <= before + MS and after - MS <= gap.to for gap in told)
            late = 0.2e9  # by two periods: then a turn is left out
            assert is_told or after - before < 0.1e9 + late, (block.name, after - before)
        missing = sum(gap.expected for gap in told)
        assert polls <= len(reads) + missing <= polls + skipped, "each turn brought one or is told"
        assert missing > 0
        assert len(reads) > 10


def check_facts(directory: Path) -> None:
    """Also the reasons of what is missing, which stand in the map."""
    said = metadata(files(directory)[-1])["roclog.device.dev"]
    told = {block["block"]: block["points"] for block in json.loads(said["register_map"])}
    reasons = {point["name"]: point.get("sentinels") for point in told["meaning"]}
    assert reasons["sensor"] == {"-32768": "no sensor", "-32767": "broken"}
    assert reasons["single"] == {"-9999.5": "off"}
    for block in (IDENTITY, NAMEPLATE, FITTED):
        sample = {"k": 1, "values": {cell.name: cell.gives[0] for cell in block.cells}}
        meant = {name: value for cell in block.cells for name, value in cell.meant(sample)}
        assert facts(said, block) == meant


def check_ndjson(directory: Path, out: Path) -> None:
    """What is missing is null there, and the reason follows from the map in the metadata."""
    done = roclog(
        "export", directory, "--format", "ndjson", "--out", out, "--channel", "/dev/meaning"
    )
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in (out / "dev.meaning.ndjson").read_text().splitlines()]
    (first, *_) = (line for line in lines if line["values"]["temperature"] == 21.5)
    values = first["values"]
    assert (values["sensor"], values["level"], values["single"]) == (None, None, None)
    assert (values["flow"], values["count"], values["by_bit"]) == (0.5, 5, 1)


def strict(text: str) -> Any:
    """JSON as its standard has it: without NaN and Infinity."""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def odd_values() -> Block:
    """What `read` must show whole: wide numbers, what is missing and why, what is no number."""
    gate = 'valid_when = { point = "status", values = [0, 1] }'
    quiet = 'sentinels = { 0x8000 = "no sensor" }'
    gives: tuple[tuple[str, list[int], str], ...] = (
        ("status", [7], 'type = "uint16"'),
        ("energy", [0xFFFF] * 4, 'type = "uint64"'),
        ("level", [0x8000], f'type = "int16", scale = 0.1, {quiet}'),
        ("flow", [0x3F80, 0], f'type = "float32", {gate}'),
        ("digits", [0x00FA], 'type = "bcd16"'),
        ("quiet", [0x7FC0, 0], 'type = "float32"'),
        ("over", [0x7F80, 0], 'type = "float32", scale = 2'),
        ("under", [0xFF80, 0], 'type = "float32"'),
        ("heat", [9], 'type = "uint16", range = [0, 5], unit = "Cel"'),
        ("mode", [0], 'type = "uint16", meanings = { 0 = "off" }'),
        ("stamp", [0x6682, 0x8227], ""),
    )
    cells = tuple(Cell(name, "words", (words,), toml) for name, words, toml in gives)
    time = 'time = { source = "unix", offset = 17 }'
    return Block("odd", HOLDING, 100, cells, time)


def test_what_read_shows(tmp_path: Path) -> None:
    with Device(tmp_path, odd_values()) as device:
        config = tmp_path / "roclog.toml"
        config.write_text(device.toml('poll = "100ms"'))
        config.chmod(0o644)
        text = roclog("read", config, "dev").stdout
        found = strict(roclog("read", config, "dev", "--json").stdout)["blocks"]["odd"]
    shown = [" ".join(line.split()) for line in text.splitlines()]
    assert "101 FFFF FFFF FFFF FFFF energy 18446744073709551615" in shown
    assert "105 8000 level - no measurement: no sensor" in shown
    assert "106 3F80 0000 flow - no measurement: status is 7, valid with 0 or 1" in shown
    assert "108 00FA digits - not plausible as bcd16. no measurement: no decimal digits" in shown
    assert "115 0009 heat 9 Cel outside the documented range 0 to 5." in shown
    assert shown[-1] == "device time 2024-07-01T10:17:11Z"
    assert found["values"] == {
        "status": 7,
        "energy": 18446744073709551615,
        **dict.fromkeys(("level", "flow", "digits", "quiet", "over", "under")),
        "heat": 9,
        "mode": 0,
    }
    assert found["why_null"] == {
        "level": "no sensor",
        "flow": "status is 7, valid with 0 or 1",
        "digits": "no decimal digits",
        "quiet": "NaN",
        "over": "Infinity",
        "under": "-Infinity",
    }
    assert found["doubtful"] == ["digits", "over", "under", "heat"]
    assert (found["device_time"], found["time_flags"]) == (1719829031 * 10**9, [])

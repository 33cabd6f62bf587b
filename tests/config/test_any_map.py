"""Any map that a configuration can describe reads any words: as a second implementation does, and
through the message, CSV and NDJSON without an exception.
"""

from __future__ import annotations

import io
import json
import math
import struct
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.records import Channel, Message, Schema

from roclog.clock import Instant
from roclog.config import load
from roclog.export import Style, _CsvRows
from roclog.recording.decoding import ChannelDecoder
from roclog.recording.entries import block_channel
from roclog.recording.objects import as_line
from roclog.recording.protobuf import Readers
from roclog.recording.records import Sample
from roclog.samples import Reading, SampleMaker
from roclog.schema import Origin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from roclog.config import Settings
    from roclog.config.settings import Device
    from roclog.register_map import Block

Table = dict[str, Any]
ANY = settings(
    deadline=None,
    max_examples=200,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
NOW = Instant(1_790_000_000_000_000_000, 10**12)


# The way of a sample: words, message, protobuf library, CSV and NDJSON


def recorded(device: Device, block: Block, octets: bytes) -> Sample:
    """What a recording gives back of the octets of one answer."""
    maker = SampleMaker(device.name, device.profile.name, block, device.word_order, bytes(16))
    reading = Reading(maker.words(octets), NOW, NOW, NOW, 0)
    if block.handshake is None:
        maker.known(1, octets)
    maker.doubts(reading)
    entry = maker.message(reading, 1, Origin.CYCLIC, {})
    info = block_channel(device.name, device.profile.name, block, maker.kind)
    decoder = ChannelDecoder(
        Channel(1, info.topic, "protobuf", dict(info.metadata), 1),
        Schema(1, info.schema, "protobuf", info.schema_name),
        Readers(),
    )
    assert not decoder.channel.problem
    message = Message(1, entry.log_time, entry.data, entry.publish_time, entry.sequence)
    sample = decoder.decode(message)
    assert isinstance(sample, Sample)
    assert sample.raw == octets
    json.loads(as_line(sample))
    sheet = io.StringIO()
    _CsvRows(decoder.channel, sheet, Style()).write(sample)
    return sample


def hold_any_words(found: Settings, octets: Callable[[int], bytes]) -> None:
    """octets: a function from a number of octets to so many."""
    for device in found.devices.values():
        for block in device.profile.blocks:
            for answer in (bytes(block.octets), b"\xff" * block.octets, octets(block.octets)):
                recorded(device, block, _without_padding(block, answer))


def _without_padding(block: Block, answer: bytes) -> bytes:
    """What a device fills the last octet of bits with is not kept."""
    if not block.table.has_bits or not block.count % 8:
        return answer
    return answer[:-1] + bytes([answer[-1] & (1 << block.count % 8) - 1])


# Maps, as tables of a configuration

SIZES = {
    "uint16": 2, "int16": 2, "uint32": 4, "int32": 4, "uint64": 8, "int64": 8, "float32": 4,
    "float64": 8, "bcd16": 2, "bcd32": 4, "bcd64": 8, "minutes_seconds": 2, "month_day": 2,
}  # fmt: skip
CODES = {"float32": ">f", "float64": ">d"}
_PACKED = ("uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")
_NUMBERS = st.integers(-(10**6), 10**6) | st.floats(-1e9, 1e9).map(lambda x: float(f"{x:.4g}"))
_SCALES = st.sampled_from([0.1, 0.01, 1, 2.5, 1e-30, 1e30, 3, -0.1, -1])
_NO_OFFSET = {"source", "year_base"}
_DATES = {
    "year": [1970, 1999, 2000, 2024, 2023, 2100, 2262],
    "month_day": [0x021D, 0x021C, 0x0C1F, 0x0101, 0x0D01, 0x0120],
    "hour_minute": [0x0000, 0x173B, 0x1800, 0x173C],
    "millisecond_of_minute": [0, 59_999, 60_000, 60_999],
    "year_month": [0x1802, 0x0001, 0x630C, 0x0000],
    "day_hour": [0x1D17, 0x0100, 0x1F18, 0x1F17],
    "minute": [0, 59, 60],
    "second": [0, 59, 60],
    "millisecond": [0, 999, 1000],
}
"""Words at the edges of a calendar."""
_NOTEWORTHY = st.sampled_from(
    [0, 1, 2, 0x7FFF, 0x8000, 0xFFFF, 0x1234, 0x3B3B, 0x3C00, 0x0C1F, 0x7F80]
)
WORDS = _NOTEWORTHY | st.integers(0, 0xFFFF)


@st.composite
def values(draw: Any, name: str, type_: str, words: int = 0) -> Table:
    """A point or a field without its place."""
    made: Table = {"name": name, "type": type_}
    if type_ in ("text", "bytes"):
        return {**made, "words": words}
    is_free = type_ not in ("minutes_seconds", "month_day", "bit")
    if draw(st.booleans()):
        made["unit"] = draw(st.sampled_from(["Cel", "L/min", "1", "%"]))
    is_scaled = is_free and draw(st.booleans())
    if is_scaled:
        made["scale"] = draw(_SCALES)
        if draw(st.booleans()):
            made["add"] = draw(_NUMBERS)
    if type_ != "bit" and draw(st.booleans()):
        reached = made.get("add", 0)  # the value of the number 0
        given = sorted(draw(st.tuples(_NUMBERS, _NUMBERS)))
        made["range"] = [min(given[0], reached), max(given[1], reached)]
    if not is_scaled and type_ in ("uint16", "uint32", "uint64") and draw(st.booleans()):
        top = 8 * SIZES[type_] - 1
        made["bits"] = {
            "0": f"{name}_low",
            "2": f"{name}_two",
            f"{top - 6}-{top - 3}": f"{name}_mid",
        }
    elif is_free and draw(st.booleans()):
        number = draw(st.sampled_from([0, 1, 7]))
        made["sentinels"] = {str(number): "none"}
    if draw(st.booleans()) and not type_.startswith("float"):
        made["meanings"] = {"0": "off", "0x1": "on"}
    return made


@st.composite
def register_blocks(draw: Any, name: str) -> Table:
    points: list[Table] = []
    offset = 0
    for index in range(draw(st.integers(1, 8))):
        type_ = draw(st.sampled_from([*SIZES, "text", "bytes"]))
        words = draw(st.integers(1, 5)) if type_ in ("text", "bytes") else 0
        offset += draw(st.integers(0, 3))
        made = {**draw(values(f"{name}_p{index}", type_, words)), "offset": offset}
        if words == 0:
            del_orders = ["AB", "BA"] if SIZES[type_] == 2 else ["ABCD", "CDAB", "BADC", "DCBA"]
        else:
            made["words"], del_orders = words, ["AB", "BA"]
        if draw(st.booleans()):
            made["word_order"] = draw(st.sampled_from(del_orders))
        offset += words or SIZES[type_] // 2
        points.append(made)
    points.append(status(f"{name}_ok", offset))
    offset += 1
    gate(draw, points)
    tables = ["input_registers", "holding_registers"]
    made = {
        "name": name,
        "table": draw(st.sampled_from(tables)),
        "address": draw(st.integers(0, 60000)),
        "points": points,
        "count": offset + draw(st.integers(0, 3)) + 8,
    }
    free = made["count"] - 8  # behind the points
    times: list[Table] = [
        {"source": "unix", "offset": free},
        {"source": "unix", "offset": free, "epoch": 946684800, "word_order": "CDAB"},
        {"source": "unix_us", "seconds": free + 2, "microseconds": free},
        {"source": "cp56", "offset": free},
        {"source": "calendar", "year": free, "month_day": free + 1, "hour_minute": free + 2,
         "millisecond_of_minute": free + 3},
        {"source": "calendar", "year_month": free, "day_hour": free + 1, "minute": free + 2,
         "second": free + 3, "millisecond": free + 4, "year_base": 2000},
    ]  # fmt: skip
    if draw(st.booleans()):
        made["time"] = draw(st.sampled_from(times))
    return made


@st.composite
def bit_blocks(draw: Any, name: str) -> Table:
    points: list[Table] = []
    offset = 0
    for index in range(draw(st.integers(1, 12))):
        offset += draw(st.integers(0, 3))
        points.append({**draw(values(f"{name}_p{index}", "bit")), "offset": offset})
        offset += 1
    gate(draw, points)
    table = draw(st.sampled_from(["coils", "discrete_inputs"]))
    return {"name": name, "table": table, "address": draw(st.integers(0, 60000)), "points": points}


def status(name: str, *offset: int) -> Table:
    made = {"name": name, "type": "uint16", "bits": {"0": f"{name}_bit", "1-2": f"{name}_part"}}
    return made | ({"offset": offset[0]} if offset else {})


def gate(draw: Any, points: list[Table]) -> None:
    """Let some points depend on the last one, or on a bit or a part of it."""
    names = [points[-1]["name"], *points[-1].get("bits", {}).values()]
    if "sentinels" in points[-1] or draw(st.booleans()):
        return
    for made in points[:-1]:
        if made["type"] != "text" and draw(st.booleans()):
            good = {"point": draw(st.sampled_from(names)), "values": [draw(st.integers(0, 1))]}
            made["valid_when"] = good


@st.composite
def layouts(draw: Any) -> list[Table]:
    fields: list[Table] = []
    for index in range(draw(st.integers(1, 6))):
        type_ = draw(st.sampled_from([*_PACKED, "text", "bytes"]))
        made = draw(values(f"f{index}", type_))
        if made.pop("words", None) is not None:
            made["size"] = draw(st.integers(1, 9))
        elif draw(st.booleans()):
            made["count"] = draw(st.integers(1, 3))
        fields.append(made)
    fields.append(status("ok"))
    gate(draw, fields)
    return fields


def toml(value: Any) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value)


def configuration(device: Table) -> str:
    keys = [f"{key} = {toml(value)}" for key, value in device.items()]
    net = ["[connections.net]", 'transport = "tcp"', 'host = "10.0.0.1"', "[devices.d]"]
    return "\n".join([*net, 'connection = "net"', *keys])


# A second implementation: from the tables to what a sample says


def moved(octets: bytes, order: str) -> bytes:
    """Most significant first."""
    pairs = [octets[i : i + 2] for i in range(0, len(octets), 2)]
    if order in ("CDAB", "DCBA"):
        pairs.reverse()
    return b"".join(pair[::-1] if order in ("BADC", "DCBA", "BA") else pair for pair in pairs)


def number_of(type_: str, octets: bytes) -> tuple[Any, bool]:
    """The number, and whether such octets are legal."""
    if type_ in CODES:
        number = struct.unpack(CODES[type_], octets)[0]
        return number, not math.isinf(number)
    if type_.startswith("bcd"):
        digits = octets.hex()
        return (int(digits), True) if digits.isdecimal() else (None, False)
    if type_ == "minutes_seconds":
        return 60 * octets[0] + octets[1], octets[0] < 60 and octets[1] < 60
    if type_ == "month_day":
        fits = octets[0] in range(1, 13) and octets[1] in range(1, 32)
        return 100 * octets[0] + octets[1], fits or octets == b"\0\0"
    return int.from_bytes(octets, signed=type_.startswith("int")), True


def told(made: Table, octets: bytes) -> tuple[dict[str, Any], bool, bool]:
    """Values by name, whether the point is doubtful, whether it is missing; without the gate."""
    name, type_ = made["name"], made["type"]
    if type_ == "bytes":
        return {name: octets}, False, False
    if type_ == "text":
        text = octets[: octets.index(0)] if 0 in octets else octets
        return {name: text.decode("latin-1")}, any(not 32 <= o < 127 for o in text), False
    number, legal = number_of(type_, octets) if type_ != "bit" else (octets[0], True)
    missing = number is None or number in [int(key) for key in made.get("sentinels", {})]
    value = number
    if {"scale", "add"} & made.keys() and not missing and math.isfinite(number):
        exact = Fraction(number) * Fraction(Decimal(repr(made.get("scale", 1))))
        exact += Fraction(Decimal(repr(made.get("add", 0))))
        try:
            value = float(exact)
        except OverflowError:
            value, legal = (math.inf if exact > 0 else -math.inf), False
    doubtful = not legal
    if "range" in made and not missing and value == value:  # noqa: PLR0124 - NaN
        low, high = made["range"]
        doubtful = doubtful or not low <= value <= high
    found = {name: bool(value) if type_ == "bit" else value}
    for place, bit in made.get("bits", {}).items():
        first, _, last = place.partition("-")
        part = number >> int(first) & (1 << int(last or first) - int(first) + 1) - 1
        found[bit] = part if last else bool(part)
    return found, doubtful, missing


def expected(
    places: Iterator[tuple[Table, bytes]],
) -> tuple[dict[str, Any], list[str]]:
    """Values by name, None = missing; names of the doubtful points."""
    results = [(made, *told(made, octets)) for made, octets in places]
    plain = {name: value for _, found, _, _ in results for name, value in found.items()}
    values_: dict[str, Any] = {}
    doubtful: list[str] = []
    for made, found, doubt, missing in results:
        good = made.get("valid_when")
        absent = missing or (good is not None and plain[good["point"]] not in good["values"])
        values_ |= dict.fromkeys(found) if absent else found
        if doubt and (good is None or plain[good["point"]] in good["values"]):
            doubtful.append(made["name"])
    return values_, doubtful


def places_of(block: Table, order: str, octets: bytes) -> Iterator[tuple[Table, bytes]]:
    for made in block["points"]:
        at = made["offset"]
        if made["type"] == "bit":
            yield made, bytes([octets[at // 8] >> at % 8 & 1])
            continue
        size = 2 * made["words"] if "words" in made else SIZES[made["type"]]
        usual = order if made["type"] in SIZES and size > 2 else "ABCD"
        yield made, moved(octets[2 * at : 2 * at + size], made.get("word_order", usual))


def fields_of(layout: list[Table], order: str, octets: bytes) -> Iterator[tuple[Table, bytes]]:
    at = 0
    for made in layout:
        size = made["size"] if "size" in made else SIZES[made["type"]]
        for number in range(1, made.get("count", 1) + 1):
            one = dict(made)
            if "count" in made:
                one["name"] = f"{made['name']}_{number}"
                one["bits"] = {key: f"{n}_{number}" for key, n in made.get("bits", {}).items()}
            part = octets[at : at + size]
            turned = order == "little" and "size" not in made
            yield one, part[::-1] if turned else part
            at += size


def time_of(source: Table, order: str, octets: bytes) -> int | None:
    """Nanoseconds, None = no time or none that can be."""

    def word(offset: int) -> int:
        return int.from_bytes(octets[2 * offset : 2 * offset + 2])

    def wide(offset: int) -> int:
        own = source.get("word_order", order)
        return int.from_bytes(moved(octets[2 * offset : 2 * offset + 4], own))

    if source["source"] == "unix":
        seconds = wide(source["offset"])
        return (seconds + source.get("epoch", 0)) * 10**9 if seconds else None
    if source["source"] == "unix_us":
        micro = wide(source["microseconds"])
        whole = wide(source["seconds"]) * 10**9 + micro * 1000
        return whole if whole and micro < 10**6 else None
    return calendar_of({k: word(at) for k, at in source.items() if k not in _NO_OFFSET}, source)


def calendar_of(words: dict[str, int], source: Table) -> int | None:
    parts: dict[str, int] = {}
    for key, number in words.items():
        if key == "millisecond_of_minute":
            parts["second"], parts["millisecond"] = divmod(number, 1000)
        elif "_" in key:
            upper, lower = key.split("_")
            parts[upper], parts[lower] = divmod(number, 256)
        else:
            parts[key] = number
    milliseconds = parts.pop("millisecond", 0)
    if not any(words.values()) or milliseconds > 999:
        return None
    parts["year"] += source.get("year_base", 0)
    try:
        moment = datetime(**parts, tzinfo=UTC)
    except ValueError:
        return None
    nanoseconds = int(moment.timestamp()) * 10**9 + milliseconds * 10**6
    return nanoseconds if 0 < nanoseconds < 2**63 else None


# Both against each other


def assert_same(sample: Sample, wanted: tuple[dict[str, Any], list[str]]) -> None:
    named, doubtful = wanted
    assert list(sample.values) == list(named)
    for name, value in sample.values.items():
        other = named[name]
        both_nan = isinstance(value, float) and math.isnan(value) and math.isnan(other)
        assert both_nan or value == other, (name, value, other)
        assert isinstance(value, bool) == isinstance(other, bool)
    assert sorted(sample.doubtful) == sorted(doubtful)


def loaded(path: Path, device: Table) -> Device:
    path.write_text(configuration(device), encoding="utf-8")
    return load(path).devices["d"]


@ANY
@given(
    st.lists(st.booleans(), min_size=1, max_size=2).flatmap(
        lambda kinds: st.tuples(
            *(
                (bit_blocks if is_bits else register_blocks)(f"b{index}")
                for index, is_bits in enumerate(kinds)
            )
        )
    ),
    st.sampled_from(["ABCD", "CDAB", "BADC", "DCBA"]),
    st.data(),
)
def test_any_map_of_registers(
    tmp_path: Path, blocks: tuple[Table, ...], order: str, data: st.DataObject
) -> None:
    device = {"profile": "registers", "unit": 1, "word_order": order, "blocks": list(blocks)}
    made = loaded(tmp_path / "roclog.toml", device)
    for table in blocks:
        block = made.profile.block(table["name"])
        drawn = data.draw(st.lists(WORDS, min_size=block.count, max_size=block.count))
        time = table.get("time", {"source": "none"})
        for key, offset in time.items():
            if key in _DATES and data.draw(st.booleans()):
                drawn[offset] = data.draw(st.sampled_from(_DATES[key]))
        octets = b"".join(word.to_bytes(2) for word in drawn)[: block.octets]
        octets = _without_padding(block, octets)
        sample = recorded(made, block, octets)
        assert_same(sample, expected(places_of(table, order, octets)))
        if time["source"] in ("unix", "unix_us", "calendar"):
            assert sample.device_time == time_of(time, order, octets)


@ANY
@given(layouts(), st.sampled_from(["big", "little"]), st.data())
def test_any_layout_of_a_function(
    tmp_path: Path, layout: list[Table], order: str, data: st.DataObject
) -> None:
    function = {"name": "f", "register": 15300, "layout": layout, "period": "1s"}
    device = {"profile": "msx-e3317", "byte_order": order, "calls": [], "functions": [function]}
    sizes = [one.get("size", SIZES.get(one["type"], 0)) * one.get("count", 1) for one in layout]
    made = loaded(tmp_path / "roclog.toml", device)
    block = made.profile.block("f")
    drawn = data.draw(st.lists(WORDS, min_size=sum(sizes), max_size=sum(sizes)))
    octets = b"".join(word.to_bytes(2) for word in drawn)[: sum(sizes)]
    assert_same(recorded(made, block, octets), expected(fields_of(layout, order, octets)))

"""Feeds damaged configurations to the loader: settings or ConfigError, nothing else.

What is accepted must then read any words.

python tests/fuzz/fuzz_config.py [seconds] [seed]
"""

from __future__ import annotations

import random
import re
import runpy
import sys
import tempfile
import time
from pathlib import Path

from roclog.config import load

_ROOT = Path(__file__).parents[2]
_RULES = runpy.run_path(str(_ROOT / "tests/config/test_any_file.py"))
_HOLD = runpy.run_path(str(_ROOT / "tests/config/test_any_map.py"))["hold_any_words"]
_EVERYTHING = """
[connections.net]
transport = "tcp"
host = "10.0.0.1"
[connections.lab]
transport = "udp"
host = "10.0.0.2"
[devices.tank]
profile = "registers"
connection = "net"
unit = 9
word_order = "CDAB"
timezone = "Europe/Berlin"
answer_limit = "2s"
identity = ["who.number", "who.maker"]
source = "manual"
[[devices.tank.blocks]]
name = "who"
table = "holding_registers"
address = 0
read = "once"
points = [
  { name = "maker", offset = 0, type = "text", words = 4, word_order = "BA" },
  { name = "number", offset = 4, type = "uint64", word_order = "DCBA" },
]
[[devices.tank.blocks]]
name = "level"
table = "input_registers"
address = 100
count = 40
period = "250ms"
trigger = { counter = "number", first = 1, last = 60000 }
time = { source = "calendar", year_month = 30, day_hour = 31, minute_second = 32, year_base = 2000 }
points = [
  { name = "number", offset = 0, type = "uint16" },
  { name = "state", offset = 1, type = "uint32", bits = { 0 = "full", 8-11 = "mode" } },
  { name = "level", offset = 3, type = "float32", scale = 0.1, add = -40, unit = "Cel", range = [-40, 60], sentinels = { -32768 = "none" }, valid_when = { point = "mode", values = [1, 2] } },
  { name = "total", offset = 5, type = "bcd64", meanings = { 0 = "empty", 0x10 = "ten" } },
  { name = "rest", offset = 9, type = "bytes", words = 3 },
  { name = "day", offset = 12, type = "month_day" },
  { name = "at", offset = 13, type = "minutes_seconds", range = [0, 3599] },
]
[[devices.tank.blocks]]
name = "valves"
table = "coils"
address = 7
count = 13
trigger = { clear_on_read = { table = "holding_registers", address = 2, mask = 4 } }
points = [{ name = "inlet", offset = 0, type = "bit" }, { name = "outlet", offset = 12, type = "bit", valid_when = { point = "inlet", values = [1] } }]
[[devices.tank.blocks]]
name = "flagged"
table = "holding_registers"
address = 300
trigger = { flag = 9, new = 1, clear = 0, payload = ["number"] }
time = { source = "cp56", offset = 4, word_order = "DCBA" }
points = [{ name = "number", offset = 0, type = "int32" }]
[devices.msx1]
profile = "msx-e3317"
connection = "lab"
byte_order = "little"
calls = ["clock"]
[[devices.msx1.functions]]
name = "values"
register = 15300
period = "100ms"
repeatable = true
trigger = { change = ["pressure", "stamp"] }
layout = [
  { name = "counter", type = "uint32", bits = { 0 = "low", 1-31 = "high" } },
  { name = "pressure", type = "float32", count = 16, unit = "bar", valid_when = { point = "low", values = [1] } },
  { name = "label", type = "text", size = 3 },
  { name = "key", type = "bytes", size = 5 },
  { name = "stamp", type = "time_stamp" },
]
[devices.basin]
profile = "mpa-48"
connection = "net"
unit = 3
sensors = { channel_1 = "model-15", channel_2 = "model-10" }
[devices.rtu7]
profile = "mei-timestamped"
connection = "net"
unit = 1
points = [{ kind = "discrete_inputs", stamp = 7, address = 196, count = 22 }]
"""  # noqa: E501
_SEEDS = [
    "\n".join(_RULES["VALID"]),
    _EVERYTHING,
    *(path.read_text(encoding="utf-8") for path in sorted((_ROOT / "examples").glob("*.toml"))),
]
_PIECES = [
    b"=", b"[", b"]]", b"{", b"}", b'"', b"'''", b"\\u0000", b"\\U0010ffff", b"\n", b"\r", b"\0",
    b"\xff", b"#", b",", b".", b"-", b"true", b"inf", b"nan", b"0x7fffffffffffffff", b"1e400",
    b"9" * 30, b"1979-05-27T07:32:00Z", b"devices.roc1", b"[[devices]]", b"hiac-roc", b"log",
    b'"5 chars"', b'"0s"', b'"99999999999999999999d"', b'"../../etc"', b"\xe2\x80\xae", b"[" * 2000,
    b"registers", b"plug-in", b"uint64", b"bit", b"text", b"bytes", b"coils", b"DCBA",
    b"valid_when",
]  # fmt: skip
_VALUES = [
    "0", "1", "-1", "65535", "65536", "4294967296", "18446744073709551615", "9" * 25, "0.1", "-0.0",
    "1e-400", "5e-324", "1.7976931348623157e308", "inf", "-inf", "nan", "true", "[]", "{}", '""',
    '"a"', '"bit"', '"text"', '"bytes"', '"uint16"', '"uint64"', '"float32"', '"float64"',
    '"bcd64"',
    '"int64"', '"minutes_seconds"', '"month_day"', '"time_stamp"', '"AB"', '"CDAB"', '"DCBA"',
    '"coils"', '"holding_registers"', '"once"', '"registers"', '"\\u202e"', '"\\u0000"',
    '"\\ud7ff"',
    '"x" ', "1979-05-27", "07:32:00", '[["a"]]', "{ a = { b = { c = [1] } } }", '["who.number"]',
    '{ 0 = "a", 1-3 = "b", 63 = "c" }', '{ 0x8000 = "none", 1.5 = "half", 1e300 = "big" }',
    '{ point = "state", values = [0, 99999999999] }', "{ change = [] }", '{ counter = "number" }',
    '{ source = "unix", offset = 0 }', '{ source = "cp32", offset = 1 }', '"' + "x" * 300 + '"',
]  # fmt: skip
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*(?= = )")
_VALUE = re.compile(r'(?<= = )("[^"\n]*"|[-+0-9.a-z]+|\[[^\[\]\n]*\]|\{[^{}\n]*\})')


def damaged(source: random.Random) -> bytes:
    """A valid configuration with one to six random changes of octets, or of keys and values."""
    text = source.choice(_SEEDS)
    if source.random() < 0.7:
        for _ in range(source.randint(1, 4)):
            text = _retyped(source, text)
        return text.encode("utf-8", "replace")
    octets = bytearray(text.encode())
    for _ in range(source.randint(1, 6)):
        start = source.randrange(len(octets) + 1)
        end = min(len(octets), start + source.choice([0, 1, 2, 10, 50]))
        action = source.randrange(4)
        if action == 0:
            octets[start:end] = source.choice(_PIECES)
        elif action == 1:
            octets[start:end] = source.randbytes(end - start)
        elif action == 2:
            octets[start:start] = octets[start:end]
        else:
            del octets[start:end]
    return bytes(octets)


def _retyped(source: random.Random, text: str) -> str:
    """One value replaced, one key renamed after another, or one line gone, twice or elsewhere."""
    action = source.randrange(6)
    if action <= 3:
        places = list((_VALUE if action < 3 else _KEY).finditer(text))
        if not places:
            return text
        place = source.choice(places)
        other = source.choice(places)[0]
        new = source.choice([*_VALUES, other, other]) if action < 3 else other
        return text[: place.start()] + new + text[place.end() :]
    lines = text.split("\n")
    line = source.randrange(len(lines))
    moved = lines.pop(line) if action == 4 else lines[line]
    if source.random() < 0.5:
        lines.insert(source.randrange(len(lines) + 1), moved)
    return "\n".join(lines)


def main(seconds: float, seed: int) -> None:
    source = random.Random(seed)
    counts = {True: 0, False: 0}
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "roclog.toml"
        while time.monotonic() < end:
            octets = damaged(source)
            path.write_bytes(octets)
            try:
                accepted = _RULES["judge"](path)
                if accepted:
                    _HOLD(load(path), source.randbytes)
                counts[accepted] += 1
            except BaseException:
                print(f"seed {seed}, after {sum(counts.values())} files: {octets!r}")
                raise
    print(f"seed {seed}: {counts[True]} accepted, {counts[False]} refused, no other outcome")


if __name__ == "__main__":
    arguments = [*sys.argv[1:], *("10", "1")[len(sys.argv) - 1 :]]
    main(float(arguments[0]), int(arguments[1]))

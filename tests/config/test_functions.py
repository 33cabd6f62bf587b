"""``functions`` of an ``msx-e3317``: what the user declares, and every mistake in it."""

from __future__ import annotations

import struct
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roclog.config import warnings
from roclog.decode import decode, named_values
from roclog.devices.msx_e3317 import REGISTER_MAP
from roclog.register_map import (
    Block,
    Change,
    Counter,
    Point,
    SecondsMicroseconds,
    ValidWhen,
    WordOrder,
    WordType,
)
from roclog.request_plan import requests_by_period

if TYPE_CHECKING:
    from collections.abc import Callable

    from roclog.config import Settings

    Load = Callable[[str], Settings]
    Refusal = Callable[[str], list[str]]

HEAD = """
[connections.lab]
transport = "tcp"
host = "10.0.0.1"
[devices.msx-1]
profile = "msx-e3317"
connection = "lab"
"""
FUNCTION = """[[devices.msx-1.functions]]
name = "values"
register = 15300
period = "250ms"
"""
COUNTER = '{ name = "counter", type = "uint32" }'
VALUE = '{ name = "value", type = "float32", count = 16 }'
STAMP = '{ name = "stamp", type = "time_stamp" }'
KEY = "devices.msx-1.functions[0]"


def layout(*fields: str) -> str:
    return f"layout = [{', '.join(fields)}]\n"


def function(load_text: Load, text: str) -> Block:
    """The last of the functions, and no others than the documented ones before it."""
    *others, block = load_text(HEAD + text).devices["msx-1"].profile.samples
    assert tuple(others) == REGISTER_MAP.samples
    return block


def field(load_text: Load, text: str) -> Point:
    (point,) = function(load_text, FUNCTION + layout(text)).points
    return point


def test_a_function_is_as_long_as_its_layout(load_text: Load) -> None:
    block = function(
        load_text,
        FUNCTION
        + 'title = "AutoRefreshGetValues"\ntrigger = { counter = "counter" }\n'
        + layout(COUNTER, VALUE, STAMP, '{ name = "id", type = "bytes", size = 33 }')
        + "",
    )
    assert (block.address, block.count, block.octets) == (15300, 109, 109)
    assert (block.name, block.message) == ("values", "device_msx_1_values")
    assert (block.title, block.period) == ("AutoRefreshGetValues", 250_000_000)
    assert block.trigger == Counter(point="counter")
    assert block.time == SecondsMicroseconds(microseconds=68, seconds=72)
    assert [(p.name, p.offset) for p in block.points][:3] == [
        ("counter", 0),
        ("value_1", 4),
        ("value_2", 8),
    ]
    assert [(p.name, p.offset, p.type, p.words) for p in block.points][-3:] == [
        ("stamp_microseconds", 68, WordType.U32, 0),
        ("stamp_seconds", 72, WordType.U32, 0),
        ("id", 76, WordType.OCTETS, 33),
    ]


@pytest.mark.parametrize(("order", "mark"), [("big", ">"), ("little", "<")])
def test_what_a_declared_function_answers(load_text: Load, order: str, mark: str) -> None:
    text = HEAD + f'byte_order = "{order}"\n' + FUNCTION
    text += layout('{ name = "id", type = "bytes", size = 3 }', COUNTER, VALUE, STAMP)
    device = load_text(text).devices["msx-1"]
    assert device.word_order is (WordOrder.ABCD if order == "big" else WordOrder.DCBA)
    block = device.profile.samples[-1]
    numbers = [n / 8 for n in range(16)]
    octets = struct.pack(f"{mark}3sI16fII", b"ID3", 7, *numbers, 500_000, 1_413_547_200)
    decoded = decode(block, octets, device.word_order)
    found = named_values(block, decoded)
    assert (found["id"], found["counter"]) == (b"ID3", 7)
    assert [found[f"value_{n}"] for n in range(1, 17)] == numbers
    assert decoded.device_time == 1_413_547_200_500_000_000


def test_an_odd_structure_is_asked_for_as_its_whole_words(load_text: Load) -> None:
    text = FUNCTION + layout('{ name = "all", type = "bytes", size = 133 }')
    profile = load_text(HEAD + text).devices["msx-1"].profile
    (request,) = requests_by_period(profile, 10**9)[250_000_000]
    assert request.pdu == struct.pack(">BHH", 3, 15300, 66)
    assert request.answer_size == 2 + 133


def test_every_word_of_a_field(load_text: Load) -> None:
    described = (
        'title = "Level", unit = "Cel", scale = 0.1, add = -40, range = [-40, 60], '
        'sentinels = { 0x8000 = "none" }'
    )
    assert field(load_text, f'{{ name = "level", type = "int16", {described} }}') == Point(
        name="level",
        offset=0,
        type=WordType.S16,
        title="Level",
        unit="Cel",
        scale=Decimal("0.1"),
        add=Decimal(-40),
        low=Decimal(-40),
        high=Decimal(60),
        sentinels=((Decimal(-32768), "none"),),
    )


def test_arrays(load_text: Load) -> None:
    state = (
        '{ name = "state", type = "uint16", count = 2, bits = { 0 = "ready", 4-6 = "mode" }, '
        'meanings = { 0 = "off" } }'
    )
    gated = '{ name = "level", type = "uint16", valid_when = { point = "ready_2", values = [1] } }'
    names = '{ name = "who", type = "text", size = 3, count = 2 }'
    block = function(load_text, FUNCTION + layout(state, gated, names))
    first, second, level, *texts = block.points
    assert (first.name, first.bits, first.parts) == (
        "state_1",
        ((0, "ready_1"),),
        ((4, 3, "mode_1"),),
    )
    assert second.field_names == ("state_2", "ready_2", "mode_2")
    assert second.meanings == ((0, "off"),)
    assert level.valid_when == ValidWhen(point="ready_2", values=(1,))
    assert [(p.name, p.offset, p.words) for p in texts] == [("who_1", 6, 3), ("who_2", 9, 3)]


@pytest.mark.parametrize(
    ("text", "trigger"),
    [
        ('{ counter = "counter", first = 1, last = 9 }', Counter(point="counter", first=1, last=9)),
        ("{ change = [] }", Change()),
        ('{ change = ["value", "stamp"] }', Change(payload=((4, 72),))),
        ('{ change = ["value_2", "counter"] }', Change(payload=((0, 4), (8, 4)))),
    ],
)
def test_triggers(load_text: Load, text: str, trigger: Counter | Change) -> None:
    said = f"trigger = {text}\n"
    assert function(load_text, FUNCTION + said + layout(COUNTER, VALUE, STAMP)).trigger == trigger


def test_a_repeat_must_fit_the_period(load_text: Load) -> None:
    text = FUNCTION + "repeatable = true\n" + layout(COUNTER)
    assert function(load_text, text).repeatable
    (warning,) = warnings(load_text(HEAD + text))
    assert str(warning) == (
        "devices.msx-1.functions: values is repeatable, but will not be called again: "
        "two timeouts of 5s do not fit 250ms"
    )
    short = HEAD.replace("[devices", 'timeout = "125ms"\n[devices')
    assert warnings(load_text(short + text)) == []
    assert not function(load_text, FUNCTION + layout(COUNTER)).repeatable


def test_which_documented_functions_are_called(load_text: Load) -> None:
    def names(text: str) -> list[str]:
        return [block.name for block in load_text(HEAD + text).devices["msx-1"].profile.samples]

    assert names('calls = ["clock"]\n') == ["clock"]
    assert names("calls = []\n" + FUNCTION + layout(COUNTER)) == ["values"]
    every = [f'"{block.name}"' for block in REGISTER_MAP.samples]
    assert names(f"calls = [{', '.join(reversed(every))}]\n") == names("")


def test_a_documented_function_that_is_not_called_can_be_declared(load_text: Load) -> None:
    text = 'calls = ["channels_info"]\n' + FUNCTION.replace("15300", "10500") + layout(COUNTER)
    assert load_text(HEAD + text).devices["msx-1"].profile.samples[-1].address == 10500


LAYOUT = f"{KEY}.layout"
MISTAKES: dict[str, tuple[str, str]] = {
    "no functions in words": ('functions = "none"', "devices.msx-1.functions: "),
    "nothing to call": ("calls = []", "devices.msx-1.calls: none, and no functions"),
    "a call that is none": (
        'calls = ["clock", "clok"]',
        (
            'devices.msx-1.calls[1]: "clok" is not a name of clock, calibration_status, '
            'pressure_channels, acquisition_channels, channels_info, did you mean "clock"?'
        ),
    ),
    "no name": (
        FUNCTION.replace('name = "values"', "") + layout(COUNTER),
        f"{KEY}.name: missing, needed is a name",
    ),
    "no register": (
        FUNCTION.replace("register = 15300", "") + layout(COUNTER),
        f"{KEY}.register: missing, needed is the register of a function",
    ),
    "no period": (
        FUNCTION.replace('period = "250ms"', "") + layout(COUNTER),
        f'{KEY}.period: missing, needed is a duration like "1s"; the function is called again',
    ),
    "a period of nothing": (
        FUNCTION.replace("250ms", "0s") + layout(COUNTER),
        f"{KEY}.period: '0s' is not more than 0",
    ),
    "a repeat in words": (
        FUNCTION + 'repeatable = "yes"\n' + layout(COUNTER),
        f'{KEY}.repeatable: "yes" is not true or false, without quotes',
    ),
    "no layout": (FUNCTION, f"{LAYOUT}: missing, needed is the fields of the answer"),
    "no fields": (FUNCTION + layout(), f"{LAYOUT}: no fields"),
    "fields in words": (FUNCTION + 'layout = "u32[17]"', f'{LAYOUT}: "u32[17]" is not an array'),
    "a field in words": (FUNCTION + layout('"u32"'), f'{LAYOUT}[0]: "u32" is not a table'),
    "a register that does not exist": (
        FUNCTION.replace("15300", "65536") + layout(COUNTER),
        f"{KEY}.register: 65536 is not the register of a function, from 0 to 65535",
    ),
    "a register that is called already": (
        FUNCTION.replace("15300", "10500") + layout(COUNTER),
        f"{KEY}.register: 10500 is called already, as clock (MXCommon__GetTimeEx)",
    ),
    "a register that is called at the start": (
        FUNCTION.replace("15300", "10200") + layout(COUNTER),
        f"{KEY}.register: 10200 is called already, as module_type",
    ),
    "a register twice": (
        FUNCTION + layout(COUNTER) + FUNCTION.replace('"values"', '"others"') + layout(COUNTER),
        "devices.msx-1.functions[1].register: 15300 is called already, as values",
    ),
    "the name of a documented function": (
        FUNCTION.replace('"values"', '"clock"') + layout(COUNTER),
        f'{KEY}.name: "clock" is the name of another function, register 10500',
    ),
    "a name twice": (
        FUNCTION + layout(COUNTER) + FUNCTION.replace("15300", "15450") + layout(COUNTER),
        'devices.msx-1.functions[1].name: "values" is the name of another function',
    ),
    "names alike": (
        FUNCTION.replace('"values"', '"value_1"')
        + layout(COUNTER)
        + FUNCTION.replace("15300", "15450").replace('"values"', '"value1"')
        + layout(COUNTER),
        "devices.msx-1.functions: block value1: differs from value_1 only in _",
    ),
    "a reserved name": (
        FUNCTION.replace('"values"', '"gap"') + layout(COUNTER),
        f"{KEY}.name: name must be lower case",
    ),
    "more than an answer holds": (
        FUNCTION
        + layout(
            '{ name = "v", type = "uint32", count = 62 }',
            '{ name = "b", type = "bytes", size = 3 }',
        ),
        f"{LAYOUT}: 251 octets, but an answer has 2 to 250",
    ),
    "less than a word": (
        FUNCTION + layout('{ name = "b", type = "bytes", size = 1 }'),
        f"{LAYOUT}: 1 octets, but an answer has 2 to 250",
    ),
    "a type that is none": (
        FUNCTION + layout('{ name = "v", type = "u32" }'),
        f'{LAYOUT}[0].type: "u32" is not a type, did you mean "uint32"?',
    ),
    "no type": (FUNCTION + layout('{ name = "v" }'), f"{LAYOUT}[0].type: missing"),
    "no name of a field": (
        FUNCTION + layout(COUNTER, '{ type = "uint32" }'),
        f"{LAYOUT}[1].name: missing, needed is a name",
    ),
    "a key that is none": (
        FUNCTION + layout('{ name = "v", type = "uint32", offset = 4 }'),
        f"{LAYOUT}[0].offset: unknown key",
    ),
    "bytes without a size": (
        FUNCTION + layout('{ name = "v", type = "bytes" }'),
        f"{LAYOUT}[0].size: missing, needed is the number of octets of bytes",
    ),
    "a text without a size": (
        FUNCTION + layout(COUNTER, '{ name = "v", type = "text" }'),
        f"{LAYOUT}[1].size: missing, needed is the number of octets of text",
    ),
    "the size of a number": (
        FUNCTION + layout('{ name = "v", type = "uint32", size = 4 }'),
        f"{LAYOUT}[0].size: only with bytes and text, not with uint32",
    ),
    "a size of nothing": (
        FUNCTION + layout('{ name = "v", type = "bytes", size = 0 }'),
        f"{LAYOUT}[0].size: 0 is not a number from 1 to 250",
    ),
    "an array of nothing": (
        FUNCTION + layout('{ name = "v", type = "uint16", count = 0 }'),
        f"{LAYOUT}[0].count: 0 is not a number from 1 to 250",
    ),
    "a second stamp": (
        FUNCTION + layout(STAMP, STAMP.replace("stamp", "other", 1)),
        f"{LAYOUT}[1].type: a second one, but a sample has one device time",
    ),
    "an array of stamps": (
        FUNCTION + layout('{ name = "stamp", type = "time_stamp", count = 2 }'),
        f"{LAYOUT}[0].count: not with a time stamp",
    ),
    "a scaled stamp": (
        FUNCTION + layout('{ name = "stamp", type = "time_stamp", scale = 2 }'),
        f"{LAYOUT}[0].scale: not with a time stamp",
    ),
    "a field twice": (
        FUNCTION + layout(COUNTER, COUNTER),
        f"{LAYOUT}[1].name: field counter: named twice",
    ),
    "a field that is one of an array": (
        FUNCTION + layout(VALUE, '{ name = "value_2", type = "uint32" }'),
        f"{LAYOUT}[1].name: field value_2: named twice",
    ),
    "a name of every sample": (
        FUNCTION + layout('{ name = "seq", type = "uint32" }'),
        f"{LAYOUT}[0].name: 'seq' cannot be a name",
    ),
    "a name too long for an array": (
        FUNCTION + layout(f'{{ name = "{"v" * 47}", type = "uint32", count = 2 }}'),
        f"{LAYOUT}[0].name: '{'v' * 47}_1' cannot be a name",
    ),
    "a unit that is none": (
        FUNCTION + layout('{ name = "v", type = "float32", count = 3, unit = "°C" }'),
        f"{LAYOUT}[0].unit: unit '°C' is not UCUM",
    ),
    "a scale of text": (
        FUNCTION + layout('{ name = "v", type = "text", size = 8, scale = 2 }'),
        f"{LAYOUT}[0].scale: text cannot have a scale",
    ),
    "a range of bytes": (
        FUNCTION + layout('{ name = "v", type = "bytes", size = 8, range = [0, 1] }'),
        f"{LAYOUT}[0].range: bytes has no range",
    ),
    "a range upside down": (
        FUNCTION + layout('{ name = "v", type = "int16", range = [1, 0] }'),
        f"{LAYOUT}[0].range: low 1 is above high 0",
    ),
    "a sentinel that does not fit": (
        FUNCTION + layout('{ name = "v", type = "int16", sentinels = { 40000 = "none" } }'),
        f"{LAYOUT}[0].sentinels: sentinel 40000 is not a number of int16",
    ),
    "valid when nothing": (
        FUNCTION
        + layout('{ name = "v", type = "int16", valid_when = { point = "w", values = [1] } }'),
        f"{LAYOUT}[0].valid_when: no point w",
    ),
    "two triggers": (
        FUNCTION + 'trigger = { counter = "counter", change = [] }\n' + layout(COUNTER),
        f"{KEY}.trigger: is counter and change, needed is one of counter, change",
    ),
    "no trigger": (
        FUNCTION + "trigger = {}\n" + layout(COUNTER),
        f"{KEY}.trigger: is nothing, needed is one of counter, change",
    ),
    "a flag": (
        FUNCTION + "trigger = { flag = 0 }\n" + layout(COUNTER),
        f"{KEY}.trigger.flag: unknown key",
    ),
    "a counter that is not there": (
        FUNCTION + 'trigger = { counter = "n" }\n' + layout(COUNTER),
        f"{KEY}.trigger: counter: no point n",
    ),
    "a counter with a fraction": (
        FUNCTION + 'trigger = { counter = "value_1" }\n' + layout(VALUE),
        f"{KEY}.trigger: counter: value_1 is not an unscaled unsigned integer",
    ),
    "a change of nothing": (
        FUNCTION + 'trigger = { change = ["n"] }\n' + layout(COUNTER),
        f'{KEY}.trigger.change: no point "n" in this block',
    ),
    "the first of a change": (
        FUNCTION + "trigger = { change = [], first = 1 }\n" + layout(COUNTER),
        f"{KEY}.trigger.first: only with counter",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_have_their_key_path(mistake: str, refusal: Refusal) -> None:
    text, problem = MISTAKES[mistake]
    (line,) = refusal(HEAD + text)
    assert line.startswith(problem)
    assert line.isprintable()


def test_all_mistakes_are_told_at_once(refusal: Refusal) -> None:
    text = (
        FUNCTION.replace("15300", "10500")
        + 'trigger = { change = ["b", "z"] }\n'
        + layout('{ name = "a", type = "uint9" }', '{ name = "b", type = "uint16", unit = "°" }')
        + FUNCTION.replace('period = "250ms"', "")
        + layout('{ name = "c", type = "bytes" }', STAMP, STAMP.replace("stamp", "other", 1))
        + FUNCTION.replace("15300", "15450").replace('"values"', '"more"')
        + layout('{ name = "d", type = "uint64", count = 32 }', COUNTER, COUNTER)
    )
    lines = refusal(HEAD + text)
    path = "devices.msx-1.functions"
    assert sorted(line.partition(": ")[0] for line in lines) == [
        f"{path}[0].layout[0].type",
        f"{path}[0].layout[1].unit",
        f"{path}[0].register",
        f"{path}[0].trigger.change",
        f"{path}[1].layout[0].size",
        f"{path}[1].layout[2].type",
        f"{path}[1].name",
        f"{path}[1].period",
        f"{path}[2].layout",
        f"{path}[2].layout[2].name",
    ]


def test_two_devices_may_have_other_functions_of_one_name(load_text: Load) -> None:
    other = HEAD[HEAD.index("[devices") :] + FUNCTION + layout(VALUE)
    settings = load_text(HEAD + FUNCTION + layout(COUNTER) + other.replace("msx-1", "msx-2"))
    messages = [device.profile.samples[-1].message for device in settings.devices.values()]
    assert messages == ["device_msx_1_values", "device_msx_2_values"]


EXAMPLE = Path(__file__).parents[2] / "examples/msx-e3317.toml"


def test_the_example_and_what_it_has_in_comments(load_text: Load) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    device = load_text(text).devices["msx1"]
    assert [block.address for block in device.profile.samples] == [10500, 15050, 15300]
    block = device.profile.block("values")
    # As of the MSX-E371x: u32[17], the counter first; here with the two words of a stamp behind it.
    assert (block.octets, len(block.points)) == (4 * 17 + 8, 17 + 2)
    start = text.index("# [[devices.msx1.functions]]")
    commented = "\n".join(line.removeprefix("# ") for line in text[start:].splitlines())
    information = load_text(text[:start] + commented).devices["msx1"].profile.block("information")
    assert (information.octets, information.trigger) == (71, Change())

"""Words that people bring along from manuals, PLCs and other programs."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Container

OTHERS_SAY: Final = {
    **dict.fromkeys(("u16", "word", "ushort", "unsigned", "uint"), "uint16"),
    **dict.fromkeys(("i16", "s16", "sint16", "short", "int", "signed", "integer"), "int16"),
    **dict.fromkeys(("u32", "dword", "udint", "ulong"), "uint32"),
    **dict.fromkeys(("i32", "s32", "sint32", "dint", "long"), "int32"),
    **dict.fromkeys(("u64", "lword", "ulint"), "uint64"),
    **dict.fromkeys(("i64", "s64", "sint64", "lint"), "int64"),
    **dict.fromkeys(("f32", "float", "real", "single"), "float32"),
    **dict.fromkeys(("f64", "double", "lreal"), "float64"),
    "bcd": "bcd16",
    **dict.fromkeys(("string", "str", "ascii", "char"), "text"),
    **dict.fromkeys(("bool", "boolean", "binary"), "bit"),
    **dict.fromkeys(("holding", "hr", "4x"), "holding_registers"),
    **dict.fromkeys(("input", "inputs", "ir", "3x"), "input_registers"),
    **dict.fromkeys(("discrete", "di", "1x"), "discrete_inputs"),
    **dict.fromkeys(("factor", "multiplier", "gain"), "scale"),
    **dict.fromkeys(("slave", "slave_id", "unit_id", "slave_address", "server"), "unit"),
    **dict.fromkeys(("address", "register"), "offset"),
    **dict.fromkeys(("start", "start_address", "first_register"), "address"),
    **dict.fromkeys(("min", "max", "low", "high", "limits"), "range"),
    **dict.fromkeys(("length", "size"), "words"),
    **dict.fromkeys(("byte_order", "order", "endian", "swap"), "word_order"),
    **dict.fromkeys(("interval", "scan_rate", "cycle_time"), "poll"),
}
"""What they say, in lower case, and what it is called here. INT and REAL are those of IEC 61131."""

_OCTET: Final = 'an octet is a part of a uint16, named by bits = { 0-7 = "lower", 8-15 = "upper" }'
_DIVIDED: Final = "scale multiplies: what a manual divides by 10 has scale = 0.1"
_EXPLAINED: Final = {
    **dict.fromkeys(("uint8", "int8", "u8", "s8", "i8", "byte", "usint", "sint"), _OCTET),
    **dict.fromkeys(("divisor", "divide", "divide_by", "div"), _DIVIDED),
}
_NEEDED_FOR: Final = {_OCTET: "uint16", _DIVIDED: "scale"}
"""The word without which an explanation makes no sense."""
_ORDERED: Final = re.compile(
    r"(u?int(?:32|64)|float(?:32|64)?|real|double|dword|[uis](?:32|64)|f(?:32|64))[ _-]?"
    r"(?:(swap(?:ped)?|cdab|wordswap|ws|mid_?little|r|inv(?:erse)?)|(dcba|le|little|little_endian)"
    r"|(badc|bs|byteswap|mid_?big)|abcd|be|big|big_endian)"
)
"""A type that has its order in its name."""


def explanation(word: str, known: Container[str]) -> str:
    """Of a word in lower case, what to write for it where no single word is meant; else nothing."""
    text = _EXPLAINED.get(word, "")
    if text:
        return text if _NEEDED_FOR[text] in known else ""
    match = _ORDERED.fullmatch(word)
    type_ = OTHERS_SAY.get(match[1], match[1]) if match else ""
    if match is None or type_ not in known:
        return ""
    order = "CDAB" if match[2] else "DCBA" if match[3] else "BADC" if match[4] else "ABCD"
    return f'write type = "{type_}", word_order = "{order}"'

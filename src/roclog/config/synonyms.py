"""Words that people bring along from manuals, PLCs and other programs."""

from __future__ import annotations

from typing import Final

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
    **dict.fromkeys(("factor", "multiplier", "gain", "divisor"), "scale"),
    **dict.fromkeys(("slave", "slave_id", "unit_id", "slave_address", "server"), "unit"),
    **dict.fromkeys(("address", "register"), "offset"),
    **dict.fromkeys(("start", "start_address", "first_register"), "address"),
    **dict.fromkeys(("min", "max", "low", "high", "limits"), "range"),
    **dict.fromkeys(("length", "size"), "words"),
    **dict.fromkeys(("byte_order", "order", "endian", "swap"), "word_order"),
    **dict.fromkeys(("interval", "scan_rate", "cycle_time"), "poll"),
}
"""What they say, in lower case, and what it is called here. INT and REAL are those of IEC 61131."""

"""``roclog decode``."""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, Final, NamedTuple

import click

from roclog.register_map import MAX_READ_REGISTERS, Block, Point, Table, WordOrder, WordType

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_TYPES: Final = tuple(t for t in WordType if t not in (WordType.BIT, WordType.OCTETS))
_ALIASES: Final = {"AB": WordOrder.ABCD, "BA": WordOrder.BADC}
_ORDERS: Final = (*(order.value for order in WordOrder), *_ALIASES)
_WORD: Final = re.compile(r"0x([0-9a-f]{1,4})|([0-9a-f]{4})|(-?[0-9]{1,5})", re.IGNORECASE)


class Row(NamedTuple):
    """One way to read the words. words: from 1. doubtful: the type does not know such words."""

    words: str
    type: WordType
    order: str
    value: object
    doubtful: bool


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("words", nargs=-1, required=True, metavar="WORDS...")
@click.option("--type", "type_", type=click.Choice([t.value for t in _TYPES]), help="Only as this.")
@click.option("--order", type=click.Choice(_ORDERS), help="Only in this word and byte order.")
@click.option("--try-all", is_flag=True, help="Every type in every order.")
@click.option("--decimal", is_flag=True, help="WORDS of four digits are decimal, not hexadecimal.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def decode(
    *,
    words: tuple[str, ...],
    type_: str | None,
    order: str | None,
    try_all: bool,
    decimal: bool,
    as_json: bool,
) -> None:
    """Show what the words of registers mean as numbers, in every type and order that fits them.

    WORDS are registers in the order of their addresses: hexadecimal with four digits or with 0x,
    else decimal. Without --try-all types are shown in the order ABCD only.

    \b
    Example:
      roclog decode 7AE1 41F4 --try-all
      roclog decode 16709 28836 --type float32
    """
    registers = [_register(text, decimal=decimal) for text in words]
    if len(registers) > MAX_READ_REGISTERS:
        raise click.UsageError(f"{len(registers)} words are more than {MAX_READ_REGISTERS}")
    types = _TYPES if type_ is None else (WordType(type_),)
    orders = tuple(WordOrder) if try_all else (WordOrder.ABCD,)
    if order is not None:
        orders = (_ALIASES.get(order) or WordOrder(order),)
    needed = types[0].words if type_ not in (None, WordType.TEXT) else 1
    if len(registers) % needed:  # none is left out where one type is asked for
        multiple = f" or a multiple of {needed}" if len(registers) > needed else ""
        what = f"{type_} needs {needed} words{multiple}, not {len(registers)}"
        raise click.UsageError(what)
    rows = list(_rows(registers, types, orders))
    if as_json:
        click.echo(json.dumps(_as_object(registers, rows)))
    else:
        _print(rows)


def _register(text: str, *, decimal: bool) -> int:
    match = _WORD.fullmatch(text)
    if match is None:
        hint = "write four hexadecimal digits, 0x and up to four, or a decimal number"
        raise click.BadParameter(f"{text!r} is not a word: {hint}", param_hint="WORDS")
    is_decimal = match[3] is not None or (decimal and match[2] is not None and text.isdecimal())
    number = int(text) if is_decimal else int(match[1] or match[2], 16)
    if not -0x8000 <= number <= 0xFFFF:
        raise click.BadParameter(f"{text} is not -32768 to 65535", param_hint="WORDS")
    return number & 0xFFFF


def _rows(
    registers: Sequence[int], types: Sequence[WordType], orders: Sequence[WordOrder]
) -> Iterator[Row]:
    """Each type at each of the places where its words are whole, in each order that differs."""
    for type_ in types:
        size = len(registers) if type_ is WordType.TEXT else type_.words
        for start in range(0, len(registers) - size + 1, size):
            for order in orders:
                if type_.words == 1 and order.words_reversed and len(orders) > 1:
                    continue  # as ABCD or BADC
                yield _row(registers[start : start + size], start, type_, order)


def _row(part: Sequence[int], start: int, type_: WordType, order: WordOrder) -> Row:
    from roclog.decode import decode as decode_block  # noqa: PLC0415
    from roclog.decode import named_values  # noqa: PLC0415
    from roclog.word_types import shortest_float32  # noqa: PLC0415

    size = len(part)
    point = Point(
        name="value",
        offset=0,
        type=type_,
        words=size if type_ is WordType.TEXT else 0,
        word_order=order,
    )
    block = Block(
        name="words", table=Table.HOLDING_REGISTERS, address=0, count=size, points=(point,)
    )
    decoded = decode_block(block, part)
    place = str(start + 1) if size == 1 else f"{start + 1}-{start + size}"
    shown = order.value
    if type_.words == 1:
        shown = "BA" if order.octets_swapped else "AB"
    value = named_values(block, decoded)["value"]
    if type_ is WordType.F32 and isinstance(value, float):
        value = shortest_float32(value)
    return Row(place, type_, shown, value, bool(decoded.doubtful))


def _print(rows: Sequence[Row]) -> None:
    from roclog.cli.output import print_table  # noqa: PLC0415

    headings = ("words", "type", "order", "value", "")
    cells = [(row.words, row.type.value, row.order, _text(row.value), _remark(row)) for row in rows]
    print_table("Words as numbers", headings, cells, numeric=("value",))


def _text(value: object) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else repr(value)


def _remark(row: Row) -> str:
    if row.value is None:
        return "not decimal digits"
    return "not plausible" if row.doubtful else ""


def _as_object(registers: Sequence[int], rows: Sequence[Row]) -> dict[str, object]:
    return {
        "schema": "roclog.decode/1",
        "words": list(registers),
        "values": [
            {
                "words": row.words,
                "type": row.type.value,
                "order": row.order,
                "value": row.value if _is_finite(row.value) else str(row.value),
                "doubtful": row.doubtful,
            }
            for row in rows
        ],
    }


def _is_finite(value: object) -> bool:
    return not isinstance(value, float) or math.isfinite(value)

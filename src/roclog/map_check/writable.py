"""What the settings and commands of a register map must satisfy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from roclog.register_map import Table, WordType
from roclog.register_map.writable import COMMANDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from roclog.register_map import Block, Point, RegisterMap
    from roclog.register_map.writable import Setting, Writable

SETTING_TYPES: Final = (
    WordType.U16,
    WordType.S16,
    WordType.MINUTES_SECONDS,
    WordType.MONTH_DAY,
)
_CLOCK: Final = (WordType.U16, WordType.MONTH_DAY, WordType.U16, WordType.MINUTES_SECONDS)


def writable_flaws(register_map: RegisterMap) -> Iterator[str]:
    """What is wrong with ``RegisterMap.writable``; nothing where it has none."""
    writable = register_map.writable
    if writable is None:
        return
    yield from _command_flaws(writable, register_map)
    block = next((b for b in register_map.facts if b.name == writable.block), None)
    if block is None or block.table is not Table.HOLDING_REGISTERS or block.packed:
        yield f"no block {writable.block} of holding registers that is read once"
        return
    points = {point.name: point for point in block.points}
    named = [setting.point for setting in writable.settings]
    for name in sorted({name for name in named if named.count(name) > 1}):
        yield f"setting {name}: named twice"
    for setting in writable.settings:
        for text in _setting_flaws(setting, points):
            yield f"setting {setting.point}: {text}"
    yield from _role_flaws(writable, points)


def _setting_flaws(setting: Setting, points: Mapping[str, Point]) -> Iterator[str]:
    point = points.get(setting.point)
    if point is None:
        yield "no such point in the block"
        return
    if point.type not in SETTING_TYPES or point.is_scaled or point.word_order is not None:
        yield "only unscaled numbers of one register can be written"
    if (setting.low is None) != (setting.high is None):
        yield "low and high go together"
    if setting.low is not None and setting.high is not None and setting.low > setting.high:
        yield f"{setting.low} is larger than {setting.high}"
    bounded = setting.low is not None or point.low is not None or bool(point.meanings)
    if not bounded and not setting.ranges:
        yield "nothing says what may be written"
    yield from _range_flaws(setting, points)


def _range_flaws(setting: Setting, points: Mapping[str, Point]) -> Iterator[str]:
    if not setting.ranges:
        if setting.selector or setting.readings:
            yield "a selector and readings need ranges"
        return
    if setting.selector not in points or setting.selector == setting.point:
        yield f"no other point {setting.selector!r} to select a range"
    if len({choice.when for choice in setting.ranges}) != len(setting.ranges):
        yield "two ranges for the same number"
    for choice in setting.ranges:
        if choice.low > choice.high:
            yield f"range {choice.name}: {choice.low} is larger than {choice.high}"
    if not setting.readings or any(reading.factor <= 0 for reading in setting.readings):
        yield "ranges need a reading, with a factor above 0"


def _role_flaws(writable: Writable, points: Mapping[str, Point]) -> Iterator[str]:
    named = {setting.point for setting in writable.settings}
    if writable.unit and writable.unit not in named:
        yield f"unit: {writable.unit} is not a setting"
    types = tuple(points[name].type for name in writable.clock if name in points)
    if writable.clock and (types != _CLOCK or not named.issuperset(writable.clock)):
        yield "clock: must be settings for year, month and day, hour, minute and second"


def _command_flaws(writable: Writable, register_map: RegisterMap) -> Iterator[str]:
    names = [command.name for command in writable.commands]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"command {name}: named twice"
    for command in writable.commands:
        if command.name not in COMMANDS:
            yield f"command {command.name}: is not one of {', '.join(COMMANDS)}"
        if not (0 <= command.address <= 0xFFFF and 0 <= command.value <= 0xFFFF):
            yield f"command {command.name}: register {command.address} cannot be set to it"
        for block in register_map.blocks:
            if _has(block, command.address):
                yield f"command {command.name}: register {command.address} is in {block.name}"


def _has(block: Block, address: int) -> bool:
    of_words = block.table is Table.HOLDING_REGISTERS
    return of_words and 0 <= address - block.address < block.count

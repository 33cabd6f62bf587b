"""The configuration block of the HIAC ROC: registers 100-113, their defaults and write ranges.

Source: MODBUS Serial Communications Protocol of the device, section 4.0, "Configuration Block".
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Container, Mapping

NODE_ID: Final = 100
SAMPLE_PERIOD: Final = 105
HOLD_PERIOD: Final = 106
TRIGGER: Final = 107
DIRECTION: Final = 108
FIRST_LIMIT: Final = 110
ADDRESSES: Final = range(100, 114)
NODE_IDS: Final = range(1, 248)

NO_LIMIT: Final = -3
CHANNELS: Final = 4
NAS_LIMITS: Final = 2


class Trigger(IntEnum):
    """Values of register 107: what the alarm relay and the channel alarms look at."""

    SYSTEM_STATUS = 0
    ISO = 1
    NAS = 2
    SAE = 3


class Direction(IntEnum):
    """Values of register 108: an alarm is met when the code rises to, or falls to, its limit."""

    CLEAN_TO_DIRTY = 0
    DIRTY_TO_CLEAN = 1


def default_words(node_id: int) -> dict[int, int]:
    """Give the words of registers 100-113 as delivered, with the node id set to `node_id`."""
    words = dict.fromkeys(ADDRESSES, 0)
    words[NODE_ID] = node_id
    words[SAMPLE_PERIOD] = 0x000A
    words[HOLD_PERIOD] = 0x0005
    words[DIRECTION] = Direction.DIRTY_TO_CLEAN
    for channel in range(CHANNELS):
        words[FIRST_LIMIT + channel] = NO_LIMIT & 0xFFFF
    return words


def seconds(word: int) -> int:
    """Give the seconds in a word with minutes in its upper and seconds in its lower octet."""
    return 60 * (word >> 8) + (word & 0xFF)


def signed(word: int) -> int:
    """Give the value of a word in two's complement."""
    return word - 0x10000 if word & 0x8000 else word


def limit_tenths(words: Mapping[int, int], channel: int) -> int | None:
    """Give the alarm limit of a channel (0-3) in tenths of a code or class.

    The document's data description holds for all limits: -2 and -1 are the classes 000 and 00,
    positive values have one implied decimal (register 50 is code 5.0, register 120 class 12).

    Returns:
        None when there is no limit, or when the limit has no meaning under the present trigger.
        The latter happens when register 107 is changed after the limits; they are kept as written.
    """
    raw = signed(words[FIRST_LIMIT + channel])
    if raw == NO_LIMIT or not _is_limit(raw, channel, words[TRIGGER]):
        return None
    return 10 * raw if raw < 0 else raw


def is_writable(address: int, words: Mapping[int, int]) -> bool:
    """Tell whether the word at `address` is inside its write range.

    Args:
        address: One of registers 100-113.
        words: The whole block as it would be after the write, because the range of 110-113
            depends on 107.
    """
    if address < FIRST_LIMIT:
        return words[address] in _RANGES[address]
    return _is_limit(signed(words[address]), address - FIRST_LIMIT, words[TRIGGER])


def _is_limit(raw: int, channel: int, trigger: int) -> bool:
    """Tell whether a limit is inside the write range that the trigger gives it.

    Under NAS the limits of registers 112 and 113 do not exist and can only be "none".
    """
    if raw == NO_LIMIT:
        return True
    return raw in _LIMIT_RANGES[trigger] and (trigger != Trigger.NAS or channel < NAS_LIMITS)


def _octet_pairs(upper: range, lower: range, *, least: int = 0) -> frozenset[int]:
    """Give the words made of two octets in their ranges that are not below `least` as a word."""
    return frozenset(word for high in upper for low in lower if (word := high << 8 | low) >= least)


_RANGES: Final[Mapping[int, Container[int]]] = {
    100: NODE_IDS,
    101: range(2000, 2101),
    102: _octet_pairs(range(1, 13), range(1, 32)),
    103: range(24),
    104: _octet_pairs(range(60), range(60)),
    105: _octet_pairs(range(60), range(60), least=0x0005),
    106: _octet_pairs(range(60), range(60), least=0x0002),
    107: range(4),
    108: range(2),
    109: range(2),
}

_LIMIT_RANGES: Final[Mapping[int, range]] = {
    # The document gives none for trigger 0; whatever another trigger allows is taken then.
    Trigger.SYSTEM_STATUS: range(-2, 291),
    Trigger.ISO: range(291),
    Trigger.NAS: range(-1, 121),
    Trigger.SAE: range(-2, 121),
}

"""Write ranges of registers 100-113, at each of their edges."""

from __future__ import annotations

import pytest

from roclog.simulators import roc_settings

NONE, CLASS_000, CLASS_00 = 0xFFFD, 0xFFFE, 0xFFFF
ANY, ISO, NAS, SAE = range(4)

EDGES = {
    # Register: words just inside, words just outside.
    100: ([1, 247], [0, 248, 0xFFFF]),
    101: ([2000, 2100], [0, 1999, 2101]),
    102: ([0x0101, 0x0C1F], [0x0000, 0x0001, 0x0100, 0x0D01, 0x0120]),
    103: ([0, 23], [24, 0xFFFF]),
    104: ([0x0000, 0x3B3B], [0x003C, 0x3C00]),
    105: ([0x0005, 0x0100, 0x3B3B], [0x0000, 0x0004, 0x003C, 0x3C00]),
    106: ([0x0002, 0x0100, 0x3B3B], [0x0000, 0x0001, 0x003C, 0x3C00]),
    107: ([0, 3], [4, 0xFFFF]),
    108: ([0, 1], [2, 0xFFFF]),
    109: ([0, 1], [2, 0xFFFF]),
}

LIMIT_EDGES = [
    # Trigger, register, words just inside, words just outside.
    (ANY, 110, [NONE, CLASS_000, 0, 290], [0xFFFC, 291]),
    (ISO, 110, [NONE, 0, 290], [0xFFFC, CLASS_000, CLASS_00, 291]),
    (ISO, 113, [NONE, 0, 290], [0xFFFC, CLASS_000, CLASS_00, 291]),
    (NAS, 110, [NONE, CLASS_00, 0, 120], [0xFFFC, CLASS_000, 121]),
    (NAS, 111, [NONE, CLASS_00, 0, 120], [0xFFFC, CLASS_000, 121]),
    (NAS, 112, [NONE], [CLASS_00, 0, 120]),
    (NAS, 113, [NONE], [CLASS_00, 0, 120]),
    (SAE, 110, [NONE, CLASS_000, CLASS_00, 0, 120], [0xFFFC, 121]),
    (SAE, 113, [NONE, CLASS_000, CLASS_00, 0, 120], [0xFFFC, 121]),
]


def is_writable(address: int, word: int, *, trigger: int = ANY) -> bool:
    words = roc_settings.default_words(138) | {107: trigger, address: word}
    return roc_settings.is_writable(address, words)


@pytest.mark.parametrize("address", EDGES)
def test_write_range(address: int) -> None:
    inside, outside = EDGES[address]
    assert all(is_writable(address, word) for word in inside)
    assert not any(is_writable(address, word) for word in outside)


@pytest.mark.parametrize(("trigger", "address", "inside", "outside"), LIMIT_EDGES)
def test_write_range_of_a_limit(
    trigger: int, address: int, inside: list[int], outside: list[int]
) -> None:
    assert all(is_writable(address, word, trigger=trigger) for word in inside)
    assert not any(is_writable(address, word, trigger=trigger) for word in outside)


def test_defaults_of_the_document() -> None:
    words = roc_settings.default_words(138)
    assert list(words) == list(range(100, 114))
    assert list(words.values()) == [138, 0, 0, 0, 0, 0x000A, 0x0005, 0, 1, 0, *[0xFFFD] * 4]


@pytest.mark.parametrize(
    ("trigger", "word", "tenths"),
    [
        (ISO, 185, 185),
        (ISO, NONE, None),
        (ISO, CLASS_00, None),
        (NAS, CLASS_00, -10),
        (SAE, CLASS_000, -20),
        (SAE, 290, None),
    ],
)
def test_limit_without_a_meaning_under_the_trigger_is_no_limit(
    trigger: int, word: int, tenths: int | None
) -> None:
    words = roc_settings.default_words(138) | {107: trigger, 110: word}
    assert roc_settings.limit_tenths(words, 0) == tenths

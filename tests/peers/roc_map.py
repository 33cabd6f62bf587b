"""The ROC's registers as its document (section 4.0) defines them: defaults, ranges, access."""

from __future__ import annotations

from wire import ILLEGAL_ADDRESS, ILLEGAL_VALUE, PduError, Read, Write

NODE_ID = 100
SAMPLE_PERIOD = 105
HOLD_PERIOD = 106
ALARM_TRIGGER = 107
FLAG = 300
PERIOD = 305
ALARMS = 306
TEMPERATURE = 326
BLOCK = range(FLAG, TEMPERATURE + 1)
RESET = 1101
SAVE = 1102
RESET_VALUE = 0x55
SAVE_VALUE = 0x5A

_READABLE = (range(48), range(100, 114), BLOCK)
"""The "Expansion" rows and the write-only 1101/1102 have no content: exception 2."""

_SHORTEST_CYCLE = 7
_LIMITS = range(110, 114)
_LIMIT_RANGES = {0: (-3, 290), 1: (0, 290), 2: (-1, 12), 3: (-2, 12)}
_NO_LIMIT = -3


def text(value: str, registers: int) -> list[int]:
    """Two characters per register, the first one in the upper octet, unused octets 0."""
    octets = value.encode("ascii").ljust(2 * registers, b"\0")
    return [int.from_bytes(octets[at : at + 2], "big") for at in range(0, len(octets), 2)]


def identity(serial_number: str) -> list[int]:
    return [
        *text("HIAC", 15),
        *text("ROC", 10),
        *text(serial_number, 5),
        *text("HIAC ROC", 4),
        *(0, 0, 0, 0, 104, 100, 0),
        *text("2089263-1 RevC", 7),
    ]


def pair(total_seconds: int) -> int:
    """MM:SS, minutes in the upper octet."""
    minutes, seconds = divmod(total_seconds, 60)
    return minutes << 8 | seconds


def configuration(unit: int, cycle: float) -> dict[int, int]:
    """Defaults of 100-113; from 7 s on 105 + 106 are the cycle (in whole seconds)."""
    sample, hold = 10, 5
    if cycle >= _SHORTEST_CYCLE:
        total = round(cycle)
        hold = max(2, min(total // 3, total - 5))
        sample = total - hold
    none = _NO_LIMIT & 0xFFFF
    values = [unit, 0, 0, 0, 0, pair(sample), pair(hold), 0, 1, 0, none, none, none, none]
    return dict(zip(range(100, 114), values, strict=True))


def check_read(command: Read) -> None:
    last = command.address + command.count - 1
    if not any(command.address in block and last in block for block in _READABLE):
        raise PduError(ILLEGAL_ADDRESS)


def check_write(command: Write, config: dict[int, int]) -> dict[int, int]:
    """The registers to set; read-only ones are addresses that cannot be written: exception 2."""
    wanted = dict(enumerate(command.values, command.address))
    writable = {*config, FLAG, RESET, SAVE}
    if not wanted.keys() <= writable:
        raise PduError(ILLEGAL_ADDRESS)
    trigger = wanted.get(ALARM_TRIGGER, config[ALARM_TRIGGER])
    if not all(_legal(address, value, trigger) for address, value in wanted.items()):
        raise PduError(ILLEGAL_VALUE)
    return wanted


def _legal(address: int, value: int, trigger: int) -> bool:
    upper, lower = value >> 8, value & 0xFF
    if address in _LIMITS:
        signed = value - 0x10000 if value & 0x8000 else value
        low, high = _LIMIT_RANGES.get(trigger, (0, -1))
        return signed == _NO_LIMIT or low <= signed <= high
    if address in (104, SAMPLE_PERIOD, HOLD_PERIOD):
        least = {104: 0, SAMPLE_PERIOD: 5, HOLD_PERIOD: 2}[address]
        return upper in range(60) and lower in range(60) and value >= least
    if address == 102:  # month and day
        return upper in range(1, 13) and lower in range(1, 32)
    return value in _PLAIN[address]


_PLAIN = {
    NODE_ID: range(1, 248),
    101: range(2000, 2101),
    103: range(24),
    ALARM_TRIGGER: range(4),
    108: range(2),
    109: range(2),
    FLAG: range(1),
    RESET: range(RESET_VALUE, RESET_VALUE + 1),
    SAVE: range(SAVE_VALUE, SAVE_VALUE + 1),
}

"""Bent octets against everything that reads octets from a line, for as long as it is told to.

    python tests/fuzz/fuzz_frames.py SECONDS [SEED]

Allowed is a documented error, None, or an answer that the request asks for. Anything else ends the
run with the seed of the case. ``test_fuzz_frames.py`` runs a moment of it.
"""

from __future__ import annotations

import random
import sys
import time

from roclog.decode import decode, word_order_doubts
from roclog.devices import PROFILES
from roclog.errors import ExceptionAnswer, LinkDown, WrongAnswer
from roclog.modbus.library import crc
from roclog.modbus.mbap import MbapExchange, MbapStream
from roclog.modbus.request import ReadRegisters, Request, WriteRegister, check_answer, words
from roclog.modbus.rtu import Echo, RtuExchange
from roclog.register_map import WordOrder
from roclog.schema import read_signature, sample_type

BLOCKS = [block for device in PROFILES.values() for block in device.blocks]
SAMPLES = [
    (block, sample_type(device.name, block))
    for device in PROFILES.values()
    for block in device.samples
]


def bend(rng: random.Random, octets: bytes) -> bytes:
    """Flip, cut, repeat, insert, or leave as it is."""
    bent = bytearray(octets)
    for _ in range(rng.choice((0, 1, 1, 2, 5))):
        at = rng.randrange(len(bent) + 1)
        match rng.randrange(5):
            case 0 if at < len(bent):
                bent[at] ^= 1 << rng.randrange(8)
            case 1:
                del bent[at : at + rng.randrange(1, 9)]
            case 2:
                bent[at:at] = rng.randbytes(rng.randrange(1, 9))
            case 3:
                bent[at:at] = octets[: rng.randrange(len(octets) + 1)]
            case 4:
                bent[at:at] = octets
    return bytes(bent)


def some_request(rng: random.Random) -> Request:
    if rng.random() < 0.3:
        return WriteRegister(rng.randrange(0x10000), rng.randrange(0x10000))
    count = rng.choice((1, 1, 2, 27, 125, rng.randrange(1, 126)))
    return ReadRegisters(rng.choice((3, 4)), rng.randrange(0x10001 - count), count)


def some_answer(rng: random.Random, request: Request) -> bytes:
    if rng.random() < 0.3:
        return bytes([request.pdu[0] | 0x80, rng.randrange(256)])
    return request.head + rng.randbytes(request.answer_size - len(request.head))


def pieces(rng: random.Random, octets: bytes) -> list[bytes]:
    edges = sorted(rng.randrange(len(octets) + 1) for _ in range(rng.randrange(6)))
    ends = [*edges, len(octets)]
    return [octets[a:b] for a, b in zip([0, *edges], ends, strict=True)]


def judge(request: Request, pdu: bytes) -> None:
    try:
        check_answer(request, pdu)
    except (ExceptionAnswer, WrongAnswer):
        return
    assert len(pdu) == request.answer_size
    assert pdu.startswith(request.head)
    if isinstance(request, ReadRegisters):
        assert len(words(pdu)) == request.count


def rtu(rng: random.Random) -> None:
    unit, request = rng.randrange(256), some_request(rng)
    pending = RtuExchange(unit, request, rng.choice(tuple(Echo)))
    answer = bytes([unit]) + some_answer(rng, request)
    line = rng.choice((b"", pending.adu)) + answer + crc(answer)
    octets = bend(rng, line)
    found = None
    for piece in pieces(rng, octets):
        found = pending.feed(piece)
        if found is not None:
            break
    found = pending.conclude() if found is None else found
    if found is not None:
        frame = bytes([unit]) + found
        assert frame + crc(frame) in octets
        refused = found[0] == request.pdu[0] | 0x80 and len(found) == 2
        assert refused or (len(found) == request.answer_size and found.startswith(request.head))
    assert pending.intact_stranger in (True, False)
    judge(request, bend(rng, answer)[1:])


def mbap(rng: random.Random) -> None:
    unit, request, transaction = rng.randrange(256), some_request(rng), rng.randrange(1, 0x10000)
    pending = MbapExchange(unit, request, transaction, MbapStream())
    pdu = some_answer(rng, request)
    header = transaction.to_bytes(2) + b"\0\0" + (len(pdu) + 1).to_bytes(2) + bytes([unit])
    for piece in pieces(rng, bend(rng, header + pdu)):
        try:
            found = pending.feed(piece)
        except (LinkDown, WrongAnswer):
            return
        if found is not None:
            judge(request, found)


def block(rng: random.Random) -> None:
    chosen = rng.choice(BLOCKS)
    registers = [
        rng.choice((0, 1, 0xFFFF, 0x8000, rng.randrange(0x10000))) for _ in range(chosen.count)
    ]
    for order in WordOrder:
        decoded = decode(chosen, registers, order)
        assert all(isinstance(value, int | float | str) for value in decoded.values)
        word_order_doubts(chosen, registers, order)


def message(rng: random.Random) -> None:
    chosen, kind = rng.choice(SAMPLES)
    registers = [rng.randrange(0x10000) for _ in range(chosen.count)]
    decoded = decode(chosen, registers)
    raw = b"".join(word.to_bytes(2) for word in registers)
    signature = (1, bytes(16), 1, False, 0, 0, 0, 0, decoded.device_time, decoded.time_flags)
    packed = kind.pack(iter((*signature, decoded.doubtful, raw, 0, *decoded.values)))
    whole = read_signature(packed)
    assert whole is not None
    assert whole["raw"] == raw
    read_signature(bend(rng, packed))
    kind.unpack(bend(rng, packed))


TARGETS = (rtu, rtu, mbap, block, message)


def run(seconds: float, seed: int) -> int:
    """Cases done. A case is rerun alone by its number: ``one_case(number)``."""
    end = time.monotonic() + seconds
    number = seed
    while time.monotonic() < end:
        try:
            one_case(number)
        except BaseException:
            print(f"case {number}", file=sys.stderr)
            raise
        number += 1
    return number - seed


def one_case(number: int) -> None:
    rng = random.Random(number)
    TARGETS[number % len(TARGETS)](rng)


if __name__ == "__main__":
    limit = float(sys.argv[1])
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    print(f"{run(limit, first)} cases from {first}, nothing undocumented")

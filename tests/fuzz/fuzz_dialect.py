"""Bent octets against everything that reads an MSX-E's answers, for as long as it is told to.

    python tests/fuzz/fuzz_dialect.py SECONDS [SEED]

Allowed is a documented error, None, or an answer that the request asks for. Anything else ends the
run with the seed of the case. ``test_fuzz_dialect.py`` runs a moment of it.
"""

from __future__ import annotations

import random
import sys
import time
from dataclasses import replace

from roclog.errors import ExceptionAnswer, LinkDown, WrongAnswer
from roclog.modbus.dialect import MSX_E, STANDARD, Dialect
from roclog.modbus.functions import (
    ReadFunction,
    ReadWriteFunction,
    WriteFunction,
    command_status,
)
from roclog.modbus.mbap import DatagramExchange, MbapExchange, MbapStream, whole_frame
from roclog.modbus.request import check_answer

Call = ReadFunction | WriteFunction | ReadWriteFunction

DIALECTS = (STANDARD, MSX_E, replace(MSX_E, order="little"), Dialect(order="little", max_pdu=260))
REGISTERS = (0, 1, 2, 3, 255, 256, 999, 1000, 10000, 10500, 0xFFFF)


def bend(rng: random.Random, octets: bytes) -> bytes:
    """Flip, cut, repeat, insert, or leave as it is; often in the header and the byte count."""
    bent = bytearray(octets)
    for _ in range(rng.choice((0, 0, 1, 1, 2, 5))):
        at = rng.randrange(min(len(bent), rng.choice((10, 300))) + 1)
        match rng.randrange(5):
            case 0 if at < len(bent):
                bent[at] ^= 1 << rng.randrange(8)
            case 1:
                del bent[at : at + rng.randrange(1, 9)]
            case 2:
                bent[at:at] = rng.randbytes(rng.randrange(1, 9))
            case 3:
                bent[at:at] = octets
            case 4 if at + 1 < len(bent):
                bent[at], bent[at + 1] = bent[at + 1], bent[at]
    return bytes(bent)


def some_call(rng: random.Random, dialect: Dialect) -> Call:
    register = rng.choice(REGISTERS)
    words = rng.choice((1, 2, 4, 54, 66, 100, 125, rng.randrange(1, 126)))
    parameters = rng.randbytes(2 * rng.randrange(1, 101))
    match rng.randrange(4):
        case 0:
            return WriteFunction(register, parameters, dialect)
        case 1:
            return ReadWriteFunction(register, words, rng.choice(REGISTERS), parameters, dialect)
        case _:
            return ReadFunction(register, words, 2 * words + (rng.random() < 0.2), dialect)


def some_answer(rng: random.Random, call: Call) -> bytes:
    if rng.random() < 0.2:
        return bytes([call.pdu[0] | 0x80, rng.randrange(256)])
    payload = rng.randbytes(call.answer_size - len(call.head))
    if rng.random() < 0.2:  # the other size of the byte count
        other = 3 - len(call.head[1:]) if call.pdu[0] != 16 else 1
        return call.head[:1] + (len(payload) % 256).to_bytes(other, call.dialect.order) + payload
    return call.head + payload


def judge(call: Call, pdu: bytes) -> None:
    try:
        check_answer(call, pdu)
    except (ExceptionAnswer, WrongAnswer):
        return
    assert pdu.startswith(call.head)
    assert len(pdu) == call.answer_size
    if isinstance(call, WriteFunction):
        return
    payload = call.payload(pdu)
    assert len(payload) in (2 * call.words, 2 * call.words + 1)
    count = pdu[1 : -len(payload)]
    assert int.from_bytes(count, call.dialect.order) == len(payload)
    if len(payload) == 108:
        assert "\0" not in command_status(payload, call.dialect).text


def exchange(rng: random.Random) -> None:
    dialect = rng.choice(DIALECTS)
    unit, number, call = rng.randrange(2), rng.randrange(0x10000), some_call(rng, dialect)
    pdu = some_answer(rng, call)
    order = dialect.order
    length = (len(pdu) + 1).to_bytes(2, order)
    frame = number.to_bytes(2, order) + b"\0\0" + length + bytes([unit]) + pdu
    octets = bend(rng, frame)
    pending: MbapExchange
    if rng.random() < 0.5:
        pending, pieces = DatagramExchange(unit, call, number, dialect), [octets]
    else:
        cut = rng.randrange(len(octets) + 1)
        pending = MbapExchange(unit, call, number, MbapStream(dialect))
        pieces = [octets[:cut], octets[cut:]]
    for piece in pieces:
        try:
            found = pending.feed(piece)
        except (LinkDown, WrongAnswer):
            return
        if found is not None:
            assert found in octets
            judge(call, found)
            return
    assert octets != frame or len(pdu) < 2
    whole_frame(octets, dialect)


def count_size(rng: random.Random) -> None:
    """The size is never called wrong where the answer fits the request."""
    dialect = rng.choice(DIALECTS)
    call = some_call(rng, dialect)
    answer = call.head + rng.randbytes(call.answer_size - len(call.head))
    dialect.check_count_size(call.pdu, answer)
    judge(call, answer)
    bent = bend(rng, answer)
    try:
        dialect.check_count_size(call.pdu, bent)
    except WrongAnswer:
        assert bent[:1] == call.head[:1]
        assert bent != answer


TARGETS = (exchange, exchange, exchange, count_size)


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

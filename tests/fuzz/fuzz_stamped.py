"""Bent octets of time-stamped inputs against a second parser, for as long as it is told to.

    python tests/fuzz/fuzz_stamped.py SECONDS [SEED]

``paper`` below is written from the document alone ("A technique for implementation of Time Stamping
of Data using the MODBUS Encapsulated Interface Transport", and V1.1b3 for the shorter exception).
Both must agree on every octet string: the same refusal, the same code or the same inputs.
``test_fuzz_stamped.py`` runs a moment of it.
"""

from __future__ import annotations

import random
import sys
import time
from contextlib import suppress

from roclog.changes import ChangeMemory
from roclog.errors import ExceptionAnswer, LinkDown, WrongAnswer
from roclog.modbus.library import crc
from roclog.modbus.mbap import MbapExchange, MbapStream
from roclog.modbus.request import Mei, ReadStamped, check_answer
from roclog.modbus.rtu import Echo, RtuExchange
from roclog.modbus.stamped import Layout, LayoutProbe, parse, plausible_layout
from roclog.simulators import stamped_pdu

Inputs = list[tuple[int, int, bytes]]
"""Address, value, stamp."""


class PaperError(Exception):
    """The octets are no answer to this request."""


def paper(mei: int, address: int, count: int, pdu: bytes, *, grouped: bool) -> int | Inputs:
    """An exception code, or the inputs."""
    octets = list(pdu)
    if octets[:1] == [0xAB]:
        if len(octets) == 3 and octets[1] == mei:
            return octets[2]
        if len(octets) == 2:
            return octets[1]
        raise PaperError
    if len(octets) < 3 or octets[:2] != [0x2B, mei] or octets[2] != len(octets) - 3:
        raise PaperError
    m = {0x82: 7, 0x84: 7, 0x92: 4, 0x94: 4}[mei]
    rest = octets[3:]
    if mei in (0x82, 0x92):
        values, each = paper_discrete(rest, count, m)
    elif len(rest) != count * (2 + m):
        raise PaperError
    elif grouped:
        values = [rest[2 * i] * 256 + rest[2 * i + 1] for i in range(count)]
        each = [rest[2 * count + m * i :][:m] for i in range(count)]
    else:
        values, each = [], []
        while rest:
            values.append(rest.pop(0) * 256 + rest.pop(0))
            each.append([rest.pop(0) for _ in range(m)])
    addresses = range(address, address + count)
    return [(a, v, bytes(s)) for a, v, s in zip(addresses, values, each, strict=True)]


def paper_discrete(rest: list[int], count: int, m: int) -> tuple[list[int], list[list[int]]]:
    """Values and stamps from what follows the byte count."""
    n = rest.pop(0) if rest else 0
    if n != (count + 7) // 8 or len(rest) != n + 1 + m * count or rest[n] != m * count:
        raise PaperError
    values = [int(bool(rest[i // 8] & 1 << i % 8)) for i in range(count)]
    stamps = rest[n + 1 :]
    return values, [stamps[m * i : m * i + m] for i in range(count)]


def ours(request: ReadStamped, pdu: bytes, layout: Layout) -> int | Inputs:
    try:
        check_answer(request, pdu)
    except ExceptionAnswer as refusal:
        return refusal.code
    except WrongAnswer:
        raise PaperError from None
    points = parse(request, pdu, layout).points
    return [(point.address, point.value, point.stamp) for point in points]


def agree(request: ReadStamped, pdu: bytes, layout: Layout) -> None:
    try:
        expected: int | Inputs | None = paper(
            request.mei, request.address, request.count, pdu, grouped=layout is Layout.GROUPED
        )
    except PaperError:
        expected = None
    try:
        found: int | Inputs | None = ours(request, pdu, layout)
    except PaperError:
        found = None
    assert found == expected, (request, pdu.hex(" "), layout, found, expected)


def bend(rng: random.Random, octets: bytes) -> bytes:
    """Flip, set, cut, insert, repeat, or leave as it is."""
    bent = bytearray(octets)
    for _ in range(rng.choice((0, 0, 1, 1, 2, 5))):
        at = rng.randrange(min(len(bent), rng.choice((8, 300))) + 1)
        match rng.randrange(5):
            case 0 if at < len(bent):
                bent[at] ^= 1 << rng.randrange(8)
            case 1 if at < len(bent):
                bent[at] = rng.choice((0, 1, 0xFF, 0x2B, 0xAB, *Mei, rng.randrange(256)))
            case 2:
                del bent[at : at + rng.randrange(1, 9)]
            case 3:
                bent[at:at] = rng.randbytes(rng.randrange(1, 9))
            case 4:
                bent[at:at] = octets[: rng.randrange(len(octets) + 1)]
    return bytes(bent)


def some_request(rng: random.Random) -> ReadStamped:
    mei = rng.choice(tuple(Mei))
    count = min(mei.most, rng.choice((1, 2, 8, 9, 22, mei.most, rng.randrange(1, 61))))
    return ReadStamped(mei, rng.choice((0, 8, 196, 0x10000 - count)), count)


def some_answer(rng: random.Random, request: ReadStamped) -> bytes:
    """From the simulator's encoder: right, refused, or misprinted."""
    asked = stamped_pdu.parse_request(request.pdu)
    assert (asked.mei, asked.address, asked.count) == (
        request.mei, request.address, request.count,
    )  # fmt: skip
    if rng.random() < 0.25:
        code = rng.choice((1, 2, 3, 4, request.mei, rng.randrange(256)))
        return stamped_pdu.exception_answer(request.mei, code, with_mei=rng.random() < 0.5)
    size = request.mei.stamp_size
    filler = rng.choice((b"", bytes(size), b"\xff" * size))
    highest = 2 if request.mei.is_discrete else 0x10000
    inputs = [(rng.randrange(highest), filler or rng.randbytes(size)) for _ in range(request.count)]
    if not request.mei.is_discrete:
        return stamped_pdu.register_answer(request.mei, inputs, grouped=rng.random() < 0.5)
    answer = stamped_pdu.discrete_answer(request.mei, inputs)
    if request.mei == 0x92 and rng.random() < 0.3:
        faults = {"mei": rng.random() < 0.5, "counts": rng.random() < 0.5}
        return stamped_pdu.as_printed(answer, **faults)
    return answer


def pieces(rng: random.Random, octets: bytes) -> list[bytes]:
    edges = sorted(rng.randrange(len(octets) + 1) for _ in range(rng.randrange(6)))
    return [octets[a:b] for a, b in zip([0, *edges], [*edges, len(octets)], strict=True)]


def pdu(rng: random.Random) -> None:
    request = some_request(rng)
    asked = request if rng.random() < 0.8 else some_request(rng)
    octets = bend(rng, some_answer(rng, asked))
    for layout in Layout:
        agree(request, octets, layout)


def rtu(rng: random.Random) -> None:
    unit, request = rng.randrange(1, 248), some_request(rng)
    pending = RtuExchange(unit, request, rng.choice(tuple(Echo)))
    frame = bytes([unit]) + some_answer(rng, request)
    octets = bend(rng, rng.choice((b"", pending.adu)) + frame + crc(frame))
    found = None
    for piece in pieces(rng, octets):
        found = pending.feed(piece)
        if found is not None:
            break
    found = pending.conclude() if found is None else found
    if found is not None:
        whole = bytes([unit]) + found
        assert whole + crc(whole) in octets
        assert len(found) in (2, 3) or found.startswith(request.head)
        agree(request, found, rng.choice(tuple(Layout)))


def mbap(rng: random.Random) -> None:
    request = some_request(rng)
    pending = MbapExchange(1, request, 7, MbapStream())
    answer = some_answer(rng, request)
    header = b"\0\7\0\0" + (len(answer) + 1).to_bytes(2) + b"\1"
    for piece in pieces(rng, bend(rng, header + answer)):
        try:
            found = pending.feed(piece)
        except (LinkDown, WrongAnswer):
            return
        if found is not None:
            agree(request, found, rng.choice(tuple(Layout)))
            return


def layout(rng: random.Random) -> None:
    """Any answers that pass the check: the probe ends, and the judge names a layout or none."""
    mei = rng.choice((Mei.REGISTERS_7, Mei.REGISTERS_4))
    probe = LayoutProbe(mei, [8, 9])
    kinds = [rng.randbytes(9) for _ in range(rng.choice((1, 2, 3)))]
    asked = 0
    while (request := probe.request) is not None:
        points = b"".join(rng.choice(kinds)[: 2 + mei.stamp_size] for _ in range(request.count))
        answer = request.head + points
        check_answer(request, answer)
        probe.take(answer)
        chosen = plausible_layout(request, answer, lambda stamp: stamp[0] < 128)
        assert chosen in (None, *Layout)
        asked += 1
    assert asked <= 14


def carried(rng: random.Random) -> None:
    """A memory comes back as it was; another text is refused or is a memory."""
    memory = ChangeMemory()
    for address in rng.sample(range(12), rng.randrange(12)):
        stamp = rng.randbytes(rng.choice((4, 7)))
        change = memory.judge(address, rng.randrange(2), stamp, lambda *_: (rng.randrange(99), 3))
        assert change is not None
        memory.keep(change)
    text = memory.text()
    assert ChangeMemory(text).text() == text
    bent = bend(rng, bytes.fromhex(text)).hex()
    with suppress(ValueError):
        ChangeMemory(ChangeMemory(bent).text())


TARGETS = (pdu, pdu, pdu, rtu, mbap, layout, carried)


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
    print(f"{run(limit, first)} cases from {first}, both parsers agree")

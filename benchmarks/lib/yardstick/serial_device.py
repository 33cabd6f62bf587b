"""``python -m yardstick.serial_device``: the device at the far end of a serial line.

It answers the measured read and nothing else, from octets made beforehand, and checks every octet
of the request. Without ``--port`` it lays a pseudo-terminal of its own without wire time and prints
its name. It ends when standard input is closed, and then prints what it saw as one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import termios
import time
import tty
from dataclasses import asdict, dataclass

from yardstick.frames import REQUEST_SIZE, rtu_address, rtu_answer

_END = 0
_PAUSE_S = 0.02
"""So long without an octet, and what lies in the buffer is no request any more."""


@dataclass
class Seen:
    """answered, late: answers, and those of them that were held back.

    unexpected: requests, or remains of some, that are not the measured read.
    """

    answered: int = 0
    late: int = 0
    unexpected: int = 0


@dataclass(frozen=True)
class Manner:
    """How it answers: after ``turnaround`` seconds; a share of ``late`` after 80 to 250 ms.

    deaf: what arrives while it is busy is dropped; otherwise it is answered in its turn.
    """

    turnaround: float
    late: float
    deaf: bool
    seed: int


def serve(port: int, manner: Manner) -> Seen:
    """Answer until standard input ends."""
    seen = Seen()
    chance = random.Random(manner.seed)
    buffer = b""
    while True:
        ready, _, _ = select.select([port, _END], [], [], _PAUSE_S)
        if _END in ready and not os.read(_END, 64):
            return seen
        if port not in ready:
            seen.unexpected += bool(buffer)
            buffer = b""
            continue
        buffer += os.read(port, 4096)
        while len(buffer) >= REQUEST_SIZE:
            request, buffer = buffer[:REQUEST_SIZE], buffer[REQUEST_SIZE:]
            address = rtu_address(request)
            if address is None:
                seen.unexpected += 1
                buffer = b""
                break
            _pause(manner, chance, seen)
            os.write(port, rtu_answer(address))
            seen.answered += 1
            if manner.deaf:
                termios.tcflush(port, termios.TCIFLUSH)
                buffer = b""


def _pause(manner: Manner, chance: random.Random, seen: Seen) -> None:
    if chance.random() < manner.late:
        seen.late += 1
        time.sleep(chance.uniform(0.08, 0.25))
    elif manner.turnaround:
        time.sleep(manner.turnaround)


def _port(path: str | None) -> int:
    if path is not None:
        port = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(port)
        return port
    port, terminal = os.openpty()  # the far end stays open here, so that clients may come and go
    tty.setraw(terminal)
    print(os.ttyname(terminal), flush=True)
    return port


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port")
    parser.add_argument("--turnaround", type=float, default=0.0)
    parser.add_argument("--late", type=float, default=0.0)
    parser.add_argument("--deaf", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    manner = Manner(given.turnaround, given.late, given.deaf, given.seed)
    port = _port(given.port)
    if given.port is not None:
        print(given.port, flush=True)
    print(json.dumps(asdict(serve(port, manner))))


if __name__ == "__main__":
    main()

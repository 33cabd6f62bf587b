"""Run inside a network namespace of its own: a TCP peer that vanishes without a word.

Prints the seconds from the request to the end of the connection, with the given user time-out.
"""

from __future__ import annotations

import asyncio
import fcntl
import socket
import struct
import sys
import time

from roclog.bus import tcp
from roclog.bus.bus import Bus
from roclog.bus.tally import Tally
from roclog.bus.timing import Framing, Timing
from roclog.clock import SystemClock
from roclog.errors import LinkDown
from roclog.modbus.request import ReadRegisters

SIOCSIFFLAGS = 0x8914
IFF_UP = 1


def set_loopback(*, up: bool) -> None:
    with socket.socket() as any_socket:
        request = struct.pack("16sh", b"lo", IFF_UP if up else 0)
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, request)


async def main() -> None:
    set_loopback(up=True)
    server = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    timing = Timing(framing=Framing.MBAP_STREAM, timeout=10**10)
    bus = Bus(tcp.TcpLink("127.0.0.1", port), timing, SystemClock(), frozenset())
    pending = asyncio.create_task(bus.transact(1, ReadRegisters(3, 0, 1), Tally()))
    await asyncio.sleep(0.1)
    assert bus._opened
    set_loopback(up=False)
    begun = time.monotonic()
    bus.link.send(b"x")
    try:
        await pending
    except LinkDown as error:
        print(time.monotonic() - begun, error)
    server.close()


tcp._USER_TIMEOUT_MS = int(sys.argv[1])  # type: ignore[misc]
asyncio.run(main())

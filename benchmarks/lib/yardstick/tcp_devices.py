"""``python -m yardstick.tcp_devices``: any number of Modbus TCP devices in one quick process.

Every address of 127/8 is a device of its own. The measured read is answered from octets made
beforehand, after every octet of the request behind its number was checked; whatever else stands in
the request ends the connection and is counted. Register 300 and 301 of a device, read as
one number, count its answers, so that no two of them are alike.

Prints its port, ends when standard input is closed, and then prints what it saw as one line of
JSON. With ``--arrivals`` the instant of every request goes into a file: for each device a line with
its address and nanoseconds of the monotonic clock.
"""

from __future__ import annotations

import argparse
import json
import select
import socket
import struct
import sys
import time
from array import array
from contextlib import suppress
from pathlib import Path

from yardstick.frames import answer_pdu, request_pdu, tcp_tail

_ADDRESS = 300
_REQUEST = tcp_tail(request_pdu(_ADDRESS))
_ANSWER = tcp_tail(answer_pdu(_ADDRESS))
_VALUES_AT = 7


class Devices:
    def __init__(self, *, counts: bool) -> None:
        self._listener = socket.create_server(("0.0.0.0", 0), backlog=4096)
        self.port: int = self._listener.getsockname()[1]
        self.answered = self.unexpected = 0
        self.arrivals: dict[str, array[int]] = {}
        self._counts = counts
        self._connections: dict[int, tuple[socket.socket, array[int]]] = {}
        self._poller = select.epoll()

    def serve(self) -> None:
        """Answer until standard input ends."""
        listener = self._listener.fileno()
        self._poller.register(sys.stdin.fileno(), select.EPOLLIN | select.EPOLLHUP)
        self._poller.register(listener, select.EPOLLIN)
        while True:
            for descriptor, _ in self._poller.poll():
                if descriptor in self._connections:
                    self._answer(descriptor)
                elif descriptor == listener:
                    self._accept()
                else:
                    return

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        device = connection.getsockname()[0]
        arrivals = self.arrivals.setdefault(device, array("q"))
        self._connections[connection.fileno()] = (connection, arrivals)
        self._poller.register(connection, select.EPOLLIN)

    def _answer(self, descriptor: int) -> None:
        connection, arrivals = self._connections[descriptor]
        request = b""
        with suppress(ConnectionError):
            request = connection.recv(4096)
        if request[2:] != _REQUEST:
            self.unexpected += bool(request)
            del self._connections[descriptor]
            connection.close()
            return
        answer = _ANSWER
        if self._counts:
            arrivals.append(time.monotonic_ns())
            answer = _counted(len(arrivals))
        with suppress(ConnectionError):
            connection.send(request[:2] + answer)
            self.answered += 1


def _counted(number: int) -> bytes:
    answer = bytearray(_ANSWER)
    struct.pack_into(">I", answer, _VALUES_AT, number)
    return bytes(answer)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arrivals", type=Path)
    given = parser.parse_args()
    devices = Devices(counts=given.arrivals is not None)
    print(devices.port, flush=True)
    devices.serve()
    if given.arrivals is not None:
        with given.arrivals.open("w") as file:
            for device, instants in devices.arrivals.items():
                print(device, *instants, file=file)
    print(json.dumps({"answered": devices.answered, "unexpected": devices.unexpected}))


if __name__ == "__main__":
    main()

"""A TCP connection, to a Modbus TCP server or to a gateway that passes RTU frames through."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, Final

from roclog.bus.link import Link

if TYPE_CHECKING:
    from collections.abc import Callable

_CONNECT_SECONDS: Final = 3.0
_USER_TIMEOUT_MS: Final = 5000
"""Unacknowledged octets older than this end the connection: a half-open peer is noticed."""
_DEAF: Final = 4
"""Requests in a row without an octet back, after which the connection is opened anew: a peer can
acknowledge for ever what it no longer serves."""


class TcpLink(Link):
    """One client connection."""

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self._stream: _Stream | None = None

    @property
    def name(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def is_deaf(self) -> bool:
        return self._stream is not None and self._stream.unanswered >= _DEAF

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self.close()
        stream = self._stream = _Stream(receive, lost)
        try:
            async with asyncio.timeout(_CONNECT_SECONDS):
                await asyncio.get_running_loop().create_connection(
                    lambda: stream, self.host, self.port
                )
            stream.watch_peer()
        except BaseException as error:
            self.close()
            if isinstance(error, TimeoutError):
                raise OSError(f"no connection within {_CONNECT_SECONDS:g} s") from error
            if isinstance(error, UnicodeError):
                raise OSError(f"{self.host!r} is not a host name") from error
            raise

    def send(self, octets: bytes) -> None:
        if self._stream is None:
            raise OSError("the connection is closed")
        self._stream.send(octets)

    def close(self) -> None:
        if self._stream is not None:
            self._stream.abort()
            self._stream = None


class _Stream(asyncio.Protocol):
    def __init__(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self._receive = receive
        self._lost = lost
        self._transport: asyncio.Transport | None = None
        self._closed_here = False
        self.unanswered = 0

    def watch_peer(self) -> None:
        """Have the system notice a peer that vanished without a word."""
        if self._transport is None:
            raise OSError("the connection is closed")
        connection: socket.socket = self._transport.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _USER_TIMEOUT_MS)

    def send(self, octets: bytes) -> None:
        if self._transport is None or self._transport.is_closing():
            raise OSError("the connection is closed")
        self.unanswered += 1
        self._transport.write(octets)

    def abort(self) -> None:
        self._closed_here = True
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self.unanswered = 0
        self._receive(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self._closed_here:
            self._lost(str(exc) if exc else "the peer closed the connection")

"""Modbus TCP link."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

_CONNECT_SECONDS: Final = 3.0
_USER_TIMEOUT_MS: Final = 5000
"""Unacknowledged octets older than this end the connection: a half-open peer is noticed."""


class TcpLink:
    """One client connection."""

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self._transport: asyncio.Transport | None = None

    @property
    def name(self) -> str:
        return f"{self.host}:{self.port}"

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(_CONNECT_SECONDS):
                self._transport, _ = await loop.create_connection(
                    lambda: _Stream(receive, lost), self.host, self.port
                )
        except TimeoutError as error:
            raise OSError(f"no connection within {_CONNECT_SECONDS} s") from error
        stream: socket.socket = self._transport.get_extra_info("socket")
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _USER_TIMEOUT_MS)

    def send(self, octets: bytes) -> None:
        if self._transport is None or self._transport.is_closing():
            raise OSError("the connection is closed")
        self._transport.write(octets)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()
            self._transport = None


class _Stream(asyncio.Protocol):
    def __init__(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self.data_received = receive  # type: ignore[method-assign]
        self._lost = lost

    def connection_lost(self, exc: Exception | None) -> None:
        self._lost(str(exc) if exc else "the peer closed the connection")

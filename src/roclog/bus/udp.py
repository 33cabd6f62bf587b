"""Modbus UDP link: one ADU per datagram, both ways."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, cast

from roclog.bus.link import Link

if TYPE_CHECKING:
    from collections.abc import Callable

_RESOLVE_SECONDS: Final = 3.0


class UdpLink(Link):
    """One connected socket: the system drops datagrams of others, and tells of a closed port.

    Opening says nothing about the peer. ``lost`` is called when the system refuses a datagram or
    the peer's computer says that nobody listens there.
    """

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self._datagrams: _Datagrams | None = None

    @property
    def name(self) -> str:
        return f"{self.host}:{self.port}"

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self.close()
        datagrams = self._datagrams = _Datagrams(receive, lost)
        try:
            async with asyncio.timeout(_RESOLVE_SECONDS):
                await asyncio.get_running_loop().create_datagram_endpoint(
                    lambda: datagrams, remote_addr=(self.host, self.port)
                )
        except BaseException as error:
            self.close()
            if isinstance(error, TimeoutError):
                raise OSError(f"no address within {_RESOLVE_SECONDS:g} s") from error
            if isinstance(error, UnicodeError):
                raise OSError(f"{self.host!r} is not a host name") from error
            raise

    def send(self, octets: bytes) -> None:
        if self._datagrams is None:
            raise OSError("the socket is closed")
        self._datagrams.send(octets)

    def close(self) -> None:
        if self._datagrams is not None:
            self._datagrams.abort()
            self._datagrams = None


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        self._receive = receive
        self._lost = lost
        self._transport: asyncio.DatagramTransport | None = None
        self._closed = False
        self._is_sending = False
        self._refusal: Exception | None = None

    def send(self, octets: bytes) -> None:
        if self._closed or self._transport is None:
            raise OSError("the socket is closed")
        self._refusal = None
        self._is_sending = True
        try:
            self._transport.sendto(octets)
        finally:
            self._is_sending = False
        if self._refusal is not None:
            raise self._refusal

    def abort(self) -> None:
        self._closed = True
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # Not every version of asyncio derives its transport from this class.
        self._transport = cast("asyncio.DatagramTransport", transport)
        if self._closed:
            self._transport.abort()

    def datagram_received(self, data: bytes, addr: object) -> None:
        del addr  # a connected socket hears its peer only
        if not self._closed:
            self._receive(data)

    def error_received(self, exc: Exception) -> None:
        if self._is_sending:
            self._refusal = exc
        else:
            self._gone(exc)

    def connection_lost(self, exc: Exception | None) -> None:
        self._gone(exc or OSError("the socket is closed"))

    def _gone(self, error: Exception) -> None:
        if self._closed:
            return
        self.abort()
        reason = error.strerror if isinstance(error, OSError) else None
        self._lost(reason or str(error))

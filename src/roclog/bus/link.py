"""What a bus needs of a medium: open, send octets, hand over what arrives, say when it is gone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable


class Link(Protocol):
    """One serial port or one connection. It frames nothing and retries nothing."""

    @property
    def name(self) -> str:
        """As the user knows it: a device path or host:port."""
        ...

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        """Open, or raise OSError. ``lost`` is called once if the medium goes away later."""
        ...

    def send(self, octets: bytes) -> None:
        """Hand over for transmission at once, or raise OSError."""
        ...

    def close(self) -> None:
        """Close without calling ``lost``; closing twice is allowed."""
        ...

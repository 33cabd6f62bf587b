"""What a bus needs of a medium: open, send octets, hand over what arrives, say when it is gone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


@dataclass(frozen=True, slots=True, kw_only=True)
class LineErrors:
    """Characters that a serial driver found damaged.

    frame: without stop bit. parity: wrong parity. overrun: lost, the adapter or its driver was
    full. breaks: the line was low for longer than a character.
    """

    frame: int = 0
    parity: int = 0
    overrun: int = 0
    breaks: int = 0


class Link(Protocol):
    """One serial port or one connection. It frames nothing and retries nothing."""

    @property
    def name(self) -> str:
        """As the user knows it: a device path or host:port."""
        ...

    @property
    def is_deaf(self) -> bool:
        """Nothing came back for so long that a new connection may fare better."""
        return False

    async def open(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        """Open, or raise OSError. ``lost`` is called once if the medium goes away later."""
        ...

    def send(self, octets: bytes) -> None:
        """Hand over for transmission at once, or raise OSError."""
        ...

    def close(self) -> None:
        """Close without calling ``lost``; closing twice is allowed."""
        ...

    def describe(self) -> Mapping[str, str]:
        """Facts about what was opened last, by name; empty where there are none.

        ``warning`` is one that the user should act on.
        """
        return {}

    def line_errors(self) -> LineErrors | None:
        """Of all the time in which it was open, never less than before; None: nobody counts."""
        return None

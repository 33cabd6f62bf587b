"""What a device asks of everything that it reads on a schedule."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from roclog.outbox import Outbox


class Poller(Protocol):
    """A block, or several that are read together, or a list of points."""

    @property
    def period(self) -> int:
        """Nanoseconds from turn to turn."""
        ...

    @property
    def outbox(self) -> Outbox:
        """Where its messages wait for the disk."""
        ...

    @property
    def samples(self) -> int:
        """Messages of samples so far; earlier runs count."""
        ...

    async def turn(self, due: int) -> None:
        """One poll, that was due at this monotonic nanosecond.

        Raises:
            DeviceError: the device did not answer as it should; what was learnt before is kept.
        """
        ...

    def close(self) -> None:
        """The end of a run: what is still open is said."""
        ...

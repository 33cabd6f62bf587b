"""What a device asks of everything that it reads on a schedule."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from roclog.clock import Instant
    from roclog.outbox import Outbox


class Poller(Protocol):
    """A block, or several that are read together, or a list of points."""

    @property
    def name(self) -> str:
        """What it reads, for people."""
        ...

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

    def expect(self, due: int) -> None:
        """A turn is due at this monotonic nanosecond: what it does not bring is missed.

        ``turn`` does so itself; this stands in for one that cannot even begin.
        """
        ...

    async def turn(self, due: int) -> None:
        """One poll, that was due at this monotonic nanosecond.

        Raises:
            DeviceError: the device did not answer as it should; what was learnt before is kept.
        """
        ...

    def close(self, now: Instant, *, is_end: bool = True) -> None:
        """What is still open is said, and what was not read since it last was.

        is_end: of the run; else another device has answered, and brings the turn in hand.
        """
        ...

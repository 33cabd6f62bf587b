"""Who uses a connection next: of those who wait, the one whose work was due first."""

from __future__ import annotations

import asyncio
import heapq


class Turns:
    """One holder at a time. ``take``, work, ``release``.

    Whoever has begun something (a sample to confirm, a flag to clear) asks with the instant at
    which that was due, and so goes before everything that became due later.
    """

    def __init__(self) -> None:
        self._is_taken = False
        self._waiting: list[tuple[int, int, asyncio.Future[None]]] = []
        self._asked = 0

    @property
    def has_queue(self) -> bool:
        return bool(self._waiting)

    async def take(self, due: int) -> None:
        """Return when it is our turn. due: monotonic nanoseconds; equals go in order of asking."""
        if not self._is_taken:
            self._is_taken = True
            return
        self._asked += 1
        turn = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (due, self._asked, turn))
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():
                self.release()  # it was given to us, and we no longer want it
            raise

    def release(self) -> None:
        """Give the connection to the next one."""
        while self._waiting:
            _, _, turn = heapq.heappop(self._waiting)
            if not turn.done():
                turn.set_result(None)
                return
        self._is_taken = False

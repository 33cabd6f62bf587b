"""A test device on a TCP port or a pseudo terminal: in the caller's loop, a thread or a process."""

from __future__ import annotations

import asyncio
import signal
import threading
from concurrent.futures import Future
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Self

from roc_links import PtySide, Shared, TcpSide
from roc_truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable


class Served:
    """Runs either in the caller's event loop (`serve`) or in a thread (`start`, `stop`).

    address: the port or the link's path. model: has what `Exchange` asks for, and `power_up`.
    """

    model: Any

    def __init__(self, options: Any) -> None:
        self.options = options
        self.truth = Truth(options.truth)
        self.address = ""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended: asyncio.Event | None = None
        self._thread: threading.Thread | None = None

    def faults(self) -> Any:
        """What happens to answers."""
        raise NotImplementedError

    def side(self, shared: Shared) -> Any:
        """Where it listens."""
        options = self.options
        return TcpSide(shared, options.tcp) if options.tcp else PtySide(shared, options.pty)

    def begin(self) -> None:
        """In the loop, once the device listens."""

    async def serve(self, ready: Callable[[str], None]) -> None:
        """`ready` is told the port or the link's path; returns when the device has ended."""
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        options = self.options
        shared = Shared(options, self.truth, self.model, self.faults())
        side = self.side(shared)
        self.truth.log("start", options=asdict(options))
        self.model.power_up()
        self.address = await side.open()
        self.begin()
        ready(self.address)
        try:
            await self._ended.wait()
        finally:
            side.close()
            await asyncio.sleep(0)  # lets the connections notice
            self.truth.log("end")
            self.truth.close()

    def end(self) -> None:
        """From any thread, or from a signal handler of the loop."""
        if self._loop is not None and self._ended is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._ended.set)

    def start(self) -> str:
        ready: Future[str] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), daemon=True)
        self._thread.start()
        return ready.result()

    def stop(self) -> None:
        self.end()
        if self._thread is not None:
            self._thread.join()

    def process(self) -> None:
        """Until SIGTERM or SIGINT; `listening PORT` or `listening LINK` on stdout: ready."""
        asyncio.run(self._until_signal())

    async def _until_signal(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.end)
        await self.serve(lambda address: print(f"listening {address}", flush=True))

    def _run(self, ready: Future[str]) -> None:
        try:
            asyncio.run(self.serve(ready.set_result))
        except BaseException as error:
            if ready.done():
                raise
            ready.set_exception(error)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

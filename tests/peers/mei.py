"""A device with time-stamped inputs to test a logger with: events at a rate, faults on demand."""

from __future__ import annotations

import asyncio
import signal
import threading
from concurrent.futures import Future
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Self

from mei_model import Model
from mei_options import Options, parse_options
from roc_links import Faults, PtySide, Shared, TcpSide
from roc_options import rng
from roc_truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable


class Events:
    """Event k comes at about k / rate seconds, whatever the load is."""

    def __init__(self, options: Options, model: Model) -> None:
        self._options = options
        self._model = model
        self._random = rng(options.seed, "schedule")
        self._loop = asyncio.get_running_loop()
        self._started = self._loop.time()
        self._k = 0

    def start(self) -> None:
        if self._options.rate > 0 and self._k != (self._options.events or -1):
            self._k += 1
            due = self._started + (self._k + self._random.uniform(-0.5, 0.5)) / self._options.rate
            self._loop.call_at(due, self._happen)

    def _happen(self) -> None:
        self._model.event()
        self.start()


class MeiDevice:
    """Runs either in the caller's event loop (`serve`) or in a thread (`start`, `stop`).

    address: the port or the link's path.
    """

    def __init__(self, options: Options) -> None:
        self.options = options
        self.truth = Truth(options.truth)
        self.model = Model(options, self.truth)
        self.address = ""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended: asyncio.Event | None = None
        self._thread: threading.Thread | None = None

    async def serve(self, ready: Callable[[str], None]) -> None:
        """`ready` is told the port or the link's path; returns when the device has ended."""
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        options: Any = self.options  # the links ask for some options and for the model's answers
        model: Any = self.model
        shared = Shared(options, self.truth, model, Faults(options))
        side = TcpSide(shared, options.tcp) if options.tcp else PtySide(shared, options.pty)
        self.truth.log("start", options=asdict(self.options))
        self.model.power_up()
        self.address = await side.open()
        Events(self.options, self.model).start()
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


async def _process(options: Options) -> None:
    device = MeiDevice(options)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, device.end)
    await device.serve(lambda address: print(f"listening {address}", flush=True))


def main() -> None:
    asyncio.run(_process(parse_options()))


if __name__ == "__main__":
    main()

"""A HIAC ROC particle counter to test a logger with: samples on a schedule, faults on demand."""

from __future__ import annotations

import asyncio
import signal
import threading
from concurrent.futures import Future
from dataclasses import asdict
from typing import TYPE_CHECKING, Self

from roc_links import Faults, PtySide, Shared, TcpSide
from roc_model import Model
from roc_options import Options, parse_options, rng
from roc_truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable

    from roc_samples import Sample

_SPLITS = range(309, 326)
"""Where a torn block may be cut: 308 is always new by then, 325 and 326 still old."""

_DARK_CYCLES = 2


class Schedule:
    """Sample k is complete at `anchor + (k - anchor_k) * cycle`, whatever the load is."""

    def __init__(self, shared: Shared, side: TcpSide | PtySide, end: Callable[[], None]) -> None:
        self._shared = shared
        self._options = shared.options
        self._model = shared.model
        self._side = side
        self._end = end
        self._loop = asyncio.get_running_loop()
        self._random = rng(shared.options.seed, "schedule")
        self._timers: list[asyncio.TimerHandle] = []
        self._anchor = self._loop.time()
        self._anchor_k = 0
        self._k = 0
        self._begun: Sample | None = None
        self._last = min(self._options.samples, self._options.stop_after or self._options.samples)
        self._model.race = self._race
        self._model.on_reset = self._reset
        self._model.on_acknowledge = lambda later: self._loop.call_later(1.0, later)
        self._model.on_power_failure = lambda: self._loop.call_soon(self.power_fails)

    def start(self) -> None:
        self._restart()
        if self._options.drop_link_every:
            self._loop.call_later(self._options.drop_link_every, self._drop_link)

    def _restart(self) -> None:
        """The next sample is complete one cycle from now."""
        self._anchor, self._anchor_k = self._loop.time(), self._k
        self._plan_live(self._anchor, 1)
        self._plan()

    def _plan(self) -> None:
        if self._k >= self._last:
            self._loop.call_later(self._options.linger, self._end)
            return
        due = self._anchor + (self._k + 1 - self._anchor_k) * self._options.cycle
        if self._options.tears:
            self._at(due - self._options.tear_seconds, self._begin)
        self._at(due, self._complete)

    def _at(self, due: float, action: Callable[[], None]) -> None:
        self._timers.append(self._loop.call_at(due, action))

    def _cancel(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _begin(self) -> None:
        self._begun = self._model.source.make()
        split = self._random.choice(_SPLITS)
        self._begun.facts["split"] = split
        self._model.begin(self._begun, split)

    def _complete(self) -> None:
        due = self._anchor + (self._k + 1 - self._anchor_k) * self._options.cycle
        self._finish(due)

    def _finish(self, due: float, *, raced: bool = False) -> None:
        self._cancel()
        sample, self._begun = self._begun or self._model.source.make(), None
        if raced:
            sample.facts["raced"] = True
        self._model.complete(sample)
        self._k = sample.k
        self._plan_between(due)
        self._plan()

    def _plan_between(self, due: float) -> None:
        options, cycle = self._options, self._options.cycle
        self._plan_live(due, 1)
        if options.plc:
            self._at(due + self._random.uniform(0, 0.5) * cycle, self._model.plc_clear)
        if self._k == options.reboot_at:
            self._loop.call_at(due + cycle / 2, self.power_fails)
        if self._k == options.stop_after:
            self._loop.call_at(due + cycle / 2, self._die)

    def _plan_live(self, since: float, quarter: int) -> None:
        """Every quarter cycle, except when a sample is due."""
        if not self._options.live:
            return
        following = quarter + 2 if quarter % 4 == 3 else quarter + 1

        def change() -> None:
            self._model.live()
            self._plan_live(since, following)

        self._at(since + quarter * self._options.cycle / 4, change)

    def _race(self, arrived: Sample | None) -> bool:
        """A clear is here: let the next sample be complete just before it takes effect."""
        every, following = self._options.race_every, self._k + 1
        if not every or following % every or following > self._last:
            return False
        if arrived is None or arrived is not self._model.current:
            return False
        if not arrived.delivered & {"ok", "late", "garbage"}:
            return False
        now = self._loop.time()
        self._anchor, self._anchor_k = now, following
        self._finish(now, raced=True)
        return True

    def _reset(self) -> None:
        self._stop_sampling()
        self._shared.mute = bool(self._options.reset_takes)
        if self._shared.mute:
            self._loop.call_later(self._options.reset_takes, self._start_again)
        else:
            self._start_again()

    def _start_again(self) -> None:
        self._model.power_up()
        self._shared.mute = False
        self._restart()

    def _stop_sampling(self) -> None:
        """A sample that was only half in the registers is lost with its number."""
        self._cancel()
        if self._begun is not None:
            self._k, self._begun = self._begun.k, None

    def power_fails(self) -> None:
        """For a while; what was not saved is gone then."""
        if self._shared.off:
            return
        self._shared.mute = self._shared.off = True
        self._stop_sampling()
        self._side.power_fails()
        self._shared.truth.log("power", on=False, k=self._k)
        self._loop.call_later(_DARK_CYCLES * self._options.cycle, self._power_on)

    def _power_on(self) -> None:
        self._model.power_up()
        self._shared.mute = self._shared.off = False
        self._shared.truth.log("power", on=True, k=self._k)
        self._restart()

    def _die(self) -> None:
        self._shared.mute = True
        self._cancel()
        self._shared.truth.log("dead", k=self._k)

    def _drop_link(self) -> None:
        self._side.drop()
        self._shared.truth.log("link_dropped")
        self._loop.call_later(self._options.drop_link_every, self._drop_link)


class RocDevice:
    """Runs either in the caller's event loop (`serve`) or in a thread (`start`, `stop`)."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self.truth = Truth(options.truth)
        self.model = Model(options, self.truth)
        self.address = ""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended: asyncio.Event | None = None
        self._thread: threading.Thread | None = None
        self._schedule: Schedule | None = None

    async def serve(self, ready: Callable[[str], None]) -> None:
        """`ready` is told the port or the link's path; returns when the device has ended."""
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        options = self.options
        shared = Shared(options, self.truth, self.model, Faults(options))
        side = TcpSide(shared, options.tcp) if options.tcp else PtySide(shared, options.pty or "")
        self.address = await side.open()
        self.truth.log("start", registers=list(self.model.block), options=asdict(options))
        self._schedule = Schedule(shared, side, self._ended.set)
        self._schedule.start()
        ready(self.address)
        try:
            await self._ended.wait()
        finally:
            side.close()
            await asyncio.sleep(0)  # lets the connections notice
            self.model.summary()
            self.truth.close()

    def end(self) -> None:
        """From any thread, or from a signal handler of the loop."""
        if self._loop is not None and self._ended is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._ended.set)

    def power_fails(self) -> None:
        """From a signal handler of the loop."""
        if self._schedule is not None:
            self._schedule.power_fails()

    def start(self) -> str:
        ready: Future[str] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), daemon=True)
        self._thread.start()
        return ready.result()

    def stop(self) -> None:
        self.end()
        self.wait()

    def wait(self) -> None:
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
    device = RocDevice(options)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, device.end)
    loop.add_signal_handler(signal.SIGUSR1, device.power_fails)
    await device.serve(lambda address: print(f"listening {address}", flush=True))


def main() -> None:
    asyncio.run(_process(parse_options()))


if __name__ == "__main__":
    main()

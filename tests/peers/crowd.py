"""Many ROCs on one serial line, some of them dead, flapping or babbling.

    python tests/peers/crowd.py --port TTY --truth DIR --healthy 1-22 --dead 23-27 \\
        --flapping 28-30 --babbling 31

`listening TTY` on stdout: ready. Ends with SIGTERM. `DIR/uN.truth.jsonl` is the truth of unit N, as
told by `roc.py`; who flaps logs `present`, who babbles `asked` and `babble`. Standard library only.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import time
import tty
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from roc import Schedule
from roc_links import Exchange, Faults, PtySide, Shared
from roc_model import Model
from roc_options import Options, rng
from roc_truth import Truth
from wire import READ, Request, RtuFramer, octets_of, rtu_frame

if TYPE_CHECKING:
    from random import Random

_NEVER = 10**6
_GAP = 0.03
"""Seconds of silence that end what is no request: longer than a busy host holds octets back,
shorter than the wait of a client behind a spoiled request."""


@dataclass(frozen=True, kw_only=True)
class Manners:
    """Seconds. flap: present so long, then absent so long. babble: mean time between two bursts
    that nobody asked for. character: on the wire. cycle: of the samples.
    """

    cycle: float
    flap: float
    babble: float
    character: float
    seed: int


class Line:
    """The devices' end. A burst that falls into another's answer spoils it, as on copper."""

    def __init__(self, port: str, manners: Manners) -> None:
        self.units: dict[int, Exchange | Babbler] = {}
        self.babbler: Babbler | None = None
        self._manners = manners
        self._loop = asyncio.get_running_loop()
        self._end = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._end)
        os.set_blocking(self._end, False)
        self._framer = RtuFramer()
        self._gap: asyncio.TimerHandle | None = None
        self._last_octet = self._loop.time()
        self._idle_ms = 0.0
        self._loop.add_reader(self._end, self._readable)

    def send(self, frame: bytes) -> None:
        if self.babbler is not None:
            frame = self.babbler.disturb(frame)
        self.put(frame)

    def put(self, octets: bytes) -> None:
        """With nobody reading the buffer fills up and octets are lost."""
        with suppress(BlockingIOError):
            os.write(self._end, octets)
        self._last_octet = self._loop.time() + len(octets) * self._manners.character

    def close(self) -> None:
        self._loop.remove_reader(self._end)
        os.close(self._end)

    def _readable(self) -> None:
        now = self._loop.time()
        try:
            octets = os.read(self._end, 4096)
        except BlockingIOError:
            return
        if not self._framer:
            self._idle_ms = 1000 * (now - self._last_octet)
        self._last_octet = now
        if self._gap is not None:
            self._gap.cancel()
        self._arrived(self._framer.feed(octets))
        if self._framer:
            self._gap = self._loop.call_later(_GAP, self._idle)

    def _idle(self) -> None:
        self._arrived(self._framer.idle()[0])

    def _arrived(self, requests: list[Request]) -> None:
        for request in requests:
            if request.unit in self.units:
                self.units[request.unit].arrive(request, self._idle_ms)


class Babbler:
    """Answers nothing that could be right, and talks unasked."""

    def __init__(self, unit: int, truth: Truth, line: Line, manners: Manners) -> None:
        self._unit = unit
        self._truth = truth
        self._line = line
        self._manners = manners
        self._random: Random = rng(manners.seed, "babble")
        self._loop = asyncio.get_running_loop()
        self._draw()

    def arrive(self, request: Request, idle_ms: float) -> None:
        fact = {"request": request.pdu.hex(), "request_mono_ns": time.monotonic_ns()}
        self._truth.log("asked", idle_ms=round(idle_ms, 3), **fact)
        self._line.put(self._random.choice(self._answers())())

    def disturb(self, frame: bytes) -> bytes:
        """The octets of another's answer, which is about to leave, as they will be heard."""
        seconds = len(frame) * self._manners.character
        if not self._due < self._loop.time() + seconds:
            return frame
        since = self._random.randrange(len(frame))
        spoiled = bytearray(frame)
        for place in range(since, min(len(frame), since + 20)):
            spoiled[place] ^= self._random.randrange(1, 256)
        self._truth.log("babble", spoils=frame[0])
        self._timer.cancel()
        self._draw()
        return bytes(spoiled)

    def _draw(self) -> None:
        self._due = self._loop.time() + self._random.expovariate(1 / self._manners.babble)
        self._timer = self._loop.call_at(self._due, self._burst)

    def _burst(self) -> None:
        self._truth.log("babble", spoils=None)
        self._line.put(self._random.randbytes(self._random.randint(1, 40)))
        self._draw()

    def _answers(self) -> list[_Octets]:
        octets, block = self._random.randbytes, 54  # of 27 registers
        words = octets_of([self._random.randrange(0x10000) for _ in range(block // 2)])
        good = rtu_frame(self._unit, bytes([READ, block]) + words)
        return [
            lambda: octets(self._random.randint(1, 80)),
            lambda: good[:-1] + bytes([good[-1] ^ 1]),  # whole, with a wrong checksum
            lambda: good[: self._random.randint(1, len(good) - 1)],
            lambda: rtu_frame(self._unit, bytes([READ, 2]) + octets(2)),  # of one register
            lambda: rtu_frame(self._unit, bytes([READ + 1, block]) + words),  # of another function
        ]


if TYPE_CHECKING:
    from collections.abc import Callable

    _Octets = Callable[[], bytes]


def _roc(unit: int, port: str, line: Line, truth: Truth, manners: Manners) -> Shared:
    """A device that samples; its first sample is complete within the first cycle or two."""
    options = Options(
        pty=port, unit=unit, cycle=manners.cycle, samples=_NEVER, seed=1000 * manners.seed + unit
    )
    shared = Shared(options, truth, Model(options, truth), Faults(options))
    line.units[unit] = Exchange(
        shared, line.send, lambda request, pdu: rtu_frame(request.unit, pdu)
    )
    schedule = Schedule(shared, cast("PtySide", line), lambda: None)
    delay = rng(options.seed, "start").uniform(0, manners.cycle)
    asyncio.get_running_loop().call_later(delay, schedule.start)
    return shared


async def _flap(shared: Shared, manners: Manners) -> None:
    """Present at first; then it comes and goes."""
    random = rng(shared.options.seed, "flap")
    while True:
        await asyncio.sleep(manners.flap * random.uniform(0.5, 1.5))
        shared.mute = not shared.mute
        shared.truth.log("present", present=not shared.mute)


def _range(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


async def _process(given: argparse.Namespace) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    loop.add_signal_handler(signal.SIGTERM, ended.set)
    manners = Manners(
        cycle=given.cycle,
        flap=given.flap,
        babble=given.babble,
        character=given.character,
        seed=given.seed,
    )
    line = Line(given.port, manners)
    truths = {}
    tasks = []
    for kind in ("healthy", "dead", "flapping", "babbling"):
        for unit in getattr(given, kind):
            truth = truths[unit] = Truth(str(Path(given.truth) / f"u{unit}.truth.jsonl"))
            if kind == "babbling":
                line.units[unit] = line.babbler = Babbler(unit, truth, line, manners)
                continue
            shared = _roc(unit, given.port, line, truth, manners)
            shared.mute = kind == "dead"
            if kind == "flapping":
                tasks.append(loop.create_task(_flap(shared, manners)))
    print(f"listening {given.port}", flush=True)
    await ended.wait()
    for task in tasks:
        task.cancel()
    line.close()
    for truth in truths.values():
        truth.close()


def main() -> None:
    parser = argparse.ArgumentParser(description="Many ROCs on one line", allow_abbrev=False)
    parser.add_argument("--port", required=True, help="terminal of the devices' end")
    parser.add_argument("--truth", required=True, help="directory of the truth logs")
    for kind in ("healthy", "dead", "flapping", "babbling"):
        parser.add_argument(f"--{kind}", type=_range, default=[], help="units, like 1-22")
    parser.add_argument("--cycle", type=float, default=30.0, help="seconds between samples")
    parser.add_argument("--flap", type=float, default=30.0, help="mean seconds of presence")
    parser.add_argument("--babble", type=float, default=20.0, help="mean seconds between bursts")
    parser.add_argument("--character", type=float, default=10 / 9600, help="seconds on the wire")
    parser.add_argument("--seed", type=int, default=1)
    asyncio.run(_process(parser.parse_args()))


if __name__ == "__main__":
    main()

"""One device on its schedule: facts first, then its block at every period, for ever."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from roclog.decode import Value, decode, field_names, word_order_doubts
from roclog.errors import DeviceError, ExceptionAnswer, LinkDown
from roclog.modbus.request import ReadRegisters, words
from roclog.samples import link_entry

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.clock import Clock
    from roclog.config.settings import Device
    from roclog.outbox import Outbox
    from roclog.poll import FlaggedBlock
    from roclog.recording.writer import Writer
    from roclog.register_map import Block
    from roclog.samples import Reading, SampleMaker

_LINK_PERIOD: Final = 60 * 10**9
_PATIENCE: Final = 3
"""Failures in a row that are not yet held against a device."""
_FACTS_PAUSE: Final = 60 * 10**9
_LONGEST_PAUSE: Final = 30 * 10**9
_ABSENT: Final = 60 * 10**9
"""After this long without an answer another device may stand there: the facts are read again."""


class PolledDevice:
    """Reads one device until it is told to stop."""

    def __init__(
        self,
        *,
        device: Device,
        bus: Bus,
        tally: Tally,
        block: FlaggedBlock,
        maker: SampleMaker,
        outbox: Outbox,
        writer: Writer,
        clock: Clock,
    ) -> None:
        self.device = device
        self.outbox = outbox
        self.facts: dict[str, dict[str, Value]] = {}
        self._bus = bus
        self._tally = tally
        self._block = block
        self._maker = maker
        self._writer = writer
        self._clock = clock
        self._facts_due = True
        self._facts_after = 0
        self._facts_failures = 0
        self._trouble = ""
        self._failures = 0
        self._silent_since: int | None = None
        self._link_since = clock.now()
        self._doubt_told = False
        self._live: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
        self._live_told: set[str] = set()
        self._set_cycle()

    @property
    def samples(self) -> int:
        """Number of the last sample."""
        return self._block.samples

    async def run(self, stop: asyncio.Event) -> None:
        """Poll without drift until ``stop``; one that is late by more than a period is left out."""
        period = self.device.poll
        due = self._clock.now().monotonic
        while not stop.is_set():
            busy = self._tally.busy
            await self._poll()
            now = self._clock.now().monotonic
            self._report_link(now - self._link_since.monotonic)
            due += period
            if now - due > period:
                due += (now - due) // period * period
            due = max(due, now + self._pause(self._tally.busy - busy))
            with suppress(TimeoutError):
                async with asyncio.timeout(max(0, due - self._clock.now().monotonic) / 1e9):
                    await stop.wait()

    def _pause(self, cost: int) -> int:
        """Rest after a failure, so that silent devices together take a quarter of a shared line.

        cost: what the failure took of the line. Where nobody answers there is nobody to spare.
        """
        failing = self._bus.failing
        if self._failures < _PATIENCE:
            failing.discard(self.device.name)
            return 0
        failing.add(self.device.name)
        if len(failing) == self._bus.devices:
            return 0
        return min(3 * cost * len(failing), _LONGEST_PAUSE)

    def close(self) -> None:
        """The end of a run: what is still open is said."""
        self._block.close()
        self._report_link(_LINK_PERIOD)

    async def _poll(self) -> None:
        """One attempt; a device that does not answer costs one time-out."""
        try:
            if self._facts_due and self._clock.now().monotonic >= self._facts_after:
                await self._read_facts()
            await self._block.turn()
        except DeviceError as error:
            self._tell_trouble(error)
            return
        self._tell_recovery()
        self._watch(self._block.last)

    async def _read_facts(self) -> None:
        """Identity and configuration; after a failure the next poll goes without them.

        A device that answers samples but not these is asked for them once a minute.
        """
        self._facts_failures += 1
        pause = _FACTS_PAUSE if self._facts_failures > _PATIENCE else 1.5 * self.device.poll
        self._facts_after = self._clock.now().monotonic + int(pause)
        for block in self.device.profile.facts:
            try:
                self.facts[block.name] = await self._read_fact(block)
            except ExceptionAnswer as refusal:
                self.outbox.event("warning", "facts", f"{block.name} block: {refusal}")
        self._facts_due = False
        self._facts_after = self._facts_failures = 0
        self._set_cycle()
        self._describe()

    async def _read_fact(self, block: Block) -> dict[str, Value]:
        request = ReadRegisters(block.table.read_function, block.address, block.count)
        answer = await self._bus.transact(self.device.unit, request, self._tally)
        decoded = decode(block, words(answer.pdu), self.device.word_order)
        return dict(zip(field_names(block), decoded.values, strict=True))

    def _describe(self) -> None:
        values = {name: json.dumps(facts) for name, facts in self.facts.items()}
        self._writer.describe(f"roclog.device.{self.device.name}", {**self._plain(), **values})

    def _plain(self) -> dict[str, str]:
        return {
            "profile": self.device.profile.name,
            "unit": str(self.device.unit),
            "connection": self.device.connection,
            "register_map": json.dumps(_described(self.device.profile.samples)),
        }

    def _set_cycle(self) -> None:
        cycle = self.device.cycle
        source = self.device.profile.cycle
        if cycle is None and source is not None and source[0] in self.facts:
            seconds = [self.facts[source[0]][name] for name in source[1]]
            cycle = int(sum(float(value) for value in seconds) * 1e9) or None
        self._block.cadence.cycle = cycle

    def _watch(self, reading: Reading | None) -> None:
        """What the block says beside the sample."""
        if reading is None:
            return
        if self._block.powered_up:
            self._block.powered_up = False
            self._facts_due = True
        self._tell_live(reading)
        doubts = word_order_doubts(self._block.block, reading.words, self.device.word_order)
        if doubts and not self._doubt_told:
            self._doubt_told = True
            text = f"{'; '.join(doubts)}: is word_order {self.device.word_order} right?"
            self.outbox.event("warning", "word-order", text)

    def _tell_live(self, reading: Reading) -> None:
        """Alarms and temperature may move without a new sample: an event, once for each sample."""
        block, trigger = self._block.block, self._block.block.trigger
        if trigger is None:
            return
        frozen = {o for first, count in trigger.payload for o in range(first, first + count)}
        offsets = [o for o in range(block.count) if o not in frozen and o != trigger.flag]
        payload = tuple(reading.words[o] for o in sorted(frozen))
        live = tuple(reading.words[o] for o in offsets)
        (before_payload, before), self._live = self._live, (payload, live)
        if payload != before_payload:
            self._live_told.clear()
            return
        changed = {o for o, a, b in zip(offsets, before, live, strict=True) if a != b}
        for point in block.points:
            if changed & set(range(point.offset, point.offset + point.size)):
                self._tell_live_point(point.name, reading)

    def _tell_live_point(self, name: str, reading: Reading) -> None:
        if name in self._live_told:
            return
        self._live_told.add(name)
        values = dict(
            zip(field_names(self._block.block), self._maker.decode(reading).values, strict=True)
        )
        self.outbox.event("info", "live", f"{name} is {values[name]} without a new sample")

    def _tell_trouble(self, error: DeviceError) -> None:
        """A single failure is counted; the second in a row, or a lost link, is an event."""
        self._failures += 1
        if self._silent_since is None:
            self._silent_since = self._clock.now().monotonic
        if isinstance(error, LinkDown):
            self._facts_due = True
        elif self._failures < 2:
            return
        kind = type(error).__name__
        if kind != self._trouble:
            self._trouble = kind
            self.outbox.event("warning", "link", str(error))

    def _tell_recovery(self) -> None:
        if self._silent_since is None:
            return
        silent = self._clock.now().monotonic - self._silent_since
        if silent > _ABSENT:
            self._facts_due = True
        if self._trouble:
            self.outbox.event("info", "link", f"answers again after {silent / 1e9:.1f} s")
        self._silent_since = None
        self._failures = 0
        self._trouble = ""

    def _report_link(self, elapsed: int) -> None:
        if elapsed < _LINK_PERIOD:
            return
        now = self._clock.now()
        self.outbox.note(link_entry(self.device.name, self._link_since, now, self._tally))
        self._link_since = now
        self._tally.reset()


def _described(blocks: tuple[Block, ...]) -> list[dict[str, Any]]:
    """Enough of the map to read ``raw`` without roclog."""
    return [
        {
            "block": block.name,
            "table": block.table.value,
            "address": block.address,
            "count": block.count,
            "points": [
                {
                    "name": point.name,
                    "offset": point.offset,
                    "type": point.type.value,
                    "scale": None if point.scale is None else str(point.scale),
                    "unit": point.unit,
                }
                for point in block.points
            ],
        }
        for block in blocks
    ]

"""What a flagged block says beside its samples: live values, and signs of a wrong word order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roclog.register_map import FlagAndClear

if TYPE_CHECKING:
    from roclog.outbox import Outbox
    from roclog.samples import Reading, SampleMaker


class BlockWatch:
    """Looks at every read; an event for each live value that moves, once for each sample."""

    def __init__(self, maker: SampleMaker, outbox: Outbox) -> None:
        block, trigger = maker.block, maker.block.trigger
        if not isinstance(trigger, FlagAndClear):
            raise TypeError(f"block {block.name} has no flag")
        frozen = {o for first, count in trigger.payload for o in range(first, first + count)}
        self._payload = sorted(frozen)
        self._live = [o for o in range(block.count) if o not in frozen and o != trigger.flag]
        self._maker = maker
        self._outbox = outbox
        self._before: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
        self._told: set[str] = set()
        self._doubt_told = False

    def see(self, reading: Reading) -> None:
        """One read, sample or not."""
        doubts = () if self._doubt_told else self._maker.doubts(reading)
        if doubts:
            self._doubt_told = True
            text = f"{'; '.join(doubts)}: is word_order {self._maker.order} right?"
            self._outbox.event("warning", "word-order", text)
        payload = tuple(reading.words[o] for o in self._payload)
        live = tuple(reading.words[o] for o in self._live)
        (payload_before, live_before), self._before = self._before, (payload, live)
        if payload != payload_before:
            self._told.clear()
        elif live != live_before:
            pairs = zip(self._live, live_before, live, strict=True)
            self._tell({offset for offset, before, now in pairs if before != now}, reading)

    def _tell(self, changed: set[int], reading: Reading) -> None:
        """Alarms and temperature may move without a new sample."""
        values = self._maker.values(reading)
        for point in self._maker.block.points:
            size = self._maker.block.size_of(point)
            moved = changed & set(range(point.offset, point.offset + size))
            if moved and point.name not in self._told:
                self._told.add(point.name)
                value = values[point.name]
                shown = value.hex(" ") if isinstance(value, bytes) else value
                text = f"{point.name} is {shown} without a new sample"
                self._outbox.event("info", "live", text)

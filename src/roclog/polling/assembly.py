"""From a configured device to everything that polls it."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from roclog.bus.tally import Tally
from roclog.changes import ChangeMemory
from roclog.handshake import Memory, recover
from roclog.outbox import Outbox
from roclog.polling.clock_watch import ClockWatch
from roclog.polling.cyclic_block import CyclicBlock
from roclog.polling.cyclic_blocks import CyclicBlocks
from roclog.polling.device import PolledDevice
from roclog.polling.flagged_block import FlaggedBlock
from roclog.polling.identity import Succession, identity_topic
from roclog.polling.stamped_table import StampedTable, stamp_decoder
from roclog.register_map import FlagAndClear
from roclog.samples import SampleMaker
from roclog.stamped_messages import StampedMaker

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.clock import Clock
    from roclog.config.settings import Device
    from roclog.outbox import CommitGroup
    from roclog.polling.poller import Poller
    from roclog.recording.writer import Writer
    from roclog.register_map import Block, Table

_log = logging.getLogger("roclog")
Carried = Mapping[str, object]
State = TypeVar("State")


@dataclass(frozen=True, slots=True)
class _Shared:
    """What the pollers of one device have in common."""

    device: Device
    bus: Bus
    tally: Tally
    clock_watch: ClockWatch
    outboxes: dict[str, Outbox]


class Assembly:
    """Builds the devices of a session.

    carry: what earlier runs left for each topic.
    """

    def __init__(
        self, writer: Writer, group: CommitGroup, clock: Clock, carry: Mapping[str, Carried]
    ) -> None:
        self._writer = writer
        self._group = group
        self._clock = clock
        self._carry = carry

    def device(self, device: Device, bus: Bus, phase: int) -> PolledDevice:
        """A device with all its pollers; phase as of PolledDevice."""
        tally = Tally()
        outbox = Outbox(device.name, self._writer, self._clock, self._group)
        clock_watch = ClockWatch(device.name, outbox)
        shared = _Shared(device, bus, tally, clock_watch, {})
        topics = [f"/{device.name}/{name}" for name in _sample_names(device)]
        carried = {topic: self._carry[topic] for topic in topics if topic in self._carry}
        succession = Succession(
            device, topics, self._carry.get(identity_topic(device.name), {}), self._writer
        )
        return PolledDevice(
            device=device,
            bus=bus,
            tally=tally,
            make_pollers=partial(self._pollers, shared),
            carried=carried,
            answered_at=max((_instant(carry, "read_at") for carry in carried.values()), default=0),
            succession=succession,
            outbox=outbox,
            writer=self._writer,
            clock=self._clock,
            clock_watch=clock_watch,
            phase=phase,
        )

    def _pollers(self, shared: _Shared, carried: Mapping[str, Carried]) -> Sequence[Poller]:
        """carried: what earlier runs left of each topic. The flagged block, if any, is first."""
        flagged: list[Poller] = []
        cyclic: dict[int, list[Block]] = {}
        for block in shared.device.profile.samples:
            if isinstance(block.trigger, FlagAndClear):
                flagged.append(self._flagged(shared, block, carried))
            else:
                cyclic.setdefault(block.period or shared.device.poll, []).append(block)
        tables = shared.device.profile.stamped_tables
        return (
            *flagged,
            *(self._cyclic(shared, blocks, period, carried) for period, blocks in cyclic.items()),
            *(self._stamped(shared, table, carried) for table in tables),
        )

    def _outbox(self, shared: _Shared, name: str) -> Outbox:
        """Of one poller and its successors: what the disk did not take yet stays in line."""
        if name not in shared.outboxes:
            outbox = Outbox(shared.device.name, self._writer, self._clock, self._group)
            shared.outboxes[name] = outbox
        return shared.outboxes[name]

    def _flagged(
        self, shared: _Shared, block: Block, carried: Mapping[str, Carried]
    ) -> FlaggedBlock:
        device = shared.device
        epoch, memory, read_until = _resume(carried, device, block.name, _recover, Memory())
        maker = SampleMaker(device.name, device.profile.name, block, device.word_order, epoch)
        return FlaggedBlock(
            unit=device.unit,
            bus=shared.bus,
            tally=shared.tally,
            maker=maker,
            memory=memory,
            outbox=self._outbox(shared, block.name),
            clock=self._clock,
            acknowledge=device.acknowledge,
            period=block.period or device.poll,
            read_until=read_until,
            sampled_at=_instant(carried.get(maker.topic, {}), "sampled_at"),
        )

    def _cyclic(
        self,
        shared: _Shared,
        blocks: list[Block],
        period: int,
        carried: Mapping[str, Carried],
    ) -> CyclicBlocks:
        device = shared.device
        cycle = device.cycle if device.profile.flagged is None else None  # else it is that block's
        members = []
        for block in blocks:
            epoch, last, read_until = _resume(carried, device, block.name, _last_sample, (0, b""))
            maker = SampleMaker(device.name, device.profile.name, block, device.word_order, epoch)
            known = maker.known(*last)
            members.append(CyclicBlock(maker, period, known, read_until, last[1], cycle=cycle))
        return CyclicBlocks(
            unit=device.unit,
            bus=shared.bus,
            tally=shared.tally,
            blocks=members,
            period=period,
            outbox=self._outbox(shared, f"every {period}"),
            clock_watch=shared.clock_watch,
            dialect=device.profile.dialect,
        )

    def _stamped(
        self, shared: _Shared, table: Table, carried: Mapping[str, Carried]
    ) -> StampedTable:
        device = shared.device
        fresh = (0, ChangeMemory())
        epoch, (seq, memory), read_until = _resume(carried, device, table, _states, fresh)
        return StampedTable(
            unit=device.unit,
            bus=shared.bus,
            tally=shared.tally,
            lists=[inputs for inputs in device.profile.stamped if inputs.table is table],
            maker=StampedMaker(device.name, device.profile.name, table, epoch, seq),
            decoder=stamp_decoder(device.profile.stamp_rules),
            memory=memory,
            clock=shared.clock_watch,
            outbox=self._outbox(shared, table),
            period=device.poll,
            read_until=read_until,
        )


def _sample_names(device: Device) -> Iterator[str]:
    yield from (block.name for block in device.profile.samples)
    yield from device.profile.stamped_tables


def _resume(
    carried: Mapping[str, Carried],
    device: Device,
    name: str,
    read: Callable[[Carried], State],
    fresh: State,
) -> tuple[bytes, State, int]:
    """Epoch, state and last read of a channel; a new epoch where nothing usable is left."""
    topic = f"/{device.name}/{name}"
    carry = carried.get(topic)
    if carry is None:
        return uuid.uuid4().bytes, fresh, 0
    try:
        return uuid.UUID(hex=str(carry["epoch"])).bytes, read(carry), int(str(carry["read_at"]))
    except (KeyError, ValueError) as error:
        _log.warning(
            "%s: what is left of the last run is no use (%r), a new epoch begins", topic, error
        )
        return uuid.uuid4().bytes, fresh, 0


def _instant(carry: Carried, name: str) -> int:
    """UTC ns, 0 = not known."""
    found = carry.get(name)
    return found if isinstance(found, int) else 0


def _states(carry: Carried) -> tuple[int, ChangeMemory]:
    return int(str(carry["seq"])), ChangeMemory(str(carry["states"]))


def _last_sample(carry: Carried) -> tuple[int, bytes]:
    """Its number and, where a trigger compares with it, its octets."""
    return int(str(carry["seq"])), bytes.fromhex(str(carry.get("raw", "")))


def _recover(carry: Carried) -> Memory:
    payload = carry["payload"]
    return recover(
        int(str(carry["seq"])),
        None if payload is None else bytes.fromhex(str(payload)),
        cleared=bool(carry["cleared"]),
    )

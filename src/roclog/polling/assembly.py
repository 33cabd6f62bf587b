"""From a configured device to everything that polls it."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeVar

from roclog.bus.tally import Tally
from roclog.handshake import Memory, recover
from roclog.outbox import Outbox
from roclog.polling.cyclic_blocks import CyclicBlock, CyclicBlocks
from roclog.polling.device import PolledDevice
from roclog.polling.flagged_block import FlaggedBlock
from roclog.register_map import FlagAndClear
from roclog.samples import SampleMaker

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.clock import Clock
    from roclog.config.settings import Device
    from roclog.outbox import CommitGroup
    from roclog.polling.poller import Poller
    from roclog.recording.writer import Writer
    from roclog.register_map import Block

_log = logging.getLogger("roclog")
Carried = Mapping[str, object]
State = TypeVar("State")


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
        flagged: FlaggedBlock | None = None
        cyclic: dict[int, list[Block]] = {}
        for block in device.profile.samples:
            if isinstance(block.trigger, FlagAndClear):
                flagged = self._flagged(device, block, bus, tally)
            else:
                cyclic.setdefault(block.period or device.poll, []).append(block)
        pollers: list[Poller] = [] if flagged is None else [flagged]
        for period, blocks in cyclic.items():
            pollers.append(self._cyclic(device, blocks, period, bus, tally))
        return PolledDevice(
            device=device,
            bus=bus,
            tally=tally,
            pollers=pollers,
            flagged=flagged,
            outbox=self._outbox(device),
            writer=self._writer,
            clock=self._clock,
            phase=phase,
        )

    def _outbox(self, device: Device) -> Outbox:
        return Outbox(device.name, self._writer, self._clock, self._group)

    def _flagged(self, device: Device, block: Block, bus: Bus, tally: Tally) -> FlaggedBlock:
        epoch, memory, read_until = self._resume(device, block, _recover, Memory())
        maker = SampleMaker(device.name, device.profile.name, block, device.word_order, epoch)
        return FlaggedBlock(
            unit=device.unit,
            bus=bus,
            tally=tally,
            maker=maker,
            memory=memory,
            outbox=self._outbox(device),
            clock=self._clock,
            acknowledge=device.acknowledge,
            period=block.period or device.poll,
            read_until=read_until,
        )

    def _cyclic(
        self, device: Device, blocks: list[Block], period: int, bus: Bus, tally: Tally
    ) -> CyclicBlocks:
        members = []
        for block in blocks:
            epoch, last, read_until = self._resume(device, block, _last_sample, (0, b""))
            maker = SampleMaker(device.name, device.profile.name, block, device.word_order, epoch)
            members.append(CyclicBlock(maker, period, maker.known(*last), read_until))
        return CyclicBlocks(
            unit=device.unit,
            bus=bus,
            tally=tally,
            blocks=members,
            period=period,
            outbox=self._outbox(device),
        )

    def _resume(
        self, device: Device, block: Block, read: Callable[[Carried], State], fresh: State
    ) -> tuple[bytes, State, int]:
        """Epoch, state and last read of a block; a new epoch where nothing usable is left."""
        topic = f"/{device.name}/{block.name}"
        carry = self._carry.get(topic)
        if carry is None:
            return uuid.uuid4().bytes, fresh, 0
        try:
            return uuid.UUID(hex=str(carry["epoch"])).bytes, read(carry), int(str(carry["read_at"]))
        except (KeyError, ValueError) as error:
            _log.warning(
                "%s: what is left of the last run is no use (%r), a new epoch begins", topic, error
            )
            return uuid.uuid4().bytes, fresh, 0


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

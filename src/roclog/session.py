"""A recording session: everything built from the settings, started, and ended in order."""

from __future__ import annotations

import asyncio
import logging
import uuid
from contextlib import AsyncExitStack
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from roclog.connect import make_bus
from roclog.outbox import CommitGroup
from roclog.polling.assembly import Assembly
from roclog.recording.directory import Directory, Inheritance
from roclog.recording.entries import LOG_CHANNEL, block_channel, log_entry, plain_channel
from roclog.recording.retention import Retention
from roclog.recording.sealer import Sealer
from roclog.recording.writer import Limits, Writer
from roclog.register_map import FlagAndClear
from roclog.samples import SampleMaker
from roclog.schema import CLEAR, CLOCK_OFFSET, GAP, LINK, stamped_type

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.link import Link
    from roclog.clock import Clock
    from roclog.config.settings import Settings
    from roclog.polling.device import PolledDevice
    from roclog.recording.entries import ChannelInfo

_log = logging.getLogger("roclog")
_CLOCK_STEP: Final = 500_000_000
_CLOCK_WATCH_SECONDS: Final = 1.0
_SPREAD: Final = 10**9
_SLOT: Final = 25_000_000
"""Nanoseconds over which the first polls of the devices are spread, and between them: devices of
one slot wake the process once, not one after the other."""


def channels(settings: Settings) -> list[ChannelInfo]:
    """Every channel of a recording with these settings."""
    found = [LOG_CHANNEL]
    for device in settings.devices.values():
        profile = device.profile.name
        for block in device.profile.samples:
            maker = SampleMaker(device.name, profile, block, device.word_order, b"")
            found.append(block_channel(device.name, profile, block, maker.kind))
            if isinstance(block.trigger, FlagAndClear):
                found.append(plain_channel(device.name, "clear", CLEAR, clears=maker.topic))
        for table in device.profile.stamped_tables:
            kind = stamped_type(profile, table, 7)
            found.append(plain_channel(device.name, table, kind, profile=profile, states="1"))
        found.append(plain_channel(device.name, "gap", GAP))
        found.append(plain_channel(device.name, "clock_offset", CLOCK_OFFSET))
        found.append(plain_channel(device.name, "link", LINK))
    return found


class Session:
    """One run. ``async with Session(settings, clock) as session: await session.run()``.

    Entering opens the directory, seals what a crash left and opens the first segment.

    Raises:
        StorageError: on entering, when the directory cannot be used.
    """

    def __init__(self, settings: Settings, clock: Clock) -> None:
        self.settings = settings
        self.devices: list[PolledDevice] = []
        self._clock = clock
        self._run = uuid.uuid4().hex
        self._buses: dict[str, Bus] = {}
        self._links: dict[str, dict[str, str]] = {}
        self._stop = asyncio.Event()

    async def __aenter__(self) -> Self:
        recording = self.settings.recording
        async with AsyncExitStack() as stack:
            self._directory = Directory(recording.directory)
            stack.callback(self._directory.release)
            leftover = self._directory.hot_segments()
            self._inheritance = self._directory.inherit()
            keep = Retention(self._clock, recording.keep_age, recording.keep_size)
            limited = recording.keep_age is not None or recording.keep_size is not None
            self._sealer = Sealer(recording.directory, keep if limited else None, self._tell)
            stack.push_async_callback(asyncio.to_thread, self._sealer.close)
            for path in leftover:
                self._sealer.seal(path)
            self._writer = self._open_writer(self._inheritance)
            stack.push_async_callback(asyncio.to_thread, self._writer.close)
            self._group = CommitGroup(self._writer)
            self._build()
            for bus in self._buses.values():
                stack.callback(bus.close)
            stack.push_async_callback(self._finish_devices)
            self._opened = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """Every message is on disk, the segment sealed and the directory free on return.

        Raises:
            StorageError: not everything could be written.
        """
        await self._opened.aclose()

    async def _finish_devices(self) -> None:
        await self._group.finish()  # how far a device was read is said when that is on disk
        for device in self.devices:
            try:
                device.close()
            except Exception:  # noqa: BLE001 - one device's fault keeps no other from closing
                _log.exception("%s: while closing", device.device.name)
            for poller in device.pollers:
                poller.outbox.flush_soon()
        await self._group.finish()
        for device in self.devices:
            for poller in device.pollers:
                await poller.outbox.flush()

    async def run(self) -> None:
        """Record until ``stop``. One task a device; one that breaks is told and restarted."""
        watch = asyncio.create_task(self._watch_clock())
        try:
            async with asyncio.TaskGroup() as group:
                for device in self.devices:
                    group.create_task(self._supervise(device))
        finally:
            watch.cancel()

    def stop(self) -> None:
        """Let every device finish the poll in hand; then ``run`` returns."""
        self._stop.set()
        for device in self.devices:
            device.stop()

    async def writer_answers(self) -> None:
        """Return once the writer has taken everything handed to it before."""
        await asyncio.wrap_future(self._writer.note([]))

    async def _supervise(self, device: PolledDevice) -> None:
        while not self._stop.is_set():
            try:
                await device.run()
            except Exception as error:  # noqa: BLE001 - months unattended: one fault ends no device
                _log.exception("%s: unexpected error", device.device.name)
                device.outbox.event("error", "internal", f"unexpected {error!r}, going on")
                await asyncio.sleep(max(1.0, device.device.poll / 1e9))

    async def _watch_clock(self) -> None:
        """Steps of the wall clock are recorded; the schedule runs on the monotonic clock."""
        now = self._clock.now()
        offset = now.utc - now.monotonic
        while True:
            await asyncio.sleep(_CLOCK_WATCH_SECONDS)
            now = self._clock.now()
            step = now.utc - now.monotonic - offset
            if abs(step) > _CLOCK_STEP:
                offset += step
                self._tell("warning", f"the wall clock was stepped by {step / 1e9:+.3f} s", "clock")

    def _tell(self, level: str, text: str, kind: str = "recording") -> None:
        _log.log(getattr(logging, level.upper()), "%s: %s", kind, text)
        if hasattr(self, "_writer"):
            self._writer.note([log_entry(self._clock.now().utc, level, kind, text)])

    def _describe_link(self, name: str, link: Link) -> None:
        """What is known of an adapter, each time that another one was opened."""
        facts = dict(link.describe())
        if not facts or facts == self._links.get(name):
            return
        self._links[name] = facts
        self._writer.describe(f"roclog.connection.{name}", facts)
        warning = facts.pop("warning", "")
        text = ", ".join(f"{key} {value}" for key, value in facts.items())
        self._tell("info", f"{link.name}: {text}", f"{name}.port")
        if warning:
            self._tell("warning", f"{link.name}: {warning}", f"{name}.port")

    def _open_writer(self, inheritance: Inheritance) -> Writer:
        recording = self.settings.recording
        limits = Limits(recording.segment_duration, recording.segment_size)
        return Writer(
            directory=self._directory,
            inheritance=inheritance,
            channels=channels(self.settings),
            limits=limits,
            clock=self._clock,
            segment_facts=self._segment_facts,
            sealer=self._sealer,
        )

    def _segment_facts(self, number: int) -> dict[str, str]:
        now = self._clock.now()
        return {
            "number": str(number),
            "logger": self._inheritance.logger,
            "run": self._run,
            "boot_id": _boot_id(),
            "version": version("roclog"),
            "opened_at": str(now.utc),
            "opened_at_monotonic": str(now.monotonic),
        }

    def _build(self) -> None:
        devices = list(self.settings.devices.values())
        for name, connection in self.settings.connections.items():
            users = [device for device in devices if device.connection == name]
            bus = self._buses[name] = make_bus(connection, users, self._clock)
            bus.on_open = partial(self._describe_link, name, bus.link)
        assembly = Assembly(self._writer, self._group, self._clock, self._inheritance.carry)
        for index, device in enumerate(devices):
            phase = min(device.poll, _SPREAD) * index // len(devices) // _SLOT * _SLOT
            bus = self._buses[device.connection]
            self.devices.append(assembly.device(device, bus, phase))


def _boot_id() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return "unknown"

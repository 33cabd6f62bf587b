"""A device of any registers to test a logger with: its memory on a schedule, faults on demand."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from registers_model import Group, Model
from registers_options import Options, parse_options
from roc_links import Exchange, Faults, PtySide, Shared, TcpLink, TcpSide
from served import Served
from wire import MbapFramer, StreamError

if TYPE_CHECKING:
    from collections.abc import Callable


class UdpSide(asyncio.DatagramProtocol):
    """One datagram is one frame; each sender has an exchange of its own."""

    def __init__(self, shared: Shared, where: str) -> None:
        self._shared = shared
        self._host, _, self._port = where.rpartition(":")
        self._transport: asyncio.DatagramTransport | None = None
        self._exchanges: dict[tuple[str, int], Exchange] = {}

    async def open(self) -> str:
        loop = asyncio.get_running_loop()
        where = self._host, int(self._port)
        transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=where)
        return str(transport.get_extra_info("sockname")[1])

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        try:
            requests = MbapFramer().feed(data)
        except StreamError as error:
            self._shared.truth.log("noise", octets=str(error))
            return
        for request in requests:
            if addr not in self._exchanges:
                self._exchanges[addr] = Exchange(
                    self._shared, lambda octets: self._send(octets, addr), TcpLink._wrap
                )
            self._exchanges[addr].arrive(request)

    def _send(self, octets: bytes, to: tuple[str, int]) -> None:
        if self._transport is not None:
            self._transport.sendto(octets, to)

    def power_fails(self) -> None:
        for exchange in self._exchanges.values():
            exchange.close()

    def close(self) -> None:
        self.power_fails()
        if self._transport is not None:
            self._transport.abort()


class Schedule:
    """Sample n of a group is complete n * `every` seconds after the first request."""

    def __init__(self, shared: Shared, side: TcpSide | PtySide | UdpSide, options: Options) -> None:
        self._shared = shared
        self._side = side
        self._dark = options.dark
        self._model: Model = cast("Any", shared.model)
        self._model.on_request = self._begin
        self._loop = asyncio.get_running_loop()
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._began = False

    def _begin(self) -> None:
        if not self._began:
            self._began = True
            self._restart()

    def _restart(self) -> None:
        now = self._loop.time()
        for group in self._model.groups:
            if group.about.get("every"):
                self._plan(group, now)

    def _plan(self, group: Group, start: float) -> None:
        if group.k >= group.about.get("samples", 10**6):
            return
        due = start + (group.n + 1) * group.about["every"]
        self._timers[group.name] = self._loop.call_at(due, self._complete, group, start)

    def _complete(self, group: Group, start: float) -> None:
        self._model.complete(group)
        self._plan(group, start)
        if group.k == group.about.get("restart_after"):
            self._loop.call_later(group.about["every"] / 2, self._power_off)

    def _power_off(self) -> None:
        for timer in self._timers.values():
            timer.cancel()
        self._shared.mute = self._shared.off = True
        self._side.power_fails()
        self._shared.truth.log("power", on=False)
        self._loop.call_later(self._dark, self._power_on)

    def _power_on(self) -> None:
        self._shared.mute = self._shared.off = False
        self._shared.truth.log("power", on=True)
        self._model.power_up()
        self._restart()


class RegistersDevice(Served):
    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self.model = Model(options, self.truth)
        self._schedule: Callable[[], Schedule] | None = None

    def faults(self) -> Faults:
        options: Any = self.options  # some of those of a ROC
        return Faults(options)

    def side(self, shared: Shared) -> TcpSide | PtySide | UdpSide:
        options = self.options
        side = UdpSide(shared, options.udp) if options.udp else super().side(shared)
        self._schedule = partial(Schedule, shared, side, options)
        return side

    def begin(self) -> None:
        assert self._schedule is not None
        self._schedule()


if __name__ == "__main__":
    RegistersDevice(parse_options()).process()

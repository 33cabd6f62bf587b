"""An ADDI-DATA MSX-E3317 to test a logger with: its functions on TCP and UDP, faults on demand."""

from __future__ import annotations

import asyncio
import signal
import threading
from concurrent.futures import Future
from dataclasses import asdict
from typing import TYPE_CHECKING, Self, cast

from msx_frames import Frame, Framer, count_size, counted_answer, frame_octets, parse
from msx_model import Model, described
from msx_options import Options, parse_options
from roc_options import rng
from roc_truth import Truth
from wire import PduError, StreamError

if TYPE_CHECKING:
    from collections.abc import Callable

    from msx_model import Outcome

    Send = Callable[[bytes], None]

_UNITS = (0, 1)


class Server:
    """Frames in, frames out, over whichever way they come. Every event is in the truth log.

    `call`: a request that reached the device, with its number; it was carried out once for each.
    `answer`: what was sent for it, `fate` and what it told.
    """

    def __init__(self, options: Options, truth: Truth, model: Model) -> None:
        self._options = options
        self._truth = truth
        self._model = model
        self._random = rng(options.seed, "faults")
        self._held: tuple[asyncio.TimerHandle, Send, bytes] | None = None
        self._calls = 0

    def framer(self) -> Framer:
        return Framer(self._options.order)

    def noise(self, octets: str) -> None:
        self._truth.log("noise", octets=octets)

    def take(self, frame: Frame, send: Send) -> None:
        options = self._options
        if frame.unit not in _UNITS:
            self._truth.log("ignored", why="unit", unit=frame.unit, pdu=frame.pdu.hex())
            return
        shares = options.shares
        weights = [*shares.values(), max(0.0, 1 - sum(shares.values()))]
        fate = self._random.choices([*shares, "ok"], weights)[0]
        if fate == "drop_request":
            self._truth.log("ignored", why="dropped", unit=frame.unit, pdu=frame.pdu.hex())
            return
        self._calls += 1
        try:
            call = parse(frame.pdu, options.order)
        except PduError as error:
            outcome = self._model.execute(frame.pdu[0], error)
            facts: dict[str, object] = {"pdu": frame.pdu.hex()}
        else:
            outcome = self._model.execute(frame.pdu[0], call)
            facts = described(call)
        origin: dict[str, object] = {"call": self._calls, "transaction": frame.number}
        self._truth.log("call", unit=frame.unit, **origin, **facts)
        loop = asyncio.get_running_loop()
        loop.call_later(options.answer_after, self._answer, frame, outcome, fate, origin, send)

    def _answer(
        self, frame: Frame, outcome: Outcome, fate: str, origin: dict[str, object], send: Send
    ) -> None:
        octets = self._octets(frame, outcome, fate)
        self._truth.log("answer", fate=fate, pdu=outcome.pdu.hex(), **origin, **outcome.facts)
        if fate == "drop":
            return
        if fate == "reorder" and self._held is None:
            timer = asyncio.get_running_loop().call_later(self._options.held_for, self._release)
            self._held = timer, send, octets
            return
        for _ in range(2 if fate == "duplicate" else 1):
            send(octets)
        self._release()

    def _release(self) -> None:
        if self._held is not None:
            timer, send, octets = self._held
            timer.cancel()
            self._held = None
            send(octets)

    def _octets(self, frame: Frame, outcome: Outcome, fate: str) -> bytes:
        pdu, unit, order = outcome.pdu, frame.unit, self._options.order
        call, payload = outcome.call, outcome.payload
        if payload is not None and call is not None and call.register is not None:
            size = count_size(call.register)
            if fate == "short":
                pdu = counted_answer(frame.pdu[0], size, payload[: len(payload) // 4 * 2], order)
            elif fate == "other_count":
                pdu = counted_answer(frame.pdu[0], 3 - size, payload, order)
        if fate == "other_unit":
            unit = 1 - unit
        return frame_octets(Frame(frame.number, unit, pdu), order)


class TcpLink(asyncio.Protocol):
    def __init__(self, server: Server, links: set[TcpLink]) -> None:
        self._server = server
        self._links = links
        self._framer = server.framer()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._links.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._links.discard(self)

    def data_received(self, data: bytes) -> None:
        try:
            for frame in self._framer.feed(data):
                self._server.take(frame, self._send)
        except StreamError as error:
            self._server.noise(str(error))
            self.close()

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def _send(self, octets: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(octets)


class UdpSide(asyncio.DatagramProtocol):
    def __init__(self, server: Server) -> None:
        self._server = server
        self._framer = server.framer()
        self.transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        try:
            frame = self._framer.datagram(data)
        except StreamError as error:
            self._server.noise(str(error))
            return
        self._server.take(frame, lambda octets: self._send(octets, addr))

    def _send(self, octets: bytes, to: tuple[str, int]) -> None:
        if self.transport is not None and not self.transport.is_closing():
            self.transport.sendto(octets, to)


class MsxDevice:
    """Runs either in the caller's event loop (`serve`) or in a thread (`start`, `stop`).

    ports: where it listens, by "tcp" and "udp".
    """

    def __init__(self, options: Options) -> None:
        self.options = options
        self.truth = Truth(options.truth)
        self.model = Model(options)
        self.ports: dict[str, int] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended: asyncio.Event | None = None
        self._thread: threading.Thread | None = None

    async def serve(self, ready: Callable[[dict[str, int]], None]) -> None:
        """`ready` is told the ports; returns when the device has ended."""
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        server = Server(self.options, self.truth, self.model)
        links: set[TcpLink] = set()
        listener, datagrams = None, UdpSide(server)
        if self.options.tcp:
            host, _, port = self.options.tcp.rpartition(":")
            listener = await self._loop.create_server(
                lambda: TcpLink(server, links), host, int(port)
            )
            self.ports["tcp"] = listener.sockets[0].getsockname()[1]
        if self.options.udp:
            host, _, port = self.options.udp.rpartition(":")
            transport, _ = await self._loop.create_datagram_endpoint(
                lambda: datagrams, local_addr=(host, int(port))
            )
            self.ports["udp"] = transport.get_extra_info("sockname")[1]
        self.truth.log("start", options=asdict(self.options), ports=self.ports)
        ready(self.ports)
        try:
            await self._ended.wait()
        finally:
            if listener is not None:
                listener.close()
            for link in list(links):
                link.close()
            if datagrams.transport is not None:
                datagrams.transport.abort()
            await asyncio.sleep(0)  # lets the connections notice
            self.truth.close()

    def calls(self) -> list[dict[str, object]]:
        """What was carried out, in order; only without a truth file."""
        return [line for line in self.truth.lines if line["event"] == "call"]

    def end(self) -> None:
        """From any thread, or from a signal handler of the loop."""
        if self._loop is not None and self._ended is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._ended.set)

    def start(self) -> dict[str, int]:
        ready: Future[dict[str, int]] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), daemon=True)
        self._thread.start()
        return ready.result()

    def stop(self) -> None:
        self.end()
        if self._thread is not None:
            self._thread.join()

    def _run(self, ready: Future[dict[str, int]]) -> None:
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
    device = MsxDevice(options)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, device.end)
    await device.serve(lambda ports: print(f"listening {ports}", flush=True))


def main() -> None:
    asyncio.run(_process(parse_options()))


if __name__ == "__main__":
    main()

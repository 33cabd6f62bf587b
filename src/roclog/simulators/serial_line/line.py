"""The line in real time: two terminals and a thread that carries octets between them."""

from __future__ import annotations

import os
import select
import threading
import time
from typing import TYPE_CHECKING, Self

from roclog.simulators.serial_line.terminal import Terminal
from roclog.simulators.serial_line.wire import NS_PER_S, LineSettings, Side, Wire

if TYPE_CHECKING:
    from types import TracebackType

    from roclog.simulators.serial_line.statistics import Statistics


class SerialLine:
    """A line from now until `close`, or inside `with`.

    Its thread waits for descriptors and absolute deadlines only; no event loop takes part in its
    timing. Each side may close its terminal and open it again.

    Args:
        client_link: Where to put a link to the client's terminal.
        server_link: The same for the server.
        settings: The line; without them octets take no time.

    Attributes:
        client_port: Name of the client's terminal.
        server_port: Name of the server's terminal.

    Raises:
        OSError: A link is in the way that is not one to a pseudo-terminal, or no pseudo-terminal
            is left.
    """

    def __init__(
        self,
        client_link: str | os.PathLike[str] | None = None,
        server_link: str | os.PathLike[str] | None = None,
        *,
        settings: LineSettings | None = None,
    ) -> None:
        client = Terminal(client_link)
        try:
            server = Terminal(server_link)
        except OSError:
            client.close()
            raise
        self.client_port = client.name
        self.server_port = server.name
        self._terminals = {Side.CLIENT: client, Side.SERVER: server}
        self._stop, self._stopper = os.pipe()
        self._wire = Wire(settings or LineSettings(), time.monotonic_ns())
        self._final: Statistics | None = None
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="roclog serial line", daemon=True)
        self._thread.start()

    def statistics(self) -> Statistics:
        """What the line has seen until now, or until it was closed."""
        if self._final is not None:
            return self._final
        with self._lock:
            return self._wire.statistics(time.monotonic_ns())

    def close(self) -> None:
        """Take the line down and remove the links; harmless when closed."""
        if self._final is not None:
            return
        os.write(self._stopper, b"\0")
        self._thread.join()
        self._final = self._wire.statistics(time.monotonic_ns())
        for terminal in self._terminals.values():
            terminal.close()
        os.close(self._stop)
        os.close(self._stopper)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _run(self) -> None:
        while True:
            readable = [self._stop]
            with self._lock:
                now = time.monotonic_ns()
                for side, terminal in self._terminals.items():
                    if octets := self._wire.receive(side, now):
                        self._wire.drop(len(octets) - terminal.write(octets))
                    if self._wire.has_room(side, now):
                        readable.append(terminal.descriptor)
                due = self._wire.next_due()
            wait_s = None if due is None else max(0, due - time.monotonic_ns()) / NS_PER_S
            ready, _, _ = select.select(readable, [], [], wait_s)
            if self._stop in ready:
                return
            with self._lock:
                for side, terminal in self._terminals.items():
                    if terminal.descriptor in ready:
                        self._wire.send(side, terminal.read(), time.monotonic_ns())

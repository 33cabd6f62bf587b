"""The scripts on which other handshakes lose a sample, played against the real recorder."""

from __future__ import annotations

import signal
import socket
import struct
import threading
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import pytest
from bench.process import until
from bench.recorder import Recorder
from bench.recording import csv_rows

if TYPE_CHECKING:
    from collections.abc import Callable

FIRST, COUNT = 300, 27
CYCLE = 3.0
"""Seconds, for the recorder's guard; the scripts complete samples when they want."""


def scripts() -> dict[str, list[Any]]:
    path = Path(__file__).parents[1] / "test_handshake_model.py"
    spec = spec_from_file_location("handshake_model", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    import sys  # noqa: PLC0415 - dataclasses look their module up by name

    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    found: dict[str, list[Any]] = module.counterexamples()
    return found


SCRIPTS = scripts()


class ScriptedDevice:
    """A device over TCP, a thread for each connection. What happens to a clear is scripted.

    on_clear: called when a clear has arrived and has not yet taken effect; returns what becomes of
    it: ``done``, ``request lost`` or ``answer lost``.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._closed = False
        self.port = self._server.getsockname()[1]
        self.block = [0] * COUNT
        self.served: list[tuple[int, ...]] = []
        self.clears = 0
        self.on_clear: Callable[[], str] = lambda: "done"
        threading.Thread(target=self._accept, daemon=True).start()

    def complete(self, words: tuple[int, ...]) -> None:
        """A sample whose second and third counts are the words of the script."""
        with self._lock:
            counts = [99_999, *words, 0][:4]
            self.block[5] = 10
            for index, value in enumerate(counts):
                self.block[8 + 2 * index : 10 + 2 * index] = divmod(value, 0x10000)
            self.block[0] = 1
            self.served.clear()

    def read_since_complete(self) -> int:
        with self._lock:
            return len(self.served)

    def _accept(self) -> None:
        while not self._closed:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection:
            try:
                while head := connection.recv(7, socket.MSG_WAITALL):
                    transaction, _, length, unit = struct.unpack(">HHHB", head)
                    pdu = connection.recv(length - 1, socket.MSG_WAITALL)
                    answer = self._answer(pdu)
                    if answer:
                        head = struct.pack(">HHHB", transaction, 0, len(answer) + 1, unit)
                        connection.sendall(head + answer)
            except (OSError, struct.error):
                return

    def _answer(self, pdu: bytes) -> bytes:
        function, address, value = struct.unpack(">BHH", pdu[:5])
        if function == 6:
            how = self.on_clear()
            with self._lock:
                self.clears += 1
                if how != "request lost":
                    self.block[0] = value
            return pdu if how == "done" else b""
        with self._lock:
            inside = address >= FIRST and address + value <= FIRST + COUNT
            if not inside:
                return bytes([function | 0x80, 2])
            self.served.append(tuple(self.block))
            words = self.block[address - FIRST :][:value]
        return struct.pack(f">BB{value}H", function, 2 * value, *words)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed = True
        self._server.close()


def split(script: list[Any]) -> tuple[list[tuple[int, ...]], str, bool]:
    """Samples in order, what becomes of the first clear, and whether the logger then crashes."""
    samples = [event.words for event in script if event.act.name == "COMPLETE"]
    clears = [event.how for event in script if event.act.name == "CLEAR"]
    how = "request lost" if "request lost" in clears[0] else "done"
    return samples, how, any(event.act.name == "CRASH" for event in script)


@pytest.mark.parametrize("name", SCRIPTS)
def test_nothing_is_lost(tmp_path: Path, name: str) -> None:
    """The second sample completes between the last read and the effect of the clear.

    Where it is the same as the first, nobody could tell it from the first one inside that window;
    the device then keeps its cycle, as the guard assumes, while the clear is lost and repeated.
    """
    samples, how, crash = split(SCRIPTS[name])
    same = len(samples) > 1 and samples[0] == samples[1]
    with ScriptedDevice() as device:
        recorder = Recorder(
            tmp_path,
            '[connections.line]\ntransport = "tcp"\nhost = "127.0.0.1"\n'
            f'port = {device.port}\ntimeout = "300ms"\n'
            '[devices.roc1]\nprofile = "hiac-roc"\nconnection = "line"\nunit = 1\n'
            f'poll = "100ms"\ncycle = "{CYCLE}s"\n',
        )
        killed = threading.Event()
        with recorder.start() as child:

            def on_clear() -> str:
                if device.clears:
                    return "done"
                if len(samples) > 1 and not same:
                    device.complete(samples[1])
                if crash:
                    device.block[0] = 0
                    child.send(signal.SIGKILL)
                    killed.set()
                return how

            device.on_clear = on_clear
            child.while_it_runs(device.read_since_complete, "the first read")
            device.complete(samples[0])
            since = time.monotonic()
            if crash:
                until(killed.is_set, "the crash")
                child.wait()
            else:
                goal = 1 if how == "done" else 2
                child.while_it_runs(lambda: device.clears >= goal, "the clear")
                if same:
                    until(lambda: time.monotonic() > since + CYCLE, "the end of the cycle")
                    device.complete(samples[1])
                    child.while_it_runs(lambda: device.clears > goal, "one more clear")
                reads_on(device)
                assert child.stop() == 0
        if crash:
            device.served.clear()
            with recorder.start() as again:
                again.while_it_runs(lambda: device.read_since_complete() >= 3, "reads")
                assert again.stop() == 0
    rows = csv_rows(recorder.directory, tmp_path / "csv")
    kept = [tuple(round(100 * float(row[f"count_{n}"])) for n in (2, 3)) for row in rows]
    assert kept == samples


def reads_on(device: ScriptedDevice) -> None:
    """Time for what follows a clear: three more reads."""
    device.served.clear()
    limit = time.monotonic() + 5
    until(lambda: device.read_since_complete() >= 3 or time.monotonic() > limit, "reads")

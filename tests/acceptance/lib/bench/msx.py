"""An MSX-E3317 as a process of its own, and its truth beside what was recorded of it."""

from __future__ import annotations

import sys
from ast import literal_eval
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from bench.process import Child
from bench.recording import items, nanoseconds, number, read_csv
from bench.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bench.recording import Item
    from bench.truth import Line

_PEER: Final = Path(__file__).parents[3] / "peers/msx.py"
_PLACES: Final = range(16)

STATUS, TYPE, CLOCK, CALIBRATION = 10000, 10200, 10500, 21150
FUNCTIONS: Final = {
    "clock": CLOCK,
    "calibration_status": CALIBRATION,
    "pressure_channels": 21000,
    "acquisition_channels": 15000,
    "channels_info": 15050,
}
"""Channels of a recording, and the register of each."""
LATE_FATES: Final = frozenset({"reorder", "duplicate", "ok"})
"""Fates of an answer that reaches the client whole and right, in time or not."""


class Msx:
    """The device ``msx1``. Options are those of tests/peers/msx.py, by their Python names."""

    def __init__(
        self, folder: Path, transport: str = "tcp", order: str = "big", **options: Any
    ) -> None:
        self._log = folder / "msx1.truth.jsonl"
        self._order = order
        self._transport = transport
        command = [sys.executable, str(_PEER), f"--{transport}", "127.0.0.1:0"]
        command += ["--order", order, "--truth", str(self._log)]
        for name, value in options.items():
            command += ["--" + name.replace("_", "-"), str(value)]
        self.child = Child(command, folder / "msx1.peer")
        try:
            self.child.while_it_runs(lambda: self.child.said().endswith("\n"), "it to listen")
        except BaseException:
            self.child.kill()
            raise
        ports = literal_eval(self.child.said().partition(" ")[2])
        self.port = int(ports[transport])

    @property
    def truth(self) -> Truth:
        return Truth(self._log)

    def calls(self, register: int) -> int:
        return sum(line.get("register") == register for line in self.truth.of("call"))

    def end(self) -> Truth:
        self.child.stop()
        return self.truth

    def toml(self, connection: str = "", device: str = "") -> str:
        return (
            f'[connections.lab]\ntransport = "{self._transport}"\nhost = "127.0.0.1"\n'
            f"port = {self.port}\n{connection}\n"
            f'[devices.msx1]\nprofile = "msx-e3317"\nconnection = "lab"\n'
            f'byte_order = "{self._order}"\n{device}\n'
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()


class Judge:
    """wrong: rows that are not what the module told in answer to the request of that very row.

    found: the numbers of the calls whose answers were recorded, by channel.
    """

    def __init__(self, directory: Path, out: Path, truth: Truth) -> None:
        self.wrong: list[str] = []
        self.found: dict[str, list[int]] = {}
        answers = {line["call"]: line for line in truth.of("answer")}
        for name, register in FUNCTIONS.items():
            calls = [line for line in truth.of("call") if line.get("register") == register]
            table = out / f"msx1.{name}.csv"
            rows = read_csv(table) if table.exists() else []
            messages = items(directory, f"/msx1/{name}")
            if len(rows) != len(messages):
                self.wrong.append(f"{name}: {len(rows)} rows of {len(messages)} messages")
            self.found[name] = []
            for row, message in zip(rows, messages, strict=False):
                within = [line for line in calls if _is_within(line, message)]
                if len(within) != 1:
                    self.wrong.append(f"{name}: {len(within)} calls belong to {row}")
                    continue
                answer = answers[within[0]["call"]]
                self.found[name].append(answer["call"])
                told = dict(_told(name, answer))
                if answer["fate"] not in LATE_FATES or told != {n: number(row[n]) for n in told}:
                    self.wrong.append(f"{name}: {row} is not {answer}")
                if name == "clock":
                    time = 10**9 * answer["seconds"] + 1000 * answer["microseconds"]
                    if nanoseconds(row["device_time"]) != time:
                        self.wrong.append(f"{name}: device time of {row} is not {answer}")

    def delivered(self, name: str, truth: Truth) -> list[int]:
        """Numbers of the calls of this channel that were answered as they should be."""
        calls = [c["call"] for c in truth.of("call") if c.get("register") == FUNCTIONS[name]]
        fine = {line["call"] for line in truth.of("answer") if line["fate"] == "ok"}
        return [call for call in calls if call in fine]


def _is_within(call: Line, message: Item) -> bool:
    return bool(message.values.asked_at <= call["wall_ns"] <= message.values.read_at)


def _told(name: str, answer: Line) -> Iterator[tuple[str, Decimal]]:
    """Every field of the channel as the module has told it."""
    if name == "clock":
        yield from ((key, Decimal(answer[key])) for key in ("seconds", "microseconds"))
    elif name == "calibration_status":
        yield from ((key, Decimal(answer[key])) for key in ("status", "channel", "reference"))
        yield "digital_value", Decimal(answer["digital"])
    elif name == "channels_info":
        columns = {"type": "type", "position": "hardware_position", "index": "channel_index"}
        for key, column in columns.items():
            for place in _PLACES:
                yield f"{column}_{place + 1}", Decimal(answer[key][place])
    else:
        yield "channels", Decimal(answer["number"])

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
    from collections.abc import Iterator, Mapping

    from bench.recording import Item, Row
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
DECLARED: Final = {"values": 15300, "information": 15450, "old_values": 101}
"""Those that the peer has with ``acquisition``, as DECLARATIONS names them."""
DECLARATIONS: Final = """
[[devices.msx1.functions]]
name = "values"
register = 15300
period = "100ms"
trigger = { counter = "counter" }
layout = [
  { name = "counter", type = "uint32" },
  { name = "value", type = "float32", count = 16, unit = "um" },
  { name = "stamp", type = "time_stamp" },
]
[[devices.msx1.functions]]
name = "information"
register = 15450
period = "200ms"
layout = [
  { name = "kind", type = "bytes", size = 1 },
  { name = "serial", type = "uint32" },
  { name = "text", type = "text", size = 32 },
  { name = "level", type = "int16", scale = 0.01, unit = "mm" },
  { name = "gain", type = "float32" },
  { name = "revision", type = "uint16" },
  { name = "offset", type = "int32" },
  { name = "key", type = "bytes", size = 33 },
  { name = "comment", type = "text", size = 51 },
]
[[devices.msx1.functions]]
name = "old_values"
register = 101
period = "100ms"
trigger = { change = ["counter"] }
layout = [
  { name = "counter", type = "uint32" },
  { name = "value", type = "int32", count = 16 },
]
"""
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
    functions: channels and their registers.
    """

    def __init__(
        self,
        directory: Path,
        out: Path,
        truth: Truth,
        functions: Mapping[str, int] = FUNCTIONS,
    ) -> None:
        self._functions = functions
        self.wrong: list[str] = []
        self.found: dict[str, list[int]] = {}
        answers = {line["call"]: line for line in truth.of("answer")}
        for name, register in functions.items():
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
                if answer["fate"] not in LATE_FATES or told != _recorded(row, told):
                    self.wrong.append(f"{name}: {row} is not {answer}")
                time = _time(name, answer)
                if (nanoseconds(row["device_time"]) if row["device_time"] else None) != time:
                    self.wrong.append(f"{name}: device time of {row} is not {answer}")

    def delivered(self, name: str, truth: Truth) -> list[int]:
        """Numbers of the calls of this channel that were answered as they should be."""
        calls = [c["call"] for c in truth.of("call") if c.get("register") == self._functions[name]]
        fine = {line["call"] for line in truth.of("answer") if line["fate"] == "ok"}
        return [call for call in calls if call in fine]


def _is_within(call: Line, message: Item) -> bool:
    return bool(message.values.asked_at <= call["wall_ns"] <= message.values.read_at)


def _recorded(row: Row, told: Mapping[str, Decimal | str]) -> dict[str, Decimal | str]:
    """The fields that were told; text as it stands in the file."""
    return {n: row[n] if isinstance(value, str) else number(row[n]) for n, value in told.items()}


def _time(name: str, answer: Line) -> int | None:
    """Nanoseconds UTC that a channel tells, if it does."""
    if name == "clock":
        return int(10**9 * answer["seconds"] + 1000 * answer["microseconds"])
    return 1000 * int(answer["at_us"]) if name == "values" else None


def _told(name: str, answer: Line) -> Iterator[tuple[str, Decimal | str]]:
    """Every field of the channel as the module has told it."""
    if name in DECLARED:
        yield from _told_by_declared(name, answer)
        return
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


def _told_by_declared(name: str, answer: Line) -> Iterator[tuple[str, Decimal | str]]:
    if name == "information":
        yield "kind", f"{answer['kind']:02x}"
        yield "level", Decimal(answer["level"]) / 100
        yield from ((key, Decimal(answer[key])) for key in ("serial", "gain", "revision", "offset"))
        yield from ((key, answer[key]) for key in ("text", "key", "comment"))
        return
    yield "counter", Decimal(answer["counter"])
    yield from ((f"value_{n + 1}", Decimal(answer["values"][n])) for n in _PLACES)
    if name == "values":
        seconds, microseconds = divmod(answer["at_us"], 10**6)
        yield "stamp_seconds", Decimal(seconds)
        yield "stamp_microseconds", Decimal(microseconds)

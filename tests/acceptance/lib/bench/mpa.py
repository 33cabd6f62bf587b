"""An MPA-48 as a process of its own, and its truth beside what was recorded of it."""

from __future__ import annotations

import math
import sys
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from bench.process import Child
from bench.recording import gaps, items, nanoseconds, read_csv
from bench.truth import Truth

if TYPE_CHECKING:
    from bench.recording import Item, Row
    from bench.truth import Line

_PEER: Final = Path(__file__).parents[3] / "peers/mpa.py"
CHANNELS: Final = {
    "channel_1": (0, "15"),
    "channel_2": (3, "10"),
    "channel_3": (40, "52"),
    "channel_4": (1000, "51"),
}
"""Register and model; what no document places lies far away from the others."""
QUANTITIES: Final = {
    "10": ("dissolved_oxygen", "temperature"),
    "15": ("suspended_solids",),
    "51": ("ph", "temperature"),
    "52": ("orp",),
}
RELAYS: Final = tuple(f"relay_{n}" for n in range(1, 9))
REQUESTS: Final = {
    "relays": "0100000008",
    **{name: f"04{register:04x}0003" for name, (register, _) in CHANNELS.items()},
}
"""The only PDUs that the manual and the configuration leave."""
TAKEN_FATES: Final = frozenset({"ok", "late", "garbage"})
"""Fates of an answer that reaches the client whole and right, in time or not."""
_LEVELLED: Final = 20_000_000
"""Nanoseconds by which log_time may be later than the read: it never decreases in a file, and two
commits may overtake each other."""
_BEFORE: Final = ["log_time", "device_time", "seq", "origin"]
_BEHIND: Final = ["previous_read_at", "redelivered", "doubtful", "time_flags"]


class Mpa:
    """The device ``mpa1``. Options are those of tests/peers/mpa.py, by their Python names."""

    def __init__(self, folder: Path, line: str = "tcp", **options: Any) -> None:
        self.line = line
        self._log = folder / "mpa1.truth.jsonl"
        where = ["--tcp", "127.0.0.1:0"] if line == "tcp" else ["--pty", str(folder / "mpa")]
        command = [sys.executable, str(_PEER), *where, "--truth", str(self._log)]
        channels = ";".join(f"{register}:{model}" for register, model in CHANNELS.values())
        for name, value in {"channels": channels, **options}.items():
            command += ["--" + name.replace("_", "-"), str(value)]
        self.child = Child(command, folder / "mpa1.peer")
        try:
            self.child.while_it_runs(lambda: self.child.said().endswith("\n"), "it to listen")
        except BaseException:
            self.child.kill()
            raise
        self.address = self.child.said().split()[1]

    @property
    def truth(self) -> Truth:
        return Truth(self._log)

    @property
    def log_size(self) -> int:
        """Octets of the truth so far."""
        return self._log.stat().st_size

    def told(self, name: str) -> list[Line]:
        return [line for line in self.truth.of("answer") if line["request"] == REQUESTS[name]]

    def end(self) -> Truth:
        self.child.stop()
        return self.truth

    def toml(self, poll: str, connection: str = "") -> str:
        where = f'transport = "rtu"\nport = "{self.address}"\nsilence = "2ms"\nbaudrate = 115200'
        if self.line == "tcp":
            where = f'transport = "tcp"\nhost = "127.0.0.1"\nport = {self.address}'
        models = ", ".join(f'{name} = "model-{model}"' for name, (_, model) in CHANNELS.items())
        places = ", ".join(
            f"{name} = {register}" for name, (register, _) in CHANNELS.items() if register > 3
        )
        return (
            f"[connections.plant]\n{where}\n{connection}\n"
            f'[devices.mpa1]\nprofile = "mpa-48"\nconnection = "plant"\npoll = "{poll}"\n'
            f"sensors = {{ {models} }}\naddresses = {{ {places} }}\n"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()


class Judge:
    """wrong: rows and messages that are not what the device told in answer to that very request.

    found: the answers that were recorded, by their number in the truth, for each channel.
    """

    def __init__(self, directory: Path, out: Path, truth: Truth) -> None:
        self.wrong: list[str] = []
        self.found: dict[str, list[int]] = {}
        self._directory = directory
        self._answers = list(enumerate(truth.of("answer")))
        for name in REQUESTS:
            table = out / f"mpa1.{name}.csv"
            self._judge(name, read_csv(table) if table.exists() else [])

    def delivered(self, name: str) -> list[int]:
        """Numbers of the answers of this channel that were as they should be."""
        request = REQUESTS[name]
        return [n for n, a in self._answers if (a["request"], a["fate"]) == (request, "ok")]

    def holes(self, name: str, poll: int) -> list[str]:
        """Times without a sample that no gap of the recording says."""
        told = gaps(self._directory, "mpa1")
        reads = [item.values.read_at for item in items(self._directory, f"/mpa1/{name}")]
        return [
            f"{name}: nothing from {before} to {after}"
            for before, after in pairwise(reads)
            if after - before > 3 * poll
            and not any(gap.since <= before + poll and gap.to >= after - poll for gap in told)
        ]

    def _judge(self, name: str, rows: list[Row]) -> None:
        messages = items(self._directory, f"/mpa1/{name}")
        self.found[name] = []
        if len(rows) != len(messages):
            self.wrong.append(f"{name}: {len(rows)} rows of {len(messages)} messages")
        before = 0
        for row, message in zip(rows, messages, strict=False):
            asked, read = message.values.asked_at, message.values.read_at
            within = [
                (n, answer)
                for n, answer in self._answers
                if answer["request"] == REQUESTS[name] and asked <= answer["at_ns"] <= read
            ]
            if len(within) != 1:
                self.wrong.append(f"{name}: {len(within)} answers belong to {row}")
                continue
            ((number, answer),) = within
            self.found[name].append(number)
            is_right = (
                answer["fate"] in TAKEN_FATES
                and list(row) == [*_BEFORE, *_values(name), *_BEHIND]
                and read <= message.log_time <= read + _LEVELLED
                and nanoseconds(row["log_time"]) == message.log_time
                and _instant(row["previous_read_at"]) in (before, 0)
                and message.values.raw.hex() == answer["data"]
                and row["doubtful"] == ""
            )
            before = read
            if not is_right or not _is_told(name, row, message, answer):
                self.wrong.append(f"{name}: {row} is not {answer}")
        if self.found[name] != sorted(set(self.found[name])):
            self.wrong.append(f"{name}: answers recorded twice, or not in their order")


def _instant(text: str) -> int:
    return nanoseconds(text) if text else 0


def _values(name: str) -> tuple[str, ...]:
    """Every field, and no other: an undefined register has none."""
    return RELAYS if name == "relays" else ("status", *QUANTITIES[CHANNELS[name][1]])


def _is_told(name: str, row: Row, message: Item, answer: Line) -> bool:
    if name == "relays":
        states = [getattr(message.values, relay) for relay in RELAYS]
        cells = ["true" if is_on else "false" for is_on in answer["relays"]]
        return states == answer["relays"] and [row[relay] for relay in RELAYS] == cells
    register, model = CHANNELS[name]
    channel = answer["channels"][str(register)]
    quantities = QUANTITIES[model]
    mask = ((1 << len(quantities)) - 1) << 1 if channel["status"] else 0  # bit 0 is the status
    if row["status"] != str(channel["status"]) or message.values.status != channel["status"]:
        return False
    return message.values.missing == mask and all(
        _is_missing(quantity, row, message)
        if channel["status"]
        else Decimal(row[quantity])
        == Decimal(repr(getattr(message.values, quantity)))
        == Decimal(channel["told"][quantity])
        for quantity in quantities
    )


def _is_missing(quantity: str, row: Row, message: Item) -> bool:
    """An unscaled integer cannot say that it is none; its bit of the mask does."""
    value = getattr(message.values, quantity)
    return row[quantity] == "" and (isinstance(value, int) or math.isnan(value))

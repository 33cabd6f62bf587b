"""What an MSX-E3317 test device can be told: one dataclass field is one command line option."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, fields
from typing import Any, Literal

Order = Literal["big", "little"]


def _option(default: object, text: str, kind: type = str) -> Any:
    return field(default=default, metadata={"help": text, "kind": kind})


@dataclass(frozen=True)
class Failure:
    """A function that performs incorrectly: exception 9, and what the status then says."""

    register: int
    return_value: int
    errno: int
    text: str


@dataclass(frozen=True, kw_only=True)
class Options:
    tcp: str | None = _option(None, "HOST:PORT to listen on, port 0 for any")
    udp: str | None = _option(None, "HOST:PORT to listen on, port 0 for any")
    order: Literal["big", "little"] = _option("big", "byte order: big or little")
    seed: int = _option(1, "of values and faults", int)
    truth: str | None = _option(None, "JSONL file of what really happened")
    module: str = _option("MSX-E3317-8", "text of GetModuleType")
    channels: int = _option(8, "pressure channels, at most 16", int)
    clock_offset: float = _option(0.0, "seconds the module is ahead at the start", float)
    clock_drift: float = _option(0.0, "parts per million the module is fast", float)
    acquisition: float = _option(
        0.0, "seconds between values; 0: functions that no document describes are not there", float
    )
    fail: str = _option("", "REGISTER:RETURN:ERRNO:TEXT, several with ';': exception 9")
    fail_count: int = _option(0, "failures of each before it works, 0 for ever", int)
    answer_after: float = _option(0.0, "seconds a function takes", float)
    drop_request: float = _option(0.0, "share of requests lost before the device", float)
    drop: float = _option(0.0, "share of answers lost, the function is carried out", float)
    duplicate: float = _option(0.0, "share of answers sent twice", float)
    reorder: float = _option(0.0, "share of answers sent behind the next one", float)
    held_for: float = _option(0.3, "seconds after which an answer waits no longer", float)
    short: float = _option(0.0, "share of answers with half of their words", float)
    other_count: float = _option(0.0, "share with the other size of the byte count", float)
    other_unit: float = _option(0.0, "share from the other unit", float)

    def __post_init__(self) -> None:
        if self.tcp is None and self.udp is None:
            raise ValueError("at least one of tcp and udp")
        if self.order not in ("big", "little"):
            raise ValueError("order: big or little")
        if not 0 <= self.channels <= 16:
            raise ValueError("channels: 0 to 16")
        if self.acquisition < 0:
            raise ValueError("acquisition: seconds, or 0")
        shares = self.shares.values()
        if min(shares) < 0 or sum(shares) > 1:
            raise ValueError("shares of faults: 0 to 1, in sum too")
        _ = self.failures

    @property
    def shares(self) -> dict[str, float]:
        names = "drop_request", "drop", "duplicate", "reorder", "short", "other_count", "other_unit"
        return {name: getattr(self, name) for name in names}

    @property
    def failures(self) -> list[Failure]:
        parts = [item.split(":", 3) for item in self.fail.split(";") if item]
        return [Failure(int(r), int(value), int(errno), text) for r, value, errno, text in parts]


def parse_options(arguments: list[str] | None = None) -> Options:
    parser = argparse.ArgumentParser(description="MSX-E3317 test device", allow_abbrev=False)
    for item in fields(Options):
        name = "--" + item.name.replace("_", "-")
        text = item.metadata["help"] + " (default: %(default)s)"
        parser.add_argument(name, type=item.metadata["kind"], default=item.default, help=text)
    try:
        return Options(**vars(parser.parse_args(arguments)))
    except ValueError as error:
        parser.error(str(error))

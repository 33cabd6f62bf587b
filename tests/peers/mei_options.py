"""What a device with time-stamped inputs can be told: one dataclass field is one option."""

from __future__ import annotations

from dataclasses import dataclass

from peer_options import option, parse

LAYOUTS = ("interleaved", "grouped")
EXCEPTIONS = ("long", "short")
WEEKDAYS = ("unused", "iso", "sunday")


@dataclass
class Failure:
    """An exception for every request about that input, `left` times; 0 from the start: always."""

    mei: int
    address: int
    code: int
    left: int


@dataclass(frozen=True, kw_only=True)
class Options:
    tcp: str | None = option(None, "HOST:PORT to listen on, port 0 for any")
    pty: str | None = option(None, "symbolic link to make to a pseudo terminal")
    unit: int = option(1, "unit address", int)
    seed: int = option(1, "of values, events and faults", int)
    truth: str | None = option(None, "JSONL file of what really happened")
    discrete: int = option(300, "discrete inputs", int)
    registers: int = option(300, "input registers", int)
    first: int = option(0, "address of the first of each", int)
    layout: str = option("interleaved", "of values and stamps", choices=LAYOUTS)
    exceptions: str = option("long", "with the MEI type, or without", choices=EXCEPTIONS)
    zone: str = option("UTC", "UTC or a name of the tz database: what the clock shows")
    dow: str = option("iso", "day of the week in stamps", choices=WEEKDAYS)
    clock_offset: float = option(0.0, "seconds the clock is ahead at the start", float)
    clock_drift: float = option(0.0, "parts per million the clock is fast", float)
    oldest: float = option(23.0, "hours: age of the oldest state at the start", float)
    rate: float = option(0.0, "events per second", float)
    events: int = option(0, "events to make, 0 without end", int)
    same: float = option(0.0, "share of events that bring the value there was", float)
    iv: float = option(0.0, "share of events whose time the device holds for invalid", float)
    never: float = option(0.0, "share of inputs whose stamp was never set", float)
    fail: str = option("", "MEI:ADDRESS:CODE:TIMES, several with ';': exceptions")
    late: float = option(0.0, "share of answers that come late", float)
    late_by: float = option(0.8, "seconds from the request's end to a late answer", float)
    busy: str = option("queue", "what is done meanwhile", choices=("queue", "deaf"))
    corrupt: float = option(0.0, "share of answers with one bit flipped", float)
    drop: float = option(0.0, "share of answers never sent", float)
    garbage: float = option(0.0, "share of answers behind 1-8 random octets", float)

    def __post_init__(self) -> None:
        if (self.tcp is None) == (self.pty is None):
            raise ValueError("exactly one of tcp and pty")
        for name in ("discrete", "registers"):
            if not 0 <= getattr(self, name) <= 0x10000 - self.first:
                raise ValueError(f"{name}: inputs up to address 65535")
        shares = (self.late, self.corrupt, self.drop, self.garbage)
        if min(shares) < 0 or sum(shares) > 1:
            raise ValueError("shares of late, corrupt, drop and garbage: 0 to 1, in sum too")
        _ = self.failures

    @property
    def failures(self) -> list[Failure]:
        items = [item.split(":") for item in self.fail.split(";") if item]
        return [Failure(*(int(number, 0) for number in item)) for item in items]


def parse_options(arguments: list[str] | None = None) -> Options:
    return parse(Options, "test device with time-stamped inputs", arguments)

"""What an MPA-48 test device can be told: one dataclass field is one command line option."""

from __future__ import annotations

from dataclasses import dataclass

from peer_options import option, parse

MODELS = ("10", "15", "51", "52")


@dataclass
class Failure:
    """An exception to every request that touches the address, `left` times; 0: always."""

    function: int
    address: int
    code: int
    left: int


@dataclass(frozen=True, kw_only=True)
class Options:
    tcp: str | None = option(None, "HOST:PORT to listen on, port 0 for any")
    pty: str | None = option(None, "symbolic link to make to a pseudo terminal")
    unit: int = option(1, "unit address", int)
    seed: int = option(1, "of values, statuses and faults", int)
    truth: str | None = option(None, "JSONL file of what was told in answer to what")
    channels: str = option("0:15;3:10", "REGISTER:MODEL, several with ';'; models 10, 15, 51, 52")
    period: float = option(0.05, "seconds from change to change, 0: nothing changes", float)
    trouble: float = option(0.3, "share of the time with a status other than 0", float)
    fail: str = option("", "FUNCTION:ADDRESS:CODE:TIMES, several with ';': exceptions")
    late: float = option(0.0, "share of answers that come late", float)
    late_by: float = option(0.8, "seconds from the request's end to a late answer", float)
    busy: str = option("queue", "what is done meanwhile", choices=("queue", "deaf"))
    corrupt: float = option(0.0, "share of answers with one bit flipped", float)
    drop: float = option(0.0, "share of answers never sent", float)
    garbage: float = option(0.0, "share of answers behind 1-8 random octets", float)
    short: float = option(0.0, "share of answers with half of their data", float)
    other_unit: float = option(0.0, "share of answers from the next unit", float)

    def __post_init__(self) -> None:
        if (self.tcp is None) == (self.pty is None):
            raise ValueError("exactly one of tcp and pty")
        if self.busy not in ("queue", "deaf"):
            raise ValueError("busy: queue or deaf")
        parts = "late", "corrupt", "drop", "garbage", "short", "other_unit"
        shares = [getattr(self, name) for name in parts]
        if min(shares) < 0 or sum(shares) > 1:
            raise ValueError(f"shares of {', '.join(parts)}: 0 to 1, in sum too")
        taken = [at + word for at in self.sensors for word in range(3)]
        if len(set(taken)) < len(taken) or not all(0 <= at <= 0xFFFF for at in taken):
            raise ValueError("channels: three registers each, none twice")
        if not set(self.sensors.values()) <= set(MODELS):
            raise ValueError(f"channels: models {', '.join(MODELS)}")
        _ = self.failures

    @property
    def sensors(self) -> dict[int, str]:
        """Model by the register of the status."""
        pairs = (item.split(":") for item in self.channels.split(";") if item)
        return {int(register): model for register, model in pairs}

    @property
    def failures(self) -> list[Failure]:
        items = (item.split(":") for item in self.fail.split(";") if item)
        return [Failure(*(int(number) for number in item)) for item in items]


def parse_options(arguments: list[str] | None = None) -> Options:
    return parse(Options, "MPA-48 test device", arguments)

"""What a device of any registers can be told: one dataclass field is one command line option."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, fields
from typing import Any


def _option(default: object, text: str, kind: type = str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=default, metadata={"help": text, "kind": kind, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class Options:
    tcp: str | None = _option(None, "HOST:PORT to listen on, port 0 for any")
    udp: str | None = _option(None, "HOST:PORT to listen on, port 0 for any")
    pty: str | None = _option(None, "symbolic link to make to a pseudo terminal")
    memory: str = _option("", "JSON file that describes what lies in its tables")
    truth: str | None = _option(None, "JSONL file of what really happened")
    check_disk: str | None = _option(None, "look for each cleared sample in DIR/**/*.mcap")
    seed: int = _option(1, "of faults", int)
    dark: float = _option(0.3, "seconds without power when it restarts", float)
    late: float = _option(0.0, "share of answers that come late", float)
    late_by: float = _option(0.8, "seconds from the request's end to a late answer", float)
    busy: str = _option("queue", "what is done meanwhile", choices=("queue", "deaf"))
    corrupt: float = _option(0.0, "share of answers with one bit flipped", float)
    drop: float = _option(0.0, "share of answers never sent", float)
    garbage: float = _option(0.0, "share of answers behind 1-8 random octets", float)
    short: float = _option(0.0, "share of answers that lack their last two octets", float)

    def __post_init__(self) -> None:
        if [self.tcp, self.udp, self.pty].count(None) != 2:
            raise ValueError("exactly one of tcp, udp and pty")
        if not self.memory:
            raise ValueError("memory: a JSON file")
        shares = (self.late, self.corrupt, self.drop, self.garbage)
        if min(*shares, self.short) < 0 or sum(shares) > 1 or self.short > 1:
            raise ValueError("shares of faults: 0 to 1, in sum too")


def parse_options(arguments: list[str] | None = None) -> Options:
    parser = argparse.ArgumentParser(description="test device of registers", allow_abbrev=False)
    for item in fields(Options):
        name = "--" + item.name.replace("_", "-")
        text = item.metadata["help"] + " (default: %(default)s)"
        choices = item.metadata["choices"] or None
        kind = item.metadata["kind"]
        parser.add_argument(name, type=kind, default=item.default, choices=choices, help=text)
    try:
        return Options(**vars(parser.parse_args(arguments)))
    except ValueError as error:
        parser.error(str(error))

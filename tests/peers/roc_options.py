"""What a ROC test device can be told: one dataclass field is one command line option."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, fields
from random import Random
from typing import Any

WORD_ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")


def _option(default: object, text: str, *, kind: type = str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=default, metadata={"help": text, "kind": kind, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class Options:
    tcp: str | None = _option(None, "HOST:PORT to listen on, port 0 for any")
    pty: str | None = _option(None, "symbolic link to make to a pseudo terminal")
    unit: int = _option(138, "unit address (register 100)", kind=int)
    serial_number: str = _option("1203270042", "10 characters (registers 25-29)")
    cycle: float = _option(0.2, "seconds from sample to sample", kind=float)
    samples: int = _option(300, "samples to make", kind=int)
    seed: int = _option(1, "of samples and faults", kind=int)
    word_order: str = _option("ABCD", "of 32-bit values", choices=WORD_ORDERS)
    truth: str | None = _option(None, "JSONL file of what really happened")
    linger: float = _option(2.0, "seconds to live after the last sample", kind=float)
    late: float = _option(0.0, "share of answers that come late", kind=float)
    late_by: float = _option(0.8, "seconds from the request's end to a late answer", kind=float)
    busy: str = _option("queue", "what is done meanwhile", choices=("queue", "deaf"))
    corrupt: float = _option(0.0, "share of answers with one bit flipped", kind=float)
    drop: float = _option(0.0, "share of answers never sent", kind=float)
    garbage: float = _option(0.0, "share of answers behind 1-8 random octets", kind=float)
    race_every: int = _option(0, "every N-th sample comes just before a clear", kind=int)
    zeros_at_start: bool = _option(default=False, text="300-326 are zero at first", kind=bool)
    reboot_at: int = _option(0, "power fails half a cycle after sample K", kind=int)
    live: bool = _option(default=False, text="306/307 and 326 change at quarters", kind=bool)
    tear: bool = _option(default=False, text="the block changes in two halves", kind=bool)
    tear_for: float = _option(0.0, "seconds between the halves (0: default)", kind=float)
    tear_flag_first: bool = _option(default=False, text="flag with first half", kind=bool)
    refuse_clear: str | None = _option(None, "do not clear", choices=("exception", "silent"))
    refuse_count: int = _option(0, "clears to refuse, 0 for all", kind=int)
    silent_effect: str = _option("no", "silent clears take effect", choices=("yes", "no"))
    plc: bool = _option(default=False, text="another master clears too", kind=bool)
    identical_every: int = _option(0, "every N-th sample repeats the one before", kind=int)
    drop_link_every: float = _option(0.0, "seconds between losses of the link", kind=float)
    stop_after: int = _option(0, "dead half a cycle after sample K", kind=int)
    settings: str | None = _option(
        None,
        "what becomes of a write to 100-113: refused, echoed only, done unanswered, neither, "
        "done a second later and answered by an exception",
        choices=("refuse", "ignore", "lose", "deaf", "acknowledge"),
    )
    settings_with: int = _option(3, "exception code of refuse and acknowledge", kind=int)
    settings_from: int = _option(1, "number of the first write that befalls", kind=int)
    power_fails_after: int = _option(0, "power fails after the N-th write to 100-113", kind=int)
    refuse_command: int = _option(0, "register, 1101 or 1102, that answers exception 3", kind=int)
    refuse_with: int = _option(3, "another exception code for it", kind=int)
    refuse_done: bool = _option(default=False, text="and it is carried out", kind=bool)
    deaf_command: int = _option(0, "register, 1101 or 1102, not heard at all", kind=int)
    save_finds_old: bool = _option(
        default=False, text="power fails for a moment just before a save", kind=bool
    )
    refuse_read: int = _option(0, "first register of reads that answer exception 2", kind=int)
    lose_command: int = _option(0, "register, 1101 or 1102, done unanswered", kind=int)
    reset_takes: float = _option(0.0, "seconds of silence after a reset", kind=float)
    node_id_now: bool = _option(default=False, text="100 counts as soon as written", kind=bool)
    check_disk: str | None = _option(None, "look for each cleared block in DIR/**/*.mcap")

    def __post_init__(self) -> None:
        if (self.tcp is None) == (self.pty is None):
            raise ValueError("exactly one of tcp and pty")
        shares = (self.late, self.corrupt, self.drop, self.garbage)
        if min(shares) < 0 or sum(shares) > 1:
            raise ValueError("shares of late, corrupt, drop and garbage: 0 to 1, in sum too")
        if self.cycle <= 0 or not 0 <= self.tear_seconds < self.cycle:
            raise ValueError("cycle must be positive and longer than tear-for")
        if self.pty and 0 < self.drop_link_every <= PTY_AWAY:
            raise ValueError(f"drop-link-every of a pty must exceed {PTY_AWAY} s")

    @property
    def tears(self) -> bool:
        return self.tear or self.tear_flag_first

    @property
    def tear_seconds(self) -> float:
        if not self.tears:
            return 0.0
        return self.tear_for or min(self.cycle / 20, 0.1)


PTY_AWAY = 0.5
"""Seconds for which a lost pseudo terminal stays away."""


def rng(seed: int, purpose: str) -> Random:
    """One stream per purpose: faults must not change the samples, nor samples the faults."""
    return Random(f"{seed}/{purpose}")


def parse_options(arguments: list[str] | None = None) -> Options:
    parser = argparse.ArgumentParser(description="HIAC ROC test device", allow_abbrev=False)
    for item in fields(Options):
        name = "--" + item.name.replace("_", "-")
        text = item.metadata["help"] + " (default: %(default)s)"
        kind = item.metadata["kind"]
        if kind is bool:
            parser.add_argument(name, action="store_true", help=text)
        else:
            choices = item.metadata["choices"] or None
            parser.add_argument(name, type=kind, default=item.default, choices=choices, help=text)
    try:
        return Options(**vars(parser.parse_args(arguments)))
    except ValueError as error:
        parser.error(str(error))

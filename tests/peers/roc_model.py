"""The ROC without time: its registers, what requests do to them, and what is true about it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from roc_map import (
    BLOCK,
    FLAG,
    NODE_ID,
    PERIOD,
    RESET,
    SAMPLE_PERIOD,
    SAVE,
    check_read,
    check_write,
    configuration,
    identity,
)
from roc_samples import Sample, SampleSource
from wire import (
    ILLEGAL_ADDRESS,
    ILLEGAL_VALUE,
    PduError,
    Read,
    Write,
    exception_pdu,
    octets_of,
    parse,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from roc_disk import Disk
    from roc_options import Options
    from roc_truth import Truth

_BODY = PERIOD - FLAG
"""Registers 305-326 are what a sample consists of; 301-304 always read 0."""


@dataclass(frozen=True)
class Reply:
    """`pdu` None: the device does not answer. `sample` is the one carried whole by a read."""

    pdu: bytes | None
    sample: Sample | None = None
    facts: dict[str, object] | None = None


def _nothing(_sample: Sample | None) -> bool:
    return False


def _disk(directory: str) -> Disk:
    from roc_disk import Disk  # noqa: PLC0415 - the one module that needs the mcap package

    return Disk(directory)


class Model:
    def __init__(self, options: Options, truth: Truth) -> None:
        self.truth = truth
        self.on_reset: Callable[[], None] = lambda: None
        self.on_power_failure: Callable[[], object] = lambda: None
        self.on_acknowledge: Callable[[Callable[[], None]], object] = lambda later: later()
        self.race: Callable[[Sample | None], bool] = _nothing
        self._options = options
        self._disk = _disk(options.check_disk) if options.check_disk else None
        self._identity = identity(options.serial_number)
        self._saved = configuration(options.unit, options.cycle)
        self._config = dict(self._saved)
        self._unit = options.unit
        self._settings_written = 0
        period = self._saved[SAMPLE_PERIOD]
        self.source = SampleSource(
            options.seed, options.word_order, period, options.identical_every
        )
        self.block = [0] * len(BLOCK)
        self.current: Sample | None = None
        self._flagged: Sample | None = None
        self._incoming: Sample | None = None
        self._refused = 0
        self._made: list[Sample] = []
        self._reads: Counter[str] = Counter()
        initial = self.source.make()
        if not options.zeros_at_start:
            self.current = initial
            self.block = [0, *initial.registers[1:]]

    @property
    def unit(self) -> int:
        """A new node id counts from the next start on, if it was saved; the document is silent."""
        return self._config[NODE_ID] if self._options.node_id_now else self._unit

    # -- the life of a sample ---------------------------------------------------------------

    def begin(self, sample: Sample, split: int) -> None:
        """First half of a torn update: the registers below `split` get their new values."""
        self._leave(sample.k)
        self.current, self._incoming = None, sample
        self.block[_BODY : split - FLAG] = sample.registers[_BODY : split - FLAG]
        if self._options.tear_flag_first:
            self._raise(sample)

    def complete(self, sample: Sample) -> None:
        torn = self._incoming is not None
        if not torn:
            self._leave(sample.k)
        self.current, self._incoming = sample, None
        self.block[_BODY:] = sample.registers[_BODY:]
        if not (torn and self._options.tear_flag_first):
            self._raise(sample)
        self._made.append(sample)
        self.truth.log("made", k=sample.k, registers=list(self.block), **sample.facts)

    def live(self) -> None:
        if self.current is not None:
            self.source.live(self.block)
            self.truth.log("live", k=self.current.k, registers=list(self.block))

    def plc_clear(self) -> None:
        if self._flagged is not None:
            self.truth.log("plc_clear", k=self._flagged.k)
            self._lower()

    def power_up(self) -> None:
        self._leave(None)
        self.current = self._incoming = self._flagged = None
        self.block = [0] * len(BLOCK)
        self._config = dict(self._saved)
        self._unit = self._saved[NODE_ID]

    def _raise(self, sample: Sample) -> None:
        self._flagged, self.block[0] = sample, 1

    def _lower(self) -> None:
        if self._flagged is not None:
            self._flagged.cleared = True
        self._flagged, self.block[0] = None, 0

    def _leave(self, by: int | None) -> None:
        """The current sample goes out of the registers; `by` None: at a loss of power."""
        old = self.current
        if old is None or old.k == 0 or "ok" in old.delivered:
            return
        facts = {f"delivered_{fate}": fate in old.delivered for fate in ("ok", "late", "garbage")}
        self.truth.log("overwritten", k=old.k, by=by, cleared=old.cleared, **facts)

    # -- requests ---------------------------------------------------------------------------

    def execute(self, pdu: bytes, fate: str, origin: dict[str, object]) -> Reply:
        """`fate` is what the link will do to the answer; `origin` goes into the truth log."""
        try:
            command = parse(pdu)
            if isinstance(command, Read):
                return self._read(command, origin)
            return self._write(command, pdu, {"fate": fate, **origin})
        except PduError as error:
            facts = {"code": error.code, "request": pdu.hex(), "fate": fate}
            self.truth.log("exception", function=pdu[0], **facts, **origin)
            return Reply(exception_pdu(pdu[0], error.code))

    def _read(self, command: Read, origin: dict[str, object]) -> Reply:
        check_read(command)
        if command.address == self._options.refuse_read and command.address:
            raise PduError(ILLEGAL_ADDRESS)
        span = range(command.address, command.address + command.count)
        data = octets_of([self._register(address) for address in span])
        touches_block = span[-1] in BLOCK
        whole = PERIOD in span and BLOCK[-1] in span
        torn = touches_block and self._incoming is not None
        if whole and self._flagged is not None:
            mark = "torn" if torn else "whole"
            self._flagged.served.setdefault(octets_of(self.block[_BODY:]), mark)
        facts: dict[str, object] = {"address": command.address, "count": command.count}
        if touches_block:
            facts |= {"torn": torn, "flag": self.block[0]}
        pdu = bytes([3, len(data)]) + data
        return Reply(pdu, self.current if whole else None, {**facts, **origin})

    def settled(self, reply: Reply, fate: str, **extra: object) -> None:
        """The answer has gone its way: `fate` is what became of it in the end."""
        if reply.facts is None:
            return
        sample = reply.sample
        if sample is not None:
            sample.delivered.add(fate)
            extra["stale"] = sample is not self.current
        self._reads[fate] += 1
        k = sample.k if sample else None
        self.truth.log("read", k=k, fate=fate, **reply.facts, **extra)

    def _register(self, address: int) -> int:
        if address in BLOCK:
            return self.block[address - FLAG]
        return self._config[address] if address in self._config else self._identity[address]

    def _write(self, command: Write, pdu: bytes, origin: dict[str, object]) -> Reply:
        echo = pdu[:5]
        if command.address == FLAG and command.values == (0,):
            return self._clear(command.function, echo, origin)
        facts: dict[str, object] = {"function": command.function, "address": command.address}
        facts |= {"values": list(command.values), **origin}
        try:
            wanted = check_write(command, self._config)
            self._refuse_command(wanted)
        except PduError as error:
            self.truth.log("write", accepted=False, code=error.code, **facts)
            raise
        if wanted.keys() & self._config.keys():
            return self._set(wanted, echo, facts)
        if self._options.deaf_command in wanted:
            self.truth.log("write", accepted=False, fault="deaf", **facts)
            return Reply(None)
        if SAVE in wanted:
            self._save()
        if RESET in wanted:
            self.truth.log("reset", **facts)
            self.on_reset()
            return Reply(None)
        self.truth.log("write", accepted=True, **facts)
        return Reply(None if self._options.lose_command in wanted else echo)

    def _save(self) -> None:
        if self._options.save_finds_old:
            self._config = dict(self._saved)
        self._saved = dict(self._config)

    def _refuse_command(self, wanted: dict[int, int]) -> None:
        if self._options.refuse_command not in wanted:
            return
        if self._options.refuse_done:
            self.on_reset() if RESET in wanted else self._save()
        raise PduError(self._options.refuse_with)

    def _set(self, wanted: dict[int, int], echo: bytes, facts: dict[str, object]) -> Reply:
        """A write of settings, or what has been ordered to become of it."""
        options = self._options
        self._settings_written += 1
        ordered = self._settings_written >= options.settings_from
        fault = options.settings if ordered else None
        self.truth.log(
            "write", accepted=fault in (None, "lose", "acknowledge"), fault=fault, **facts
        )
        if fault == "acknowledge":
            self.on_acknowledge(lambda: self._config.update(wanted))
        if fault in ("refuse", "acknowledge"):
            raise PduError(options.settings_with)
        if fault in (None, "lose"):
            self._config |= wanted
        if self._settings_written == options.power_fails_after:
            self.on_power_failure()
        return Reply(None if fault in ("lose", "deaf") else echo)

    def _clear(self, function: int, echo: bytes, origin: dict[str, object]) -> Reply:
        facts = {"function": function, **self._on_disk(), **origin}
        if self._refuses():
            return self._refuse(echo, facts)
        arrived = self._flagged
        raced = self.race(arrived)
        self._log_clear(raced=raced, arrived_k=arrived.k if arrived else None, **facts)
        return Reply(echo)

    def _log_clear(self, **facts: object) -> None:
        k = self._flagged.k if self._flagged else None
        torn = self._incoming is not None
        self._lower()
        self.truth.log("clear", k=k, torn=torn, **facts)

    def _refuses(self) -> bool:
        limit = self._options.refuse_count
        return bool(self._options.refuse_clear) and (not limit or self._refused < limit)

    def _refuse(self, echo: bytes, facts: dict[str, object]) -> Reply:
        self._refused += 1
        how = self._options.refuse_clear
        k = self._flagged.k if self._flagged else None
        effect = how == "silent" and self._options.silent_effect == "yes"
        if how == "silent":
            facts["fate"] = "dropped"
        self.truth.log("refused", k=k, how=how, effect=effect, **facts)
        if how == "exception":
            return Reply(exception_pdu(echo[0], ILLEGAL_VALUE))
        if effect:
            self._log_clear(raced=False, arrived_k=k, **facts)
        return Reply(None)

    def _on_disk(self) -> dict[str, object]:
        """The block as it is now, or as a client was sent it since its flag went up."""
        if self._disk is None:
            return {}
        form = "torn" if self._incoming is not None else "whole"
        served = self._flagged.served if self._flagged else {}
        needles = [(octets_of(self.block[_BODY:]), form), *served.items()]
        needles.sort(key=lambda item: item[1] == "torn")
        found, errors = self._disk.find(needles)
        facts: dict[str, object] = {"on_disk": found is not None, "on_disk_form": found}
        return facts | ({"disk_errors": errors} if errors else {})

    # -- the end ----------------------------------------------------------------------------

    def summary(self) -> None:
        counts = dict(self.truth.counts)
        fates = [sample.delivered for sample in self._made]
        ok = sum("ok" in fate for fate in fates)
        late = sum("late" in fate and "ok" not in fate for fate in fates)
        never = [s.k for s in self._made if not s.delivered & {"ok", "late"}]
        self.truth.log(
            "summary",
            made=len(self._made),
            delivered_ok=ok,
            delivered_late_only=late,
            never_delivered=never,
            cleared=sum(sample.cleared for sample in self._made),
            reads=dict(self._reads),
            events=counts,
        )

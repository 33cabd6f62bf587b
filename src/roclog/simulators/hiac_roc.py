"""The HIAC ROC particle counter, simulated from its document.

Source: MODBUS Serial Communications Protocol of the device, first draft of 3-27-2012. Where the
document is silent, this simulator decides:

- Registers without an entry, read-only registers when written and write-only registers when read
  are answered with exception 2; no part of such a request is carried out.
- A write to the configuration is effective at once, the periods 105 and 106 with the next sample.
  0x5A in 1102 saves the block; a reset brings back what was saved.
- The node id in register 100 becomes the address on the line at the next reset, and only when it
  was saved.
- A reset (0x55 in 1101) has no answer and takes no time. Sample block and flag become 0 and a new
  sample starts. The oil does not notice.
- A sample block stays as it is until the next sample completes; nothing in it is live.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Final, Literal, TextIO

from roclog.simulators import roc_settings
from roclog.simulators.oil import Fluid, OilSystem
from roclog.simulators.roc_sample import SAMPLE_BLOCK, TRUTH_COLUMNS, RocSample

if TYPE_CHECKING:
    from collections.abc import Sequence

WordOrder = Literal["ABCD", "CDAB"]

READ_REGISTERS: Final = 3
WRITE_REGISTER: Final = 6
WRITE_REGISTERS: Final = 16

ILLEGAL_FUNCTION: Final = 1
ILLEGAL_DATA_ADDRESS: Final = 2
ILLEGAL_DATA_VALUE: Final = 3

MOST_READ: Final = 125
MOST_WRITTEN: Final = 123
SHORT_REQUEST: Final = 5
"""Octets of a request for functions 3 and 6, and of the fixed part of function 16."""

NEW_DATA: Final = 300
RESET: Final = 1101
RESET_KEY: Final = 0x55
SAVE: Final = 1102
SAVE_KEY: Final = 0x5A

NS_PER_S: Final = 1_000_000_000


class _RefusedError(Exception):
    """A request that is answered with a Modbus exception."""

    def __init__(self, exception_code: int) -> None:
        super().__init__(exception_code)
        self.exception_code = exception_code


class SimulatedRoc:
    """A ROC with its oil, driven by `step` and asked by `answer`.

    Args:
        unit: Address on the line, 1-247, until a reset brings in another saved node id.
        seed: Equal seeds and units give equal samples, however the time is cut into steps.
        truth: Gets a CSV header now and one row per completed sample, flushed, in physical units:
            counts per mL, temperature in degrees Celsius, sample period in seconds. The rows are
            numbered from 1 and go on over a reset.
        word_order: Order of the two registers of a 32-bit value: "ABCD" high word first, "CDAB"
            low word first. The document does not say which the device uses.
        fluid: What is sampled; an `OilSystem` when not given.

    Raises:
        ValueError: `unit` or `word_order` is none of the above.
    """

    def __init__(
        self,
        unit: int = 138,
        *,
        seed: int,
        truth: TextIO | None = None,
        word_order: WordOrder = "ABCD",
        fluid: Fluid | None = None,
    ) -> None:
        if unit not in roc_settings.NODE_IDS:
            raise ValueError(f"unit {unit} is not in 1-247")
        if word_order not in ("ABCD", "CDAB"):
            raise ValueError(f"word order {word_order!r} is neither ABCD nor CDAB")
        self._unit = unit
        self._truth = truth
        self._is_high_word_first = word_order == "ABCD"
        self._fluid = fluid or OilSystem(Random(f"hiac-roc {seed} {unit}"))
        self._identity = _identity_words(f"{seed % 1_000_000:06d}-{unit:03d}")
        self._settings = roc_settings.default_words(unit)
        self._saved = dict(self._settings)
        self._sample = dict.fromkeys(SAMPLE_BLOCK, 0)
        self._samples = 0
        self._unaged_s = 0
        self._start_cycle()
        if truth is not None:
            self._write_truth(",".join(TRUTH_COLUMNS))

    @property
    def unit(self) -> int:
        """The address that the device answers to at present."""
        return self._unit

    def step(self, seconds: float) -> None:
        """Let time pass; a sample completes at the end of each sample period.

        Raises:
            ValueError: `seconds` is negative.
        """
        if seconds < 0:
            raise ValueError(f"time cannot run backwards: {seconds} s")
        rest_ns = round(seconds * NS_PER_S)
        while rest_ns >= self._left_ns:
            rest_ns -= self._left_ns
            if self._is_holding:
                self._start_cycle()
            else:
                self._complete_sample()
        self._left_ns -= rest_ns

    def answer(self, pdu: bytes) -> bytes | None:
        """Answer a request PDU; None when the device stays silent (after a reset)."""
        functions = {
            READ_REGISTERS: self._read,
            WRITE_REGISTER: self._write_one,
            WRITE_REGISTERS: self._write_many,
        }
        function = functions.get(pdu[0])
        if function is None:
            return bytes((pdu[0] | 0x80, ILLEGAL_FUNCTION))
        try:
            return function(pdu)
        except _RefusedError as refused:
            return bytes((pdu[0] | 0x80, refused.exception_code))

    def _start_cycle(self) -> None:
        self._is_holding = False
        self._period_s = roc_settings.seconds(self._settings[roc_settings.SAMPLE_PERIOD])
        self._hold_s = roc_settings.seconds(self._settings[roc_settings.HOLD_PERIOD])
        self._left_ns = self._period_s * NS_PER_S

    def _complete_sample(self) -> None:
        measurement = self._fluid.measure(
            elapsed_s=self._unaged_s + self._period_s, period_s=self._period_s
        )
        sample = RocSample.of(measurement, period_s=self._period_s, settings=self._settings)
        self._sample = sample.words(is_high_word_first=self._is_high_word_first)
        self._samples += 1
        self._is_holding = True
        self._left_ns = self._hold_s * NS_PER_S
        self._unaged_s = self._hold_s
        self._write_truth(sample.truth_row(self._samples))

    def _write_truth(self, line: str) -> None:
        if self._truth is not None:
            self._truth.write(line + "\n")
            self._truth.flush()

    def _read(self, pdu: bytes) -> bytes:
        address, count = _two_words(pdu)
        if not 1 <= count <= MOST_READ or len(pdu) != SHORT_REQUEST:
            raise _RefusedError(ILLEGAL_DATA_VALUE)
        readable = self._identity | self._settings | self._sample
        try:
            words = [readable[each] for each in range(address, address + count)]
        except KeyError:
            raise _RefusedError(ILLEGAL_DATA_ADDRESS) from None
        return bytes((READ_REGISTERS, 2 * count)) + _octets(words)

    def _write_one(self, pdu: bytes) -> bytes | None:
        address, word = _two_words(pdu)
        if len(pdu) != SHORT_REQUEST:
            raise _RefusedError(ILLEGAL_DATA_VALUE)
        return pdu if self._write(address, [word]) else None

    def _write_many(self, pdu: bytes) -> bytes | None:
        address, count = _two_words(pdu)
        size, body = pdu[SHORT_REQUEST:][:1], pdu[SHORT_REQUEST + 1 :]
        if not 1 <= count <= MOST_WRITTEN or size != bytes((2 * count,)) or len(body) != 2 * count:
            raise _RefusedError(ILLEGAL_DATA_VALUE)
        words = [int.from_bytes(body[at : at + 2], "big") for at in range(0, len(body), 2)]
        return pdu[:SHORT_REQUEST] if self._write(address, words) else None

    def _write(self, address: int, words: Sequence[int]) -> bool:
        """Write all words or none; tell whether the device answers."""
        new = dict(enumerate(words, start=address))
        if any(each not in _WRITABLE for each in new):
            raise _RefusedError(ILLEGAL_DATA_ADDRESS)
        settings = self._settings | {each: new[each] for each in new if each in self._settings}
        for each, word in new.items():
            key = _KEYS.get(each)
            is_valid = roc_settings.is_writable(each, settings) if key is None else word == key
            if not is_valid:
                raise _RefusedError(ILLEGAL_DATA_VALUE)
        self._settings = settings
        if NEW_DATA in new:
            self._sample[NEW_DATA] = 0
        if RESET in new:
            self._reset()
            return False
        if SAVE in new:
            self._saved = dict(settings)
        return True

    def _reset(self) -> None:
        self._settings = dict(self._saved)
        self._unit = self._settings[roc_settings.NODE_ID]
        self._sample = dict.fromkeys(SAMPLE_BLOCK, 0)
        self._start_cycle()


_KEYS: Final = {NEW_DATA: 0, RESET: RESET_KEY, SAVE: SAVE_KEY}
_WRITABLE: Final = frozenset(_KEYS).union(roc_settings.ADDRESSES)


def _two_words(pdu: bytes) -> tuple[int, int]:
    """Give the two words behind the function code: the address, and a count or a value."""
    if len(pdu) < SHORT_REQUEST:
        raise _RefusedError(ILLEGAL_DATA_VALUE)
    return int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big")


def _octets(words: Sequence[int]) -> bytes:
    return b"".join(word.to_bytes(2, "big") for word in words)


def _identity_words(serial_number: str) -> dict[int, int]:
    """Give registers 0-47; texts have two characters to a register, the upper octet first."""
    words = dict.fromkeys(range(48), 0)
    texts = {0: "HIAC", 15: "ROC", 25: serial_number, 30: "HIAC ROC", 41: "2089263-1 RevC"}
    for address, text in texts.items():
        octets = text.encode("ascii")
        octets += bytes(len(octets) % 2)
        for at in range(0, len(octets), 2):
            words[address + at // 2] = int.from_bytes(octets[at : at + 2], "big")
    words[38] = 104  # firmware V1.04
    words[39] = 100  # hardware V1.00
    return words

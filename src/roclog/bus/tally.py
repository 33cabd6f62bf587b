"""Counts of what happened on the wire, one for each device."""

from __future__ import annotations

from dataclasses import dataclass, field

from roclog.errors import GATEWAY_CODES


@dataclass(slots=True)
class Tally:
    """Counters since the last ``LINK`` message; times in nanoseconds.

    requests: handed to the line. Each ends as one of answers, exceptions, wrong_answers, a time-out
    without a late answer, or a lost link.
    timeouts: no whole answer in time, late answers included.
    late_answers: came after their time-out; on RTU still used, else dropped by their number, as are
    copies of an answer.
    crc_errors: time-outs of RTU in which something unreadable had come.
    wrong_answers: whole frames that do not answer the request.
    discarded_octets: on RTU beside answers and echoes; on UDP, datagrams that are no answer.
    link_losses: links that went away or could not be opened.
    polls: attempts on schedule. skipped: those left out, since the one before was late by more than
    a period.
    frame_errors, parity_errors, overruns, breaks: as the serial port counted them; on a shared line
    those that came while this device was asked.
    busy: from the request until the line was free again.
    refusals: exceptions that are the device's own, and not a gateway's.
    """

    requests: int = 0
    answers: int = 0
    timeouts: int = 0
    late_answers: int = 0
    crc_errors: int = 0
    wrong_answers: int = 0
    discarded_octets: int = 0
    link_losses: int = 0
    round_trip_sum: int = 0
    round_trip_max: int = 0
    busy: int = 0
    polls: int = 0
    skipped: int = 0
    frame_errors: int = 0
    parity_errors: int = 0
    overruns: int = 0
    breaks: int = 0
    exceptions: dict[int, int] = field(default_factory=dict)
    refusals: int = 0

    @property
    def heard(self) -> int:
        """How often the device itself was heard."""
        return self.answers + self.refusals

    def reset(self) -> None:
        """Begin to count anew."""
        self.__init__()  # type: ignore[misc]

    def count_exception(self, code: int) -> None:
        self.exceptions[code] = self.exceptions.get(code, 0) + 1
        self.refusals += code not in GATEWAY_CODES

    def count_answer(self, round_trip: int) -> None:
        self.answers += 1
        self.round_trip_sum += round_trip
        self.round_trip_max = max(self.round_trip_max, round_trip)

"""The count of missed samples and the timing guard, against a simulated device that is known."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil
from random import Random
from typing import Self

import pytest

from roclog.cadence import TOLERANCE, Cadence, Missed

SECOND = 10**9
CYCLE = 15 * SECOND
SEEDS = range(100)


@dataclass
class Run:
    """A logger that reads a device, and what the cadence said about it.

    done: when each sample was complete. shown: indices of the samples that reads showed.
    """

    done: list[int]
    cadence: Cadence
    quiet_at_first: bool = False
    shown: list[int] = field(default_factory=list)
    told: list[Missed] = field(default_factory=list)

    def read(self, asked_at: int, latched_at: int, read_at: int) -> None:
        """One read; the device copies its block into the answer at ``latched_at``."""
        latest = sum(moment <= latched_at for moment in self.done) - 1
        if not self.shown and (self.quiet_at_first or latest < 0):
            self.shown.append(latest)  # the baseline, or nothing yet: what was before is not ours
            missed = self.cadence.quiet(asked_at)
        elif latest not in self.shown:
            self._check_guard(latest)
            missed = self.cadence.completed(asked_at, read_at)
            self.shown.append(latest)
        else:
            missed = self.cadence.quiet(asked_at)
        if missed is not None:
            self.told.append(missed)
        self._check_guard(latest)

    def _check_guard(self, latest: int) -> None:
        """Where the last sample shown is still the latest, nothing completes before the guard ends.

        It must hold at every instant at which the caller may ask, that is between two reads.
        """
        until = self.cadence.guarded_until()
        if until is None or not self.shown or self.shown[-1] + 1 >= len(self.done):
            return
        assert until <= self.done[self.shown[-1] + 1]

    def close(self) -> Self:
        missed = self.cadence.close()
        if missed is not None:
            self.told.append(missed)
        return self

    def missed(self) -> list[int]:
        skipped = [range(left + 1, right) for left, right in pairwise(self.shown)]
        return [self.done[index] for gap in skipped for index in gap]

    def check(self) -> None:
        """Every missed sample is in a reported interval, and no interval promises too much."""
        missed = self.missed()
        for moment in missed:
            assert any(r.after < moment <= r.before for r in self.told), f"{moment} is not told"
        for report in self.told:
            inside = sum(report.after < moment <= report.before for moment in missed)
            assert report.possible or report.count <= inside, f"{report} has {inside}"
        certain = sum(report.count for report in self.told if not report.possible)
        assert certain <= len(missed) <= sum(report.count for report in self.told)


def grid(
    random: Random, *, drift: float = 0.004, jitter: float = 0.0, until: int = 900
) -> list[int]:
    """Completions of a device that is off by ``drift`` at most, on a clock that is not at zero."""
    cycle = CYCLE * (1 + random.uniform(-drift, drift))
    start = 10**15 + random.uniform(0, cycle)
    off = (random.uniform(-jitter, jitter) * CYCLE for _ in range(until))
    return [int(start + k * cycle + next(off)) for k in range(until * SECOND // CYCLE)]


def play(
    run: Run, random: Random, *, poll: int, outages: float, longest: float, late: float = 0.1
) -> Run:
    """Reads every ``poll`` ns or so; some answers are late; ``outages`` is a chance per read."""
    now = run.done[0] - random.randrange(CYCLE) * (not run.quiet_at_first)
    while now < run.done[-1] - 4 * CYCLE:
        latched_at, read_at = _transaction(now, random, late)
        run.read(now, latched_at, read_at)
        now = max(read_at, now + int(poll * random.uniform(0.7, 1.3)))
        if random.random() < outages:
            now += int(random.uniform(0, longest) * CYCLE)
    while now < run.done[-1]:  # a calm end, in which what was undecided is decided
        run.read(now, *_transaction(now, random, 0.0))
        now += min(poll, SECOND)
    return run.close()


def _transaction(asked_at: int, random: Random, late: float) -> tuple[int, int]:
    delay = random.randrange(SECOND // 100, SECOND // 20)
    if random.random() < late:
        delay += random.randrange(2 * SECOND)
    return asked_at + random.randrange(delay), asked_at + delay


@pytest.mark.parametrize("quiet_at_first", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_frequent_polls_count_every_missed_sample(seed: int, quiet_at_first: bool) -> None:
    random = Random(seed)
    run = Run(grid(random), Cadence(CYCLE), quiet_at_first)
    play(run, random, poll=SECOND, outages=0.01, longest=15)
    run.check()
    if not any(report.possible for report in run.told):
        assert sum(report.count for report in run.told) == len(run.missed())


@pytest.mark.parametrize("seed", SEEDS)
def test_polls_as_rare_as_samples(seed: int) -> None:
    random = Random(seed)
    run = Run(grid(random), Cadence(CYCLE))
    poll = int(CYCLE * random.uniform(0.3, 3.0))
    play(run, random, poll=poll, outages=0.02, longest=5).check()


@pytest.mark.parametrize("seed", SEEDS)
def test_jitter_within_tolerance(seed: int) -> None:
    random = Random(seed)
    run = Run(grid(random, drift=0.002, jitter=0.0035), Cadence(CYCLE))
    play(run, random, poll=SECOND, outages=0.02, longest=10).check()


@pytest.mark.parametrize("seed", SEEDS)
def test_without_outages_nothing_is_missed_and_most_clears_are_guarded(seed: int) -> None:
    random = Random(seed)
    run = Run(grid(random), Cadence(CYCLE))
    play(run, random, poll=SECOND, outages=0, longest=0, late=0.02).check()
    assert not run.told
    until = run.cadence.guarded_until()
    assert until is not None
    assert until - run.done[run.shown[-1]] > 0.8 * CYCLE


@pytest.mark.parametrize("seed", range(30))
def test_a_long_outage_is_an_estimate(seed: int) -> None:
    random = Random(seed)
    run = Run(grid(random, until=9000), Cadence(CYCLE))
    away = random.randrange(60, 400)
    leaves = run.done[50] + random.randrange(CYCLE)
    for now in range(run.done[0], leaves, SECOND):
        run.read(now, now + 1, now + 2)
    for now in range(leaves + away * CYCLE, leaves + (away + 20) * CYCLE, SECOND):
        run.read(now, now + 1, now + 2)
    missed = run.missed()
    assert len(run.told) == 1
    report = run.told[0]
    assert all(report.after < moment <= report.before for moment in missed)
    assert abs(report.count - len(missed)) <= 2 + 0.005 * away


@pytest.mark.parametrize("wait", [0.001, 0.5, 0.999, 7.3])
def test_a_sample_that_waited_at_the_start_is_no_gap(wait: float) -> None:
    """How long it waited is not known: no clear is guarded until a completion has been seen."""
    cadence = Cadence(CYCLE)
    done = 10**15
    asked_at = done + int(wait * CYCLE)
    assert cadence.completed(asked_at, asked_at + SECOND // 50) is None
    until = cadence.guarded_until()
    assert until is not None
    assert until < asked_at
    assert cadence.close() is None


def test_reads_that_span_the_completion() -> None:
    """The answer may show either state; both are right."""
    for shows in (True, False):
        run = Run([10**15 + k * CYCLE for k in range(10)], Cadence(CYCLE))
        for moment in run.done[:-2]:
            poll_every(run, moment - 4 * SECOND, moment - 2 * SECOND)
            asked_at, read_at = moment - SECOND, moment + SECOND
            run.read(asked_at, read_at - 1 if shows else asked_at + 1, read_at)
            run.read(read_at + 1, read_at + 2, read_at + 3)
        run.close().check()
        assert not run.told


def poll_every(run: Run, start: int, end: int, step: int = SECOND) -> None:
    for now in range(start, end, step):
        run.read(now, now + SECOND // 50, now + SECOND // 25)


@pytest.mark.parametrize("early", [0.02, 0.2, 0.5, 0.8, 0.97])
def test_one_early_sample_then_back_on_the_grid(early: float) -> None:
    start = 10**15
    done = [start + k * CYCLE for k in range(40)]
    done.insert(21, done[21] - int(early * CYCLE))
    if early < 0.5:
        del done[22]  # completed early, not in addition
    cadence = Cadence(CYCLE)
    for now in range(start, done[-1], SECOND):
        latest = [moment for moment in done if now - SECOND < moment <= now]
        missed = cadence.completed(now, now + 1) if latest else cadence.quiet(now)
        assert missed is None
    assert cadence.close() is None


def test_the_guard_learns_from_an_early_sample() -> None:
    cadence = Cadence(CYCLE)
    start = 10**15
    for moment in (0, 15, 22, 30, 45):
        at = start + moment * SECOND
        cadence.quiet(at - SECOND // 2)
        cadence.completed(at, at + 1)
    until = cadence.guarded_until()
    assert until is not None
    assert until - (start + 45 * SECOND) < 7 * SECOND


@pytest.mark.parametrize("seed", SEEDS)
def test_an_irregular_device_gives_no_false_miss_when_read_often(seed: int) -> None:
    random = Random(seed)
    cadence = Cadence(CYCLE)
    now = 10**15
    following = now + random.randrange(CYCLE)
    for _ in range(2000):
        now += random.randrange(SECOND, 2 * SECOND)
        if following <= now:
            missed = cadence.completed(now, now + SECOND // 20)
            following = now + int(random.choice([0.2, 0.9, 1, 1, 1.05, 3]) * CYCLE)
        else:
            missed = cadence.quiet(now)
        assert missed is None
    assert cadence.close() is None


@pytest.mark.parametrize("seed", range(40))
def test_a_device_twice_as_fast_as_configured(seed: int) -> None:
    """No false miss, and the guard shortens once the first spacing has been seen."""
    random = Random(seed)
    true = int(CYCLE / 2 * random.uniform(0.996, 1.004))
    done = [10**15 + random.randrange(CYCLE) + k * true for k in range(1)]
    done += [done[0] + k * true for k in range(1, 60)]
    cadence = Cadence(CYCLE)
    seen = -1
    for now in range(done[0] - CYCLE, done[-1], SECOND):
        latest = sum(moment <= now for moment in done) - 1
        missed = cadence.completed(now, now + 1) if latest > seen else cadence.quiet(now)
        assert missed is None
        seen = latest
        until = cadence.guarded_until()
        if seen >= 1 and until is not None and seen + 1 < len(done):
            assert until <= done[seen + 1]
    assert cadence.effective_cycle is not None
    assert abs(cadence.effective_cycle - true) <= SECOND
    assert cadence.close() is None


@pytest.mark.parametrize("seed", range(40))
def test_a_device_slower_than_configured(seed: int) -> None:
    """3 % are within what the polls can see: no false miss, and an outage is still told."""
    random = Random(seed)
    true = int(CYCLE * 1.03)
    start = 10**15 + random.randrange(CYCLE)
    run = Run([start + k * true for k in range(60)], Cadence(CYCLE))
    poll_every(run, start, run.done[30] + random.randrange(true))
    assert not run.told
    back = run.done[36] + random.randrange(true)
    poll_every(run, back, run.done[-2])
    missed = run.close().missed()
    for moment in missed:
        assert any(report.after < moment <= report.before for report in run.told)
    assert abs(sum(report.count for report in run.told) - len(missed)) <= 1


def test_a_pause_does_not_lengthen_the_guard() -> None:
    cadence = Cadence(CYCLE)
    start = 10**15
    for k in range(10):
        at = start + 3 * k * CYCLE
        cadence.quiet(at - SECOND)
        cadence.completed(at, at + 1)
    assert cadence.effective_cycle is not None
    assert cadence.effective_cycle > 2 * CYCLE
    until = cadence.guarded_until()
    assert until is not None
    assert until < start + 27 * CYCLE + CYCLE


def test_an_undecided_count_is_told_soon() -> None:
    """The spell ends right at a completion, before the phase is known: told, but not for ever."""
    undecided = 0
    for seed in SEEDS:
        random = Random(seed)
        run = Run(grid(random, until=1800), Cadence(CYCLE), quiet_at_first=True)
        play(run, random, poll=SECOND, outages=0.01, longest=15).check()
        undecided += sum(report.possible for report in run.told)
        assert all(report.before - report.after < 60 * CYCLE for report in run.told)
    assert undecided > 0


def test_overdue_half_a_cycle_late() -> None:
    cadence = Cadence(CYCLE)
    start = 10**15
    assert not cadence.overdue(start)
    cadence.quiet(start - SECOND)
    cadence.completed(start, start + SECOND)
    assert cadence.last_completed == start + SECOND
    assert not cadence.overdue(start + SECOND + ceil(1.5 * CYCLE))
    assert cadence.overdue(start + SECOND + ceil(1.5 * CYCLE) + 1)


def test_without_a_cycle_nothing_is_counted_or_guarded() -> None:
    cadence = Cadence(None)
    for moment in range(10**15, 10**15 + 100 * CYCLE, 10 * CYCLE):
        assert cadence.quiet(moment) is None
        assert cadence.completed(moment + 1, moment + 2) is None
    assert cadence.guarded_until() is None
    assert cadence.effective_cycle is None
    assert not cadence.overdue(10**18)
    assert cadence.close() is None


def test_what_is_undecided_is_told_at_the_end() -> None:
    """Blind for one cycle and a bit: a second completion may or may not have been inside."""
    cadence = Cadence(CYCLE)
    cadence.quiet(10**15)
    blind = 10**15 + int(1.2 * CYCLE)
    assert cadence.completed(blind, blind + 1) is None
    assert cadence.close() == Missed(10**15, blind + 1, 1, possible=True)


def test_what_is_undecided_is_told_when_the_device_restarts() -> None:
    cadence = Cadence(CYCLE)
    cadence.quiet(10**15)
    blind = 10**15 + int(1.2 * CYCLE)
    cadence.completed(blind, blind + 1)
    assert cadence.forget() == Missed(10**15, blind + 1, 1, possible=True)
    assert cadence.guarded_until() is None
    assert cadence.completed(blind + 9 * CYCLE, blind + 9 * CYCLE + 1) is None


def test_two_completions_do_not_fit_into_less_than_a_cycle() -> None:
    cadence = Cadence(CYCLE)
    cadence.quiet(10**15)
    cadence.completed(10**15 + SECOND, 10**15 + SECOND)
    cadence.quiet(10**15 + CYCLE - SECOND)
    blind = 10**15 + CYCLE - SECOND + int(CYCLE * (1 - 2 * TOLERANCE))
    assert cadence.completed(blind - 1, blind) is None
    assert cadence.close() is None

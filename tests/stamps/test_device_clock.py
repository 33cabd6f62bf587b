"""A device's clock beside the host's, with a simulated truth that the tracker never sees."""

from __future__ import annotations

import random

import pytest

from roclog.clock import Instant
from roclog.device_clock import MAX_DRIFT_PPM, ClockEvent, ClockFact, DeviceClock

SECOND = 10**9
MS = 10**6
START = 1_790_000_000 * SECOND
BOOT = 5_000 * SECOND


class World:
    """True time since the start in ns; host and device clocks as functions of it."""

    def __init__(self, *, offset: int = 0, ppm: float = 0, seed: int = 1) -> None:
        self.now = 0
        self.host_step = 0
        self.device = START + offset
        self.ppm = ppm
        self.running = True
        self.faulty = False
        self.rng = random.Random(seed)
        self.clock = DeviceClock()
        self.facts: list[ClockFact] = []
        self.read: Instant = self.instant()

    def instant(self) -> Instant:
        return Instant(START + self.now + self.host_step, BOOT + self.now)

    def wait(self, nanoseconds: int) -> None:
        self.now += nanoseconds
        if self.running:
            self.device += round(nanoseconds * (1 + self.ppm / 10**6))

    def clock_read(self, round_trip: int = 40 * MS) -> None:
        """The device reads its clock anywhere between request and answer."""
        asked = self.instant()
        part = self.rng.randrange(round_trip)
        self.wait(part)
        device = self.device
        self.wait(round_trip - part)
        self.facts += self.clock.note(device, asked, self.instant())
        self.check()

    def change(self, poll: int) -> None:
        """An input changes between two reads; the stamp has milliseconds only."""
        part = self.rng.randrange(poll)
        self.wait(part)
        device = self.device // MS * MS
        self.wait(poll - part)
        before, self.read = self.read, self.instant()
        self.facts += self.clock.note(device, before, self.read)

    def check(self, *, slack: int = 0) -> None:
        """The truth lies inside what the tracker says, unless the clock was just meddled with."""
        if self.faulty:
            return
        found = self.clock.offset(self.instant())
        assert found is not None
        truth = self.device - self.instant().utc
        assert abs(truth - found.offset) <= found.uncertainty + slack
        if found.drift is not None and found.drift_uncertainty is not None:
            assert abs(found.drift - self.ppm) <= found.drift_uncertainty

    @property
    def events(self) -> list[ClockEvent]:
        return [fact.event for fact in self.facts]


def test_nothing_known_at_first() -> None:
    assert DeviceClock().offset(Instant(START, BOOT)) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("ppm", [-150, -40, 0, 1.5, 90, 199])
def test_clock_reads_bound_the_offset(ppm: float, seed: int) -> None:
    world = World(offset=-3_725 * SECOND, ppm=ppm, seed=seed)
    for _ in range(400):
        world.clock_read()
        world.wait(60 * SECOND)
    assert not world.facts
    found = world.clock.offset(world.instant())
    assert found is not None
    assert found.uncertainty < 60 * MS, "the round trip and a minute's drift at most"
    assert found.drift is not None
    assert abs(found.drift - ppm) < 5


@pytest.mark.parametrize("seed", range(5))
def test_changes_bound_the_offset(seed: int) -> None:
    """Each change is only known to be between two reads, yet many of them narrow it down."""
    world = World(offset=7 * SECOND, ppm=30, seed=seed)
    for _ in range(3_000):
        world.change(SECOND)
        world.check(slack=MS)
    assert not world.facts
    found = world.clock.offset(world.instant())
    assert found is not None
    assert found.uncertainty < 100 * MS
    assert abs(found.offset - 7 * SECOND) < SECOND


def test_uncertainty_grows_while_nothing_is_heard() -> None:
    world = World()
    world.clock_read()
    before = world.clock.offset(world.instant())
    world.wait(86_400 * SECOND)
    after = world.clock.offset(world.instant())
    assert before is not None
    assert after is not None
    grown = after.uncertainty - before.uncertainty
    assert abs(grown - 86_400 * SECOND * MAX_DRIFT_PPM // 10**6) <= 1
    world.check()


def test_a_step_of_the_hosts_clock_is_not_the_devices() -> None:
    world = World(offset=2 * SECOND)
    for _ in range(10):
        world.clock_read()
        world.wait(10 * SECOND)
    world.host_step = 3_600 * SECOND
    for _ in range(10):
        world.clock_read()
        world.wait(10 * SECOND)
    assert not world.facts
    found = world.clock.offset(world.instant())
    assert found is not None
    assert abs(found.offset - (2 - 3_600) * SECOND) < SECOND


@pytest.mark.parametrize("step", [-3_600 * SECOND, -200 * MS, 200 * MS, 86_400 * SECOND])
def test_a_clock_that_is_set(step: int) -> None:
    world = World()
    for _ in range(30):
        world.clock_read()
        world.wait(20 * SECOND)
    world.device += step
    world.faulty = True
    world.clock_read()
    assert not world.facts, "one stamp may be a stray"
    for _ in range(200):
        world.wait(20 * SECOND)
        world.clock_read()
    assert world.events == [ClockEvent.STEPPED]
    assert abs(world.facts[0].amount - step) < 60 * MS
    assert ("forward" if step > 0 else "back") in world.facts[0].text
    world.faulty = False
    world.check()


def test_a_stray_stamp_changes_nothing() -> None:
    world = World()
    for n in range(300):
        world.clock_read()
        world.wait(20 * SECOND)
        if n % 7 == 3:
            stray = START + world.rng.randrange(10**6) * SECOND
            assert not world.clock.note(stray, world.instant(), world.instant())
    assert not world.facts
    world.check()


def test_a_clock_that_stands_still_and_runs_again() -> None:
    world = World()
    for _ in range(30):
        world.clock_read()
        world.wait(5 * SECOND)
    world.running = False
    world.faulty = True
    world.clock_read()
    assert not world.facts
    for _ in range(20):
        world.wait(5 * SECOND)
        world.clock_read()
    assert world.events == [ClockEvent.STANDS_STILL]
    world.running = True
    for _ in range(20):
        world.wait(5 * SECOND)
        world.clock_read()
    assert world.events[:2] == [ClockEvent.STANDS_STILL, ClockEvent.STEADY]
    assert set(world.events[2:]) <= {ClockEvent.STEPPED}
    assert len(world.events) <= 3
    world.faulty = False
    world.check()


def test_stamps_of_the_same_moment_are_no_standstill() -> None:
    """Twenty inputs switched by one event, and nothing for a day."""
    world = World()
    for _ in range(50):
        world.change(SECOND)
        for _ in range(20):
            world.facts += world.clock.note(world.device // MS * MS, world.read, world.read)
        world.wait(86_400 * SECOND)
        world.read = world.instant()
    assert not world.facts


@pytest.mark.parametrize("ppm", [-900_000, -2_000, -500, 500, 2_000, 10**6])
def test_a_clock_that_runs_away(ppm: float) -> None:
    world = World()
    for _ in range(60):
        world.clock_read()
        world.wait(30 * SECOND)
    world.ppm = ppm
    world.faulty = True
    for _ in range(300):
        world.clock_read()
        world.wait(30 * SECOND)
    assert ClockEvent.RUNS_AWAY in world.events or (
        ppm == -900_000 and ClockEvent.STANDS_STILL in world.events
    )
    assert world.events.count(ClockEvent.RUNS_AWAY) <= 1
    assert len(world.events) <= 6, "said once, not at every read"
    away = [fact for fact in world.facts if fact.event is ClockEvent.RUNS_AWAY]
    for fact in away:
        assert 0 < fact.amount / ppm <= 1.001
        assert ("gains" if ppm > 0 else "loses") in fact.text
    world.ppm = 0
    for _ in range(300):
        world.clock_read()
        world.wait(30 * SECOND)
    assert ClockEvent.STEADY in world.events
    world.facts.clear()
    for _ in range(50):
        world.clock_read()
        world.wait(30 * SECOND)
    assert not world.facts


def test_two_corrections_are_no_runaway() -> None:
    world = World()
    for n in range(300):
        world.clock_read()
        world.wait(20 * SECOND)
        if n in {100, 103}:
            world.faulty = True
            world.device += (3_600 if n == 100 else 5) * SECOND
    assert ClockEvent.RUNS_AWAY not in world.events
    assert world.events.count(ClockEvent.STEPPED) == 2
    world.faulty = False
    world.check()


def test_stamps_that_fit_before_and_after_do_not_hide_a_step() -> None:
    """Most inputs are read seldom, so that their changes say little."""
    world = World()
    for n in range(100):
        world.clock_read()
        before = world.instant()
        world.wait(10 * SECOND)
        world.facts += world.clock.note(world.device - 5 * SECOND, before, world.instant())
        if n == 50:
            world.faulty = True
            world.device += 200 * MS
    assert world.events == [ClockEvent.STEPPED]
    world.faulty = False
    world.check()


def test_changes_show_a_clock_that_runs_away() -> None:
    world = World(ppm=5_000)
    for _ in range(7_200):
        world.change(SECOND)
    assert ClockEvent.RUNS_AWAY in world.events


def test_wrong_arguments() -> None:
    early, late = Instant(START, BOOT), Instant(START, BOOT + 1)
    with pytest.raises(ValueError, match="without device time"):
        DeviceClock().note(0, early, late)
    with pytest.raises(ValueError, match="before its earliest"):
        DeviceClock().note(START, late, early)

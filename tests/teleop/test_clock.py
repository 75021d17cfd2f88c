"""The clock and the grid, on simulated time."""

import gc
import itertools
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.errors import TeleopError
from teleop.runtime import clock
from teleop.runtime.clock import EventClock, Grid, SuspensionWatch, now_ns, pause_garbage_collection

MS = 1_000_000


class World:
    """A clock that stands still unless someone sleeps or works; sleeping overshoots."""

    def __init__(self, overshoot_ns=0):
        self.now_ns = 1_000 * MS
        self.overshoot_ns = overshoot_ns

    def now(self):
        return self.now_ns

    def sleep(self, seconds):
        self.now_ns += round(seconds * 1e9) + self.overshoot_ns


def run(world, work_ns, rate_hz=1000.0, phase=0.0):
    """Run one tick for each entry of `work_ns`, which is how long it takes."""
    left = list(work_ns)
    grid = Grid(rate_hz, lambda: not left, phase, world.now, world.sleep)
    ticks, begun = [], []
    for tick in grid:
        ticks.append(tick)
        begun.append(world.now_ns)
        world.now_ns += left.pop(0)
    return grid, ticks, begun


def test_stamps_never_go_back_and_name_the_date():
    stamps = [now_ns() for _ in range(1000)]
    assert stamps == sorted(stamps)
    assert abs(stamps[-1] - time.time_ns()) < 60e9


def test_oversleeping_does_not_add_up():
    world = World(overshoot_ns=80_000)
    grid, ticks, begun = run(world, [300_000] * 1000)
    assert begun[-1] - begun[0] == pytest.approx(999 * MS, abs=MS)
    assert grid.stats.overruns == 0
    assert grid.stats.lateness_max_ns == 80_000
    assert grid.stats.rate_hz == pytest.approx(1000, rel=1e-3)
    assert [t.index for t in ticks] == list(range(1000))
    assert all(t.dt == pytest.approx(0.001) for t in ticks)


def test_an_overrun_skips_whole_periods_and_never_catches_up_in_a_burst():
    world = World()
    work = [300_000] * 10 + [5_600_000] + [300_000] * 10
    grid, ticks, begun = run(world, work)
    assert grid.stats.overruns == 5
    assert [t.index for t in ticks] == [*range(11), *range(16, 26)]
    assert ticks[11].dt == pytest.approx(0.006)
    assert ticks[12].dt == pytest.approx(0.001)
    gaps = [b - a for a, b in itertools.pairwise(begun)]
    assert min(gaps) >= MS


@given(st.lists(st.integers(0, 12 * MS), min_size=2, max_size=80), st.integers(0, 3 * MS))
def test_ticks_stay_on_the_grid_and_dt_adds_up_to_the_time_passed(work, overshoot):
    world = World(overshoot)
    start = world.now_ns
    grid, ticks, begun = run(world, work)
    for tick, begin in zip(ticks, begun, strict=True):
        assert tick.stamp_ns == begin + clock._ANCHOR_NS
        assert begin >= start + tick.index * MS
    assert len(ticks) + grid.stats.overruns >= ticks[-1].index + 1
    passed = sum(t.dt for t in ticks[1:])
    assert passed == pytest.approx((ticks[-1].index - ticks[0].index) * 1e-3, rel=1e-9)
    assert grid.stats.ticks == len(work)


@given(st.integers(0, 10**18), st.sampled_from([0.0, 0.25, 0.5]))
def test_grids_of_one_rate_keep_their_distance_whenever_they_start(start, phase):
    world = World()
    world.now_ns = start
    _, _, begun = run(world, [100_000] * 5, phase=phase)
    assert {begin % MS for begin in begun} == {round(phase * MS)}
    assert begun[0] - start < MS


@pytest.mark.real_time
def test_grids_agree_although_the_system_clock_was_stepped_between_their_starts(monkeypatch):
    phases = []
    for anchor_ns in (0, 300 * MS, 10**18 + 700 * MS):
        monkeypatch.setattr(clock, "_ANCHOR_NS", anchor_ns)
        targets = []
        grid = Grid(
            1.0,
            stop=lambda targets=targets: bool(targets),
            sleep=lambda s, targets=targets: targets.append(time.monotonic_ns() + round(s * 1e9)),
        )
        before = now_ns()
        (tick,) = grid
        assert before <= tick.stamp_ns <= now_ns()  # and the stamp names the date
        phases.append(targets[0] % (1000 * MS) * 1e-9)
    assert all(min(phase, 1.0 - phase) < 0.1 for phase in phases)  # 0.3 and 0.7 by the date


def test_the_collector_is_quiet_inside_and_back_outside_even_after_an_error():
    def loop():
        with pause_garbage_collection():
            assert not gc.isenabled()
            assert gc.get_freeze_count() > 0
            raise KeyError

    gc.unfreeze()
    for frozen in (False, True):
        with pytest.raises(KeyError):
            loop()
        assert gc.isenabled()
        assert (gc.get_freeze_count() > 0) == frozen
        gc.freeze()


def answered(arrivals_ns, until_ns, work_ns=100_000):
    """Run an event clock of 1 kHz over arrivals at these times; return when each tick began."""
    world, left, ticks = World(), sorted(arrivals_ns), []
    start = world.now_ns

    def wait(deadline):
        if left and start + left[0] <= max(deadline, world.now_ns):
            world.now_ns = max(world.now_ns, start + left[0])
            while left and start + left[0] <= world.now_ns:
                left.pop(0)
            return True
        world.now_ns = max(world.now_ns, deadline)
        return False

    events = EventClock(
        1000.0, lambda: world.now_ns >= start + until_ns, wait, world.now, world.sleep
    )
    for tick in events:
        ticks.append((world.now_ns - start, tick))
        world.now_ns += work_ns
    return events, ticks


def test_every_arrival_is_a_tick_at_once_however_it_jitters():
    arrivals = [k * MS + (k * 7919) % 400_000 for k in range(1, 500)]
    _, ticks = answered(arrivals, 500 * MS)
    begun = [at for at, tick in ticks if tick.answers]
    assert begun[1:] == arrivals[1:]  # the first came just behind a tick of the own rate
    assert sum(not tick.answers for _, tick in ticks) <= 3  # before the first, behind the last


def test_without_arrivals_it_keeps_its_own_rate():
    events, ticks = answered([], 1000 * MS)
    assert not any(tick.answers for _, tick in ticks)
    assert len(ticks) == pytest.approx(1000, abs=2)
    assert events.stats.overruns == 0


def test_a_missing_arrival_is_made_up_for_by_the_deadline():
    arrivals = [k * MS for k in range(1, 100) if k != 50]
    _, ticks = answered(arrivals, 99 * MS)
    (missed,) = [at for at, tick in ticks if not tick.answers and at > MS]
    assert missed == pytest.approx(50.5 * MS, abs=1)


@pytest.fixture
def suspend(monkeypatch):
    """Suspend the machine for a time [ns]: only the clock since it was switched on goes on."""
    read, suspended = time.clock_gettime_ns, [0]
    monkeypatch.setattr(time, "clock_gettime_ns", lambda clock: read(clock) + suspended[0])

    def suspend(for_ns):
        suspended[0] += for_ns

    return suspend


def test_a_suspension_is_told_once_and_being_held_up_is_none(suspend, monkeypatch):
    watch = SuspensionWatch()
    suspend(50 * MS)
    assert watch.explain() == ""
    suspend(37_160 * MS)
    assert watch.explain().startswith("the machine was suspended for 37.2 s: start or engage again")
    assert watch.explain() == ""
    monotonic = time.monotonic_ns
    monkeypatch.setattr(time, "monotonic_ns", lambda: monotonic() + 5_000 * MS)
    assert watch.explain() == ""
    monkeypatch.setattr(time, "monotonic_ns", monotonic)
    monkeypatch.delattr(time, "CLOCK_BOOTTIME")  # another system
    assert SuspensionWatch().explain() == ""


def test_no_tick_follows_a_suspension(suspend):
    world, ticks = World(), []

    def wait(deadline):
        world.now_ns = deadline
        if len(ticks) == 5:
            suspend(200 * MS)
        return False

    with pytest.raises(TeleopError, match=r"suspended for 0\.2 s"):
        ticks.extend(EventClock(1000.0, lambda: len(ticks) > 9, wait, world.now, world.sleep))
    assert len(ticks) == 5


@given(st.lists(st.integers(0, 20 * MS), max_size=300), st.integers(0, 3 * MS))
def test_ticks_are_never_nearer_than_half_a_period_and_tell_the_time(arrivals, work_ns):
    _, ticks = answered(arrivals, 30 * MS, work_ns)
    times = [at for at, _ in ticks]
    for before, (at, tick) in zip(times, ticks[1:], strict=False):
        assert at - before >= MS // 2
        assert tick.dt == pytest.approx((at - before) * 1e-9)
        assert at - before <= max(1.5 * MS, work_ns + MS)

"""The clock and the grid, on simulated time."""

import gc
import itertools
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import clock
from teleop.clock import Grid, Tick, now_ns, quiet_garbage

MS = 1_000_000


class World:
    """A clock that stands still unless someone sleeps or works; sleeping overshoots."""

    def __init__(self, overshoot_ns: int = 0) -> None:
        self.now_ns = 1_000 * MS
        self.overshoot_ns = overshoot_ns

    def now(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9) + self.overshoot_ns


def run(
    world: World, work_ns: list[int], rate_hz: float = 1000.0, phase: float = 0.0
) -> tuple[Grid, list[Tick], list[int]]:
    """Run one tick for each entry of `work_ns`, which is how long it takes."""
    left = list(work_ns)
    grid = Grid(rate_hz, lambda: not left, phase, world.now, world.sleep)
    ticks, begun = [], []
    for tick in grid:
        ticks.append(tick)
        begun.append(world.now_ns)
        world.now_ns += left.pop(0)
    return grid, ticks, begun


def test_stamps_never_go_back_and_name_the_date() -> None:
    stamps = [now_ns() for _ in range(1000)]
    assert stamps == sorted(stamps)
    assert abs(stamps[-1] - time.time_ns()) < 60e9


def test_oversleeping_does_not_add_up() -> None:
    world = World(overshoot_ns=80_000)
    grid, ticks, begun = run(world, [300_000] * 1000)
    assert begun[-1] - begun[0] == pytest.approx(999 * MS, abs=MS)
    assert grid.stats.overruns == 0
    assert grid.stats.lateness_max_ns == 80_000
    assert grid.stats.rate_hz == pytest.approx(1000, rel=1e-3)
    assert [t.index for t in ticks] == list(range(1000))
    assert all(t.dt == pytest.approx(0.001) for t in ticks)


def test_an_overrun_skips_whole_periods_and_never_catches_up_in_a_burst() -> None:
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
def test_ticks_stay_on_the_grid_and_dt_adds_up_to_the_time_passed(
    work: list[int], overshoot: int
) -> None:
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
def test_grids_of_one_rate_keep_their_distance_whenever_they_start(
    start: int, phase: float
) -> None:
    world = World()
    world.now_ns = start
    _, _, begun = run(world, [100_000] * 5, phase=phase)
    assert {begin % MS for begin in begun} == {round(phase * MS)}
    assert begun[0] - start < MS


def test_grids_agree_although_the_system_clock_was_stepped_between_their_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    phases = []
    for anchor_ns in (0, 300 * MS, 10**18 + 700 * MS):
        monkeypatch.setattr(clock, "_ANCHOR_NS", anchor_ns)
        targets: list[int] = []
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


def test_no_tick_after_stop() -> None:
    world = World()
    grid = Grid(1000, lambda: True, 0.0, world.now, world.sleep)
    assert list(grid) == []
    assert grid.stats.rate_hz == 0.0


def test_the_collector_is_quiet_inside_and_back_outside_even_after_an_error() -> None:
    def loop() -> None:
        with quiet_garbage():
            assert not gc.isenabled()
            assert gc.get_freeze_count() > 0
            raise KeyError

    with pytest.raises(KeyError):
        loop()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0

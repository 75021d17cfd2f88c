import math
from functools import partial
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.structs import to_struct
from master import gate
from master.gate import FADE_S, GateConfig, GateFlags
from teleop.messages.messages import MAX_JOINTS
from tests.anything import CASES, Anything
from tests.master.records import eight

ANY = st.floats(allow_nan=True, allow_infinity=True)
LIMITS = st.floats(1e-3, 1e3)
CONFIGS = st.builds(
    partial(GateConfig, exceed_bounds=True),
    axis_max=LIMITS,
    total_max=LIMITS,
    slew_max=st.floats(1e-3, 1e6),
)
ZERO = GateFlags.NOT_ENGAGED | GateFlags.STALE_STATE | GateFlags.NOT_FINITE


class Gated(NamedTuple):
    force: tuple[float, ...]
    verdict: int


def step(config, last, wanted, fresh, may_render, dt, is_force_fading=False, rest=()):
    """The gate with tuples; nothing is written beyond the axes."""
    axes, out = len(last), eight(*(9.0,) * MAX_JOINTS)
    assert len(wanted) == axes
    verdict = gate.step(
        to_struct(config),
        *(
            eight(*last),
            eight(*wanted),
            axes,
            fresh,
            may_render,
            dt,
            is_force_fading,
            eight(*rest),
            out,
        ),
    )
    assert (out[axes:] == 9.0).all()
    return Gated(tuple(out[:axes].tolist()), verdict)


def vectors(elements):
    return st.integers(1, 8).flatmap(lambda n: st.tuples(*[elements] * n))


@st.composite
def ticks(draw):
    """A run of ticks with anything in it."""
    axes = draw(st.integers(1, 8))
    wanted = st.tuples(*[ANY | st.floats(-5.0, 5.0)] * axes)
    dt = ANY | st.floats(1e-4, 1e-2)
    tick = st.tuples(wanted, st.booleans() | st.just(True), st.booleans() | st.just(True), dt)
    return axes, draw(st.lists(tick, min_size=1, max_size=20))


@given(vectors(st.floats(-2.0, 2.0)))
def test_within_limits_and_slow_passes_untouched(wanted):
    config = GateConfig(axis_max=2.0, total_max=20.0, slew_max=1.0)
    assert step(config, wanted, wanted, True, True, 0.001) == (wanted, GateFlags.PASSED)


@given(vectors(st.floats(-3.0, 3.0)), st.floats(0.0, 1.0))
def test_zero_is_reachable_at_once_and_so_is_anything_between(last, share):
    config = GateConfig(axis_max=3.0, total_max=20.0, slew_max=1e-3)
    wanted = tuple(share * f for f in last)
    assert step(config, last, wanted, True, True, 1e-3).force == wanted


def test_growth_follows_the_slew_limit_exactly():
    config = GateConfig(axis_max=3.0, total_max=3.0, slew_max=100.0)
    force, trace = (0.0,), []
    for _ in range(40):
        force, verdict = step(config, force, (2.0,), True, True, 0.001)
        trace.append((force[0], verdict))
    assert [f for f, _ in trace[:20]] == pytest.approx([0.1 * k for k in range(1, 21)])
    assert trace[10][1] == GateFlags.SLEW
    assert trace[-1] == (2.0, GateFlags.PASSED)


def test_a_reversal_passes_through_zero_first():
    config = GateConfig(slew_max=100.0)
    force, verdict = step(config, (2.0,), (-2.0,), True, True, 0.001)
    assert force == pytest.approx((-0.1,))
    assert verdict == GateFlags.SLEW


def test_a_skipped_second_does_not_buy_a_jump():
    config = GateConfig(slew_max=100.0)
    assert step(config, (0.0,), (2.0,), True, True, 1.0).force == pytest.approx((0.5,))


def test_total_limit_keeps_the_direction():
    config = GateConfig(axis_max=10.0, total_max=1.0, slew_max=5e3)
    force, verdict = step(config, (0.0, 0.0), (3.0, 4.0), True, True, 0.001)
    assert force == pytest.approx((0.6, 0.8))
    assert verdict == GateFlags.TOTAL_LIMIT


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=3), st.floats(1e-4, 0.01))
def test_a_force_that_fades_only_shrinks_and_is_gone_in_time(start, dt):
    config = GateConfig(total_max=10.0)
    force, passed = tuple(start), 0.0
    while passed < FADE_S - 1e-9:
        faded, verdict = step(config, force, force, False, False, dt, is_force_fading=True)
        assert verdict == GateFlags.NOT_ENGAGED | GateFlags.STALE_STATE
        for was, now in zip(force, faded, strict=True):
            assert now == 0.0 or (abs(now) < abs(was) and now * was > 0.0)
        force, passed = faded, passed + dt
    assert not any(abs(axis) > 1e-12 for axis in force)  # [N] steps of dt round


@pytest.mark.parametrize("dt", [0.0, -1.0, math.nan, math.inf])
def test_where_time_cannot_be_told_a_force_is_gone_at_once(dt):
    assert step(GateConfig(), (2.0,), (2.0,), False, False, dt, is_force_fading=True).force == (
        0.0,
    )


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_does_not_fade_but_is_gone_and_is_no_rest(bad):
    gated = step(GateConfig(), (2.0,), (bad,), True, False, 1e-3, is_force_fading=True)
    assert gated.force == (0.0,)
    gated = step(GateConfig(), (0.0,), (1.0,), True, False, 1e-3, rest=(bad,))
    assert gated.force == (0.0,)


@given(CONFIGS, ticks())
def test_the_output_may_take_the_place_of_what_was_written_last(config, run):
    axes, inputs = run
    last, rest = (0.0,) * axes, eight()
    for wanted, fresh, may_render, dt in inputs:
        gated = step(config, last, wanted, fresh, may_render, dt, True)
        both = eight(*last)
        verdict = gate.step(
            to_struct(config),
            *(both, eight(*wanted), axes, fresh, may_render, dt, True, rest, both),
        )
        assert (tuple(both[:axes].tolist()), verdict) == gated
        last = gated.force


@pytest.mark.parametrize("size", [1e300, 1.0, 1e-300])
@given(wanted=vectors(st.floats(-3.0, 3.0)))
def test_the_total_limit_holds_where_squares_overflow_or_vanish(size, wanted):
    config = GateConfig(
        axis_max=10.0 * size, total_max=2.0 * size, slew_max=100.0 * size, exceed_bounds=True
    )
    wanted = tuple(size * force for force in wanted)
    force, verdict = step(config, wanted, wanted, True, True, 1e-3)
    assert math.hypot(*force) <= 2.0 * size * (1 + 1e-12)
    if abs(math.hypot(*wanted) / size - 2.0) > 1e-9:
        assert bool(verdict & GateFlags.TOTAL_LIMIT) == (math.hypot(*wanted) > 2.0 * size)


def test_a_long_run_of_anything_stays_within_all_limits():
    """GATE_CASES of them; every output is finite, bounded, slewed, and zero if it has to be."""
    draw = Anything(seed=1)
    config = GateConfig(axis_max=2.0, total_max=2.5, slew_max=150.0)
    force = (0.0, 0.0)
    for _ in range(CASES):
        wanted = (draw.number(-6.0, 6.0), draw.number(-6.0, 6.0))
        fresh, may_render, is_force_fading = draw.flag(0.8), draw.flag(0.8), draw.flag(0.2)
        dt = draw.number(0.0, 0.01)
        after, _ = step(config, force, wanted, fresh, may_render, dt, is_force_fading)
        assert all(map(math.isfinite, after))
        assert all(abs(f) <= 2.0 for f in after)
        assert math.hypot(*after) <= 2.5 * (1 + 1e-12)
        growth = 150.0 * min(dt, 0.005) if dt > 0.0 else 0.0
        for was, now in zip(force, after, strict=True):
            assert now <= max(was, 0.0) + growth + 1e-12
            assert now >= min(was, 0.0) - growth - 1e-12
        if not (fresh and may_render and all(map(math.isfinite, wanted))):
            shrunk = is_force_fading and all(map(math.isfinite, wanted))
            for was, now in zip(force, after, strict=True):
                by = 2.0 * dt / FADE_S if 0.0 < dt < FADE_S else math.inf
                assert abs(now) <= max(abs(was) - by, 0.0) + 1e-12 if shrunk else now == 0.0
        force = after

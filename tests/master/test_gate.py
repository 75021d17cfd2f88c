import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master import gate
from master.gate import GateConfig, Verdict

ANY = st.floats(allow_nan=True, allow_infinity=True)
LIMITS = st.floats(1e-3, 1e3)
CONFIGS = st.builds(GateConfig, axis_max=LIMITS, total_max=LIMITS, slew_max=st.floats(1e-3, 1e6))
ZERO = Verdict.NOT_ENGAGED | Verdict.STALE | Verdict.NOT_FINITE


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


@given(CONFIGS, ticks())
def test_whatever_is_asked_for_the_output_is_safe(config, run):
    axes, inputs = run
    last = (0.0,) * axes
    for wanted, fresh, may_render, dt in inputs:
        force, verdict = gate.step(config, last, wanted, fresh, may_render, dt)
        assert len(force) == axes
        assert all(math.isfinite(f) and abs(f) <= config.axis_max for f in force)
        assert math.hypot(*force) <= config.total_max * (1 + 1e-12)
        if not (fresh and may_render and all(map(math.isfinite, wanted))):
            assert not any(force)
            assert verdict & ZERO
        growth = config.slew_max * 0.005
        for was, now in zip(last, force, strict=True):
            assert abs(now) <= max(abs(was), 0.0) + growth * (1 + 1e-9) + 1e-12
            assert now * was >= 0 or abs(now) <= growth * (1 + 1e-9)
        last = force


@given(CONFIGS, ticks())
def test_the_gate_never_pushes_more_or_the_other_way_than_asked(config, run):
    axes, inputs = run
    last = (0.0,) * axes
    for wanted, fresh, may_render, dt in inputs:
        force, _ = gate.step(config, last, wanted, fresh, may_render, dt)
        for asked, was, now in zip(wanted, last, force, strict=True):
            if math.isfinite(asked):
                assert abs(now) <= abs(asked) * (1 + 1e-12)
                assert now * asked >= 0
            assert was == was
        last = force


@given(vectors(st.floats(-2.0, 2.0)))
def test_within_limits_and_slow_passes_untouched(wanted):
    config = GateConfig(axis_max=2.0, total_max=100.0, slew_max=1.0)
    assert gate.step(config, wanted, wanted, True, True, 0.001) == (wanted, Verdict.PASSED)


@given(vectors(st.floats(-3.0, 3.0)), st.floats(0.0, 1.0))
def test_zero_is_reachable_at_once_and_so_is_anything_between(last, share):
    config = GateConfig(axis_max=3.0, total_max=100.0, slew_max=1e-3)
    wanted = tuple(share * f for f in last)
    assert gate.step(config, last, wanted, True, True, 1e-3).force == wanted


def test_growth_follows_the_slew_limit_exactly():
    config = GateConfig(axis_max=3.0, total_max=3.0, slew_max=100.0)
    force, trace = (0.0,), []
    for _ in range(40):
        force, verdict = gate.step(config, force, (2.0,), True, True, 0.001)
        trace.append((force[0], verdict))
    assert [f for f, _ in trace[:20]] == pytest.approx([0.1 * k for k in range(1, 21)])
    assert trace[10][1] == Verdict.SLEW
    assert trace[-1] == (2.0, Verdict.PASSED)


def test_a_reversal_passes_through_zero_first():
    config = GateConfig(slew_max=100.0)
    force, verdict = gate.step(config, (2.0,), (-2.0,), True, True, 0.001)
    assert force == pytest.approx((-0.1,))
    assert verdict == Verdict.SLEW


def test_a_skipped_second_does_not_buy_a_jump():
    config = GateConfig(slew_max=100.0)
    assert gate.step(config, (0.0,), (2.0,), True, True, 1.0).force == pytest.approx((0.5,))


def test_total_limit_keeps_the_direction():
    config = GateConfig(axis_max=10.0, total_max=1.0, slew_max=1e6)
    force, verdict = gate.step(config, (0.0, 0.0), (3.0, 4.0), True, True, 0.001)
    assert force == pytest.approx((0.6, 0.8))
    assert verdict == Verdict.TOTAL_LIMIT


@pytest.mark.parametrize("field", ["axis_max", "total_max", "slew_max"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_limits_that_limit_nothing_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        GateConfig(**{field: value})

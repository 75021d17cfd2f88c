"""The last gate before the motors: whatever is asked, what comes out is safe."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slave.gate import GateConfig, Verdict, step

LIMITS = GateConfig(displacement_min=-0.005, displacement_max=0.06, speed_max=0.1, tension_max=25.0)
anything = st.floats(allow_nan=True, allow_infinity=True)
inside = st.floats(LIMITS.displacement_min, LIMITS.displacement_max)
anywhere = st.floats(-0.2, 0.2)
tick = (anything, anything, anything, st.booleans(), anything)


@given(start=anywhere, ticks=st.lists(st.tuples(*tick), max_size=50))
def test_any_sequence_of_requests_stays_within_all_limits(start, ticks):
    motor = (start,)
    for wanted, tension, age, may_move, dt in ticks:
        was = motor[0]
        motor, verdict = step(LIMITS, motor, (wanted,), (tension,), age, may_move, dt)
        (now,) = motor
        assert math.isfinite(now)
        lowest, highest = LIMITS.displacement_min, LIMITS.displacement_max
        assert min(lowest, was) <= now <= max(highest, was)
        reach = LIMITS.speed_max * min(dt, 0.005) if dt > 0 else 0.0
        assert abs(now - was) <= reach * (1 + 1e-9) + 1e-18
        if not may_move:
            assert now == was
            assert verdict == Verdict.HELD
        if not (tension <= LIMITS.tension_max and age <= LIMITS.tension_age_max):
            assert now <= was  # over the limit, old, or not a number: never pulled further


@given(start=anywhere, tension=anything, age=anything, dt=anything)
def test_wanted_to_stay_a_motor_stays_wherever_it_is(start, tension, age, dt):
    motor, _ = step(LIMITS, (start,), (start,), (tension,), age, True, dt)
    assert motor == (start,)


def test_a_motor_beyond_its_limits_moves_back_only():
    def moved(start, wanted):
        return step(LIMITS, (start,), (wanted,), (5.0,), 0.0, True, dt=0.001)

    assert moved(0.080, 0.07995) == ((0.07995,), Verdict.PASSED)
    assert moved(0.080, 0.081) == ((0.080,), Verdict.TRAVEL)
    assert moved(-0.02, -0.01995) == ((-0.01995,), Verdict.PASSED)
    assert moved(-0.02, -0.03) == ((-0.02,), Verdict.TRAVEL)


def test_a_tension_that_is_too_old_pulls_nothing_and_pays_out():
    def moved(wanted, age):
        return step(LIMITS, (0.02,), (wanted,), (5.0,), age, True, dt=0.001)

    just, old = LIMITS.tension_age_max, LIMITS.tension_age_max * 1.001
    assert moved(0.02001, just) == ((0.02001,), Verdict.PASSED)
    assert moved(0.02001, old) == ((0.02,), Verdict.STALE)
    assert moved(0.01999, old) == ((0.01999,), Verdict.PASSED)


@given(start=inside, change=st.floats(-0.99e-4, 0.99e-4))
def test_a_reasonable_request_passes_untouched(start, change):
    wanted = min(max(start + change, LIMITS.displacement_min), LIMITS.displacement_max)
    motor, verdict = step(LIMITS, (start,), (wanted,), (5.0,), 0.0, True, dt=0.001)
    assert motor == (wanted,)
    assert verdict == Verdict.PASSED


def test_a_long_stall_does_not_become_a_jump():
    motor, _ = step(LIMITS, (0.0,), (0.05,), (5.0,), 0.0, True, dt=10.0)
    assert motor[0] <= 0.1 * 0.005


def test_verdict_names_each_limit():
    def verdict(wanted, tension=5.0, dt=0.001):
        return step(LIMITS, (0.0,), (wanted,), (tension,), 0.0, True, dt)[1]

    assert verdict(math.nan) == Verdict.NOT_FINITE
    assert verdict(0.01, tension=math.nan) == Verdict.NOT_FINITE
    assert verdict(1.0) == Verdict.TRAVEL | Verdict.SPEED
    assert verdict(0.05) == Verdict.SPEED
    assert verdict(0.01, tension=26.0) == Verdict.TENSION


def test_an_overloaded_tendon_may_be_paid_out():
    motor, _ = step(LIMITS, (0.02,), (0.01999,), (30.0,), 0.0, True, dt=0.001)
    assert motor == (0.01999,)


def test_one_overloaded_tendon_does_not_stop_the_others():
    motor, _ = step(LIMITS, (0.02, 0.02), (0.02001, 0.02001), (30.0, 5.0), 0.0, True, dt=0.001)
    assert motor == (0.02, 0.02001)


def test_limits_that_limit_nothing_are_refused():
    for wrong in (
        {"displacement_max": math.inf},
        {"displacement_min": 0.01},
        {"speed_max": 0.0},
        {"tension_max": -1.0},
        {"tension_max": math.nan},
        {"tension_age_max": math.nan},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            GateConfig(**wrong)

"""The last gate before the motors: whatever is asked, what comes out is safe."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.structs import to_struct, view_struct
from slave import gate
from slave.control import JointEstimate
from slave.gate import GateConfig, GateFlags, Reach
from slave.rig_layout import build_rig_layout
from teleop.config.arm import ArmConfig
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from tests.anything import CASES, Anything

LIMITS = GateConfig(displacement_min=-0.005, displacement_max=0.06, speed_max=0.1, tension_max=25.0)
anything = st.floats(allow_nan=True, allow_infinity=True)
inside = st.floats(LIMITS.displacement_min, LIMITS.displacement_max)
anywhere = st.floats(-0.2, 0.2)
UNLIMITED = Reach.array(0)
UNWRITTEN = 7.0
record_of = cache(to_struct)


class Gated(NamedTuple):
    displacement: tuple[float, ...]
    verdict: GateFlags


def padded(values):
    return np.array([*values, *[math.nan] * (MAX_TENDONS - len(values))])


def step(config, last, wanted, tension, age, may_move, dt, reach=UNLIMITED, may_yield=False):
    """Call the gate with arrays that are longer than the rig has tendons, as the loop does."""
    n = len(last)
    out = np.full(MAX_TENDONS, UNWRITTEN)
    verdict = gate.step(
        record_of(config), n, padded(last), padded(wanted), padded(tension), age, may_move, dt,
        reach, len(reach) > 0, may_yield, out,
    )  # fmt: skip
    assert (out[n:] == UNWRITTEN).all()
    return Gated(tuple(out[:n].tolist()), GateFlags(verdict))


def reaches(config, joints, position, force):
    """Return the reach of each tendon of joints of which these are the estimates."""
    estimates = JointEstimate.array(MAX_JOINTS)
    estimates["position"][: len(joints)] = position
    estimates["force"][: len(joints)] = force
    reach = Reach.array(MAX_TENDONS)
    gate.compute_reaches(record_of(config), view_struct(build_rig_layout(joints)), estimates, reach)
    return reach


@given(start=anywhere, tension=anything, age=anything, dt=anything)
def test_wanted_to_stay_a_motor_stays_wherever_it_is(start, tension, age, dt):
    motor, _ = step(LIMITS, (start,), (start,), (tension,), age, True, dt)
    assert motor == (start,)


def test_a_motor_beyond_its_limits_moves_back_only():
    def moved(start, wanted):
        return step(LIMITS, (start,), (wanted,), (5.0,), 0.0, True, dt=0.001)

    assert moved(0.080, 0.07995) == ((0.07995,), GateFlags.PASSED)
    assert moved(0.080, 0.081) == ((0.080,), GateFlags.TRAVEL)
    assert moved(-0.02, -0.01995) == ((-0.01995,), GateFlags.PASSED)
    assert moved(-0.02, -0.03) == ((-0.02,), GateFlags.TRAVEL)


def test_a_tension_that_is_too_old_pulls_nothing_and_pays_out():
    def moved(wanted, age):
        return step(LIMITS, (0.02,), (wanted,), (5.0,), age, True, dt=0.001)

    just, old = LIMITS.tension_age_max, LIMITS.tension_age_max * 1.001
    assert moved(0.02001, just) == ((0.02001,), GateFlags.PASSED)
    assert moved(0.02001, old) == ((0.02,), GateFlags.STALE_TENSION)
    assert moved(0.01999, old) == ((0.01999,), GateFlags.PASSED)


@given(start=inside, change=st.floats(-0.99e-4, 0.99e-4))
def test_a_reasonable_request_passes_untouched(start, change):
    wanted = min(max(start + change, LIMITS.displacement_min), LIMITS.displacement_max)
    motor, verdict = step(LIMITS, (start,), (wanted,), (5.0,), 0.0, True, dt=0.001)
    assert motor == (wanted,)
    assert verdict == GateFlags.PASSED


def test_verdict_names_each_limit():
    def verdict(wanted, tension=5.0, dt=0.001):
        return step(LIMITS, (0.0,), (wanted,), (tension,), 0.0, True, dt)[1]

    assert verdict(math.nan) == GateFlags.NOT_FINITE
    assert verdict(0.01, tension=math.nan) == GateFlags.NOT_FINITE
    assert verdict(1.0) == GateFlags.TRAVEL | GateFlags.SPEED
    assert verdict(0.05) == GateFlags.SPEED
    assert verdict(0.01, tension=26.0) == GateFlags.TENSION


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


RANGE = GateConfig(joint_min=-0.004, joint_max=0.010, force_max=8.0)


def test_a_joint_at_the_end_of_its_range_goes_nowhere_but_back():
    pair = ((0, 1),)

    def moved(position, force, wanted, tension=(5.0, 5.0)):
        reach = reaches(RANGE, pair, [position], [force])
        return step(RANGE, (0.0, 0.0), wanted, tension, 0.0, True, 1e-3, reach)

    both = (5e-5, -5e-5)  # `a` pulls, `b` is paid out
    back = (-5e-5, 5e-5)
    assert moved(0.009, 0.0, both) == (both, GateFlags.PASSED)
    assert moved(0.010, 0.0, both) == ((0.0, -5e-5), GateFlags.JOINT)
    assert moved(0.011, 0.0, back) == (back, GateFlags.PASSED)
    assert moved(-0.004, 0.0, back) == ((-5e-5, 0.0), GateFlags.JOINT)
    assert moved(0.0, 7.9, both) == (both, GateFlags.PASSED)
    assert moved(0.0, 8.0, both) == ((0.0, -5e-5), GateFlags.FORCE)
    assert moved(0.0, 8.0, back) == (back, GateFlags.PASSED)
    assert moved(0.0, -8.0, back) == ((-5e-5, 0.0), GateFlags.FORCE)
    assert moved(0.011, 9.0, both)[1] == GateFlags.JOINT | GateFlags.FORCE


def test_where_a_limited_joint_cannot_be_told_nothing_is_pulled():
    reach = reaches(RANGE, ((0,),), [math.nan], [math.nan])
    motor, verdict = step(RANGE, (0.0,), (5e-5,), (5.0,), 0.0, True, 1e-3, reach)
    assert (motor, verdict) == ((0.0,), GateFlags.JOINT | GateFlags.FORCE)
    unlimited = reaches(LIMITS, ((0,),), [math.nan], [math.nan])
    assert step(LIMITS, (0.0,), (5e-5,), (5.0,), 0.0, True, 1e-3, unlimited) == (
        (5e-5,),
        GateFlags.PASSED,
    )


def test_a_joint_of_one_tendon_is_not_let_out_beyond_its_range_unless_it_is_too_tight():
    reach = reaches(RANGE, ((0,),), [-0.005], [0.0])
    assert step(RANGE, (0.0,), (-5e-5,), (5.0,), 0.0, True, 1e-3, reach) == (
        (0.0,),
        GateFlags.JOINT,
    )
    assert step(RANGE, (0.0,), (-5e-5,), (26.0,), 0.0, True, 1e-3, reach).displacement == (-5e-5,)


@given(start=anywhere, tension=anything, age=anything, dt=anything)
def test_what_holds_gives_way_to_too_large_a_tension_only(start, tension, age, dt):
    (now,), verdict = step(LIMITS, (start,), (0.05,), (tension,), age, False, dt, may_yield=True)
    assert math.isfinite(now)
    assert now <= start
    assert start - now <= LIMITS.speed_max * 0.005 * (1 + 1e-9)
    assert now >= min(start, LIMITS.displacement_min)
    if now != start:
        assert tension > LIMITS.tension_max
        assert age <= LIMITS.tension_age_max
        assert verdict == GateFlags.HELD | GateFlags.YIELDED
    held = step(LIMITS, (start,), (0.05,), (tension,), age, False, dt)
    assert held == ((start,), GateFlags.HELD)


@given(start=anywhere, tension=anything, age=anything, dt=anything)
def test_without_a_gain_nothing_gives_way_whatever_the_tension(start, tension, age, dt):
    stiff = GateConfig(yield_gain=0.0)
    held = step(stiff, (start,), (0.05,), (tension,), age, False, dt, may_yield=True)
    assert held == ((start,), GateFlags.HELD)


def test_giving_way_brings_a_tension_back_to_its_limit():
    stiffness, motor, tension = 5000.0, 0.02, 40.0
    for _ in range(1000):
        (after,), _ = step(LIMITS, (motor,), (motor,), (tension,), 0.0, False, 1e-3, may_yield=True)
        tension, motor = tension + stiffness * (after - motor), after
    assert tension == pytest.approx(LIMITS.tension_max, abs=0.1)


def test_the_output_may_be_the_array_of_the_last_positions():
    last = np.array([0.02, 0.03])
    wanted, tension = np.array([0.02001, 0.02999]), np.array([5.0, 5.0])
    config = record_of(LIMITS)
    gate.step(config, 2, last, wanted, tension, 0.0, True, 1e-3, UNLIMITED, False, False, last)
    assert last.tolist() == [0.02001, 0.02999]


@pytest.mark.parametrize("short", range(5))
def test_an_array_that_is_too_short_is_refused_and_never_read_beyond_its_end(short):
    arrays = [np.zeros(1 if k == short else 2) for k in range(4)]
    last, wanted, tension, out = arrays
    reach = Reach.array(1 if short == 4 else 2)
    with pytest.raises(ValueError, match="shorter"):
        gate.step(
            record_of(LIMITS), 2, last, wanted, tension, 0.0, True, 1e-3, reach, True, False, out
        )


def test_joints_without_a_reach_that_was_told_are_not_pulled():
    unknown = Reach.array(1)
    motor, verdict = step(RANGE, (0.0,), (5e-5,), (5.0,), 0.0, True, 1e-3, unknown)
    assert (motor, verdict) == ((0.0,), GateFlags.JOINT | GateFlags.FORCE)


@pytest.mark.parametrize(
    "wrong",
    [
        {"joint_min": 0.1, "joint_max": 0.1}, {"joint_min": math.nan}, {"force_max": 0.0},
        {"force_max": math.nan}, {"yield_gain": -1.0}, {"yield_gain": math.nan},
    ],
)  # fmt: skip
def test_ranges_that_are_none_are_refused(wrong):
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))}"):
        GateConfig(**wrong)


def test_a_long_run_of_anything_stays_within_all_limits():
    """GATE_CASES of them, on a rig of a pair and a single tendon."""
    draw = Anything(seed=2)
    joints = ((0, 1), (2,))
    motor = (0.0, 0.02, 0.01)
    for _ in range(CASES):
        wanted = tuple(draw.number(-0.02, 0.08) for _ in motor)
        if draw.flag(0.5):
            wanted = tuple(was + draw.number(-2e-4, 2e-4) for was in motor)
        tension = tuple(draw.number(-1.0, 30.0) for _ in motor)
        position = [draw.number(-0.006, 0.012) for _ in joints]
        force = [draw.number(-10.0, 10.0) for _ in joints]
        age, dt = draw.number(0.0, 0.04), draw.number(0.0, 0.008)
        may_move, may_yield = draw.flag(0.8), draw.flag()
        reach = reaches(RANGE, joints, position, force)
        after, _ = step(RANGE, motor, wanted, tension, age, may_move, dt, reach, may_yield)
        ends = (
            (0, position[0] < 0.010, force[0] < 8.0),
            (1, position[0] > -0.004, -force[0] < 8.0),
        )
        ends += ((2, position[1] < 0.010, force[1] < 8.0),)
        stride = RANGE.speed_max * min(dt, 0.005) if dt > 0.0 else 0.0
        for k, free, light in ends:
            was, now = motor[k], after[k]
            assert RANGE.displacement_min <= now <= RANGE.displacement_max
            assert abs(now - was) <= stride * (1 + 1e-9) + 1e-15
            if now > was:
                assert may_move
                assert free
                assert light
                assert tension[k] <= RANGE.tension_max
                assert age <= RANGE.tension_age_max
            if now < was and not may_move:
                assert may_yield
                assert tension[k] > RANGE.tension_max
        if not position[1] > -0.004 and not tension[2] > RANGE.tension_max:
            assert after[2] >= motor[2]
        motor = after


@given(
    st.integers(0, 10_000),
    st.lists(st.floats(-0.004, 0.004), min_size=3, max_size=3),
)
def test_in_an_arm_the_reach_of_a_tendon_ends_where_the_first_joint_does(seed, travel):
    """Pulled by its reach while the others stay, it brings a joint to its limit, none beyond."""
    random = np.random.default_rng(seed)
    radii = np.diag(random.uniform(0.003, 0.006, 3))
    radii += np.tril(random.uniform(-4e-3, 4e-3, (3, 3)), -1)
    arm = ArmConfig(tuple(map(tuple, radii.tolist())))
    layout = view_struct(build_rig_layout(((0, 1), (2, 3), (4, 5)), [arm]))
    config = GateConfig(joint_min=-0.005, joint_max=0.006)
    joints, reaches = JointEstimate.array(MAX_JOINTS), Reach.array(MAX_TENDONS)
    joints["position"][:3] = travel
    joints["force"][:3] = 0.0
    gate.compute_reaches(record_of(config), layout, joints, reaches)
    ratio = np.array(layout.travel[:6:2, :3])
    for tendon in range(6):
        pulled = np.zeros(3)
        pulled[tendon // 2] = reaches["ahead"][tendon] * (1.0 - 2.0 * (tendon % 2))
        there = travel + np.linalg.solve(ratio, pulled)
        left = np.minimum(config.joint_max - there, there - config.joint_min)
        assert left.min() == pytest.approx(0.0, abs=1e-9)

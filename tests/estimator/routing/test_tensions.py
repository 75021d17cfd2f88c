"""Tensions behind passed joints against the brute-force chain, and properties of their law."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.law.play_profile import build_pretensioned_profile, push_proximal
from estimator.law.sheath import Section, Sheath
from estimator.law.transmission import build_tables, read_profile
from estimator.routing import tensions
from estimator.routing.routing import Routing, RoutingError, prepare
from studies import routing as study

PASSING = np.array([[5.0, 0.0], [-5.0, 0.0], [4.0, 6.0], [-4.0, -6.0]]) * 1e-3
PASSED = np.array([[0.0, 0.0], [0.0, 0.0], [0.2, 0.0], [0.2, 0.0]])  # friction
WRAP = np.where(PASSING == 0.0, 0.0, 1.4)
GUIDES = ["proximal", "distal", "spread"]


def passing_routing(**change):
    return Routing(**({"radii": PASSING, "friction": PASSED, "wrap": WRAP} | change))


def run(routing, T, angles, error=0.0, sheaths=None):
    """Return the fields of `JointTensions` over the samples of tensions (n, tendons)."""
    T = np.asarray(T, dtype=float)
    return study.run_model(routing, (T, T - error, T + error), np.asarray(angles), sheaths)


def check_arm(seed, legs, tension_error, torque_error, torque_mean):
    rng = np.random.default_rng(seed)
    arm = study.make_arm(rng, pitch=1 / 15, beads=16)
    rows = study.make_motion(rng, *arm.routing.radii.shape, legs)
    motion = study.play_motion(arm, rows, sheath_beads=25)
    by_tension, by_torque = (
        study.compare_tensions(arm, motion),
        study.compare_torques(arm, motion, rng),
    )
    assert by_tension.worst < tension_error
    assert by_tension.mean < 0.1 * tension_error
    assert by_tension.inside == by_torque.inside == 1.0
    assert by_torque.worst < torque_error
    assert by_torque.mean < torque_mean
    # the model of passed friction is what makes it so
    assert by_tension.worst_without > 10.0 * by_tension.worst
    assert by_torque.mean_without > 3.0 * by_torque.mean


def test_an_arm_agrees_with_the_chain():
    check_arm(0, 3, 0.005, 0.03, 0.007)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 20))
def test_more_arms_agree_with_the_chain(seed):
    """What is left is the law's error in single samples, not the beads'.

    With 16 to 64 beads it is 0.1 to 0.8 % of full scale and does not fall as their distance.
    """
    check_arm(seed, 6, 0.01, 0.045, 0.007)


@settings(deadline=None, max_examples=20)
@given(st.sampled_from(GUIDES), st.lists(st.floats(1.0, 20.0), min_size=2, max_size=12))
def test_with_joints_at_rest_it_is_the_play_of_the_friction_passed(guide, levels):
    routing = passing_routing(guide=guide)
    K = float(routing.get_friction([0.0, 0.0])[2].sum())
    tables = build_tables(Sheath.uniform(K, 0.1, 9000.0))
    profile = build_pretensioned_profile(tables, study.PRETENSION)
    expected = []
    for T in levels:
        push_proximal(tables, profile, T)
        expected.append(read_profile(tables, profile)[1])
    found = run(routing, np.tile(np.array(levels)[:, None], 4), np.zeros((len(levels), 2)))
    np.testing.assert_allclose(found[0][:, 2, 1], expected, rtol=1e-7)


@pytest.mark.parametrize("guide", GUIDES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_turning_joint_decides_the_direction_whatever_the_motor_does(guide, sign):
    routing = passing_routing(guide=guide)
    n = 200
    angles = np.zeros((n, 2))
    angles[:, 1] = sign * np.linspace(0.0, 0.5, n)  # the far joint pulls tendon 2 in, or lets go
    T = 10.0 - sign * np.linspace(0.0, 3.0, n)  # against what dT/dt would say
    behind = run(routing, np.tile(T[:, None], 4), angles)[0]
    K = routing.get_friction(angles[-1])[:, 0]
    assert behind[-1, 2, 0] == pytest.approx(T[-1] * np.exp(-sign * K[2]), rel=1e-6)
    assert behind[-1, 3, 0] == pytest.approx(T[-1] * np.exp(sign * K[3]), rel=1e-6)


def test_a_stuck_stretch_changes_by_its_strain_alone():
    routing = passing_routing(span=0.05, friction=3.0 * PASSED)
    angles = np.array([[0.0, 0.0], [0.0, 1e-4]])
    behind = run(routing, np.full((2, 4), 10.0), angles)[0]
    stretch = 2 * 0.05 + (4e-3 / 4 + 6e-3) * 1.4  # behind the last element of the near pin
    drop = behind[0, 2, 1] - behind[1, 2, 1]
    assert drop == pytest.approx(6e-3 * 1e-4 * 9000.0 / stretch, rel=1e-4)
    assert behind[1, 3, 1] - behind[0, 3, 1] == pytest.approx(drop, rel=1e-3)


def test_less_bend_relaxes_at_once_and_more_bend_changes_nothing():
    """A bend without an arm: turning it takes in nothing, but changes what friction holds."""
    radii = np.array([[5.0, 0.0], [-5.0, 0.0], [0.0, 6.0], [0.0, -6.0]]) * 1e-3
    side = np.where(PASSED > 0.0, 1.0, -np.sign(radii))
    routing = Routing(radii, PASSED, np.where(PASSED > 0.0, 1.4, 0.0), side)
    angles = np.zeros((5, 2))
    angles[:, 0] = [0.0, 0.0, 0.6, 0.0, -0.6]
    T = np.array([5.0, 15.0, 15.0, 15.0, 15.0])
    behind = run(routing, np.tile(T[:, None], 4), angles)[0][:, 2, 0]
    held = 15.0 * np.exp(-0.2 * 1.4)
    np.testing.assert_allclose(behind[1:4], held, rtol=1e-9)
    assert behind[4] == pytest.approx(15.0 * np.exp(-0.2 * 0.8))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from(GUIDES))
def test_no_parameter_within_its_error_leaves_the_interval(seed, guide):
    rng = np.random.default_rng(seed)
    routing = passing_routing(guide=guide, angle_error=1e-4, wrap=WRAP * rng.uniform(0.3, 1.5))
    rows = study.make_motion(rng, 4, 2, 4)[::3]
    T, angles = rows[:, :4], rows[:, 4:]
    measured = T + rng.uniform(-0.1, 0.1, T.shape)
    off = angles + rng.uniform(-1e-4, 1e-4, angles.shape)
    _, low, high, _, torque_low, torque_high = run(routing, measured, off, 0.1)
    other = passing_routing(
        guide=guide,
        wrap=routing.wrap,
        friction=routing.friction * rng.uniform(0.9, 1.1, PASSED.shape),
        axial_stiffness=9000.0 * rng.uniform(0.7, 1.4),
        angle_error=0.0,
    )
    true, _, _, torque, _, _ = run(other, T, angles)
    small = 1e-7
    assert ((low <= true + small) & (true <= high + small) | np.isnan(true)).all()
    assert ((torque_low <= torque + small) & (torque <= torque_high + small)).all()


def test_frictionless_torque_is_that_of_the_radii():
    routing = passing_routing(friction=0.0)
    T = np.array([[3.0, 4.0, 9.0, 2.0]])
    found = run(routing, T, [[0.2, -0.3]])
    np.testing.assert_allclose(found[3], T @ PASSING)
    assert np.isnan(found[0][0, 0, 1])  # tendon 0 does not pass joint 1


def test_slack_tendons_have_no_tension_and_an_unknown_one_any():
    prepared = prepare(passing_routing())
    state = tensions.build_initial_state(prepared, 5.0, [0.0, 0.0])
    zero, inf = np.zeros(4), np.full(4, np.inf)
    slack, state = tensions.step(prepared, state, zero, zero, zero, [0.1, 0.1])
    assert np.nanmax(slack.high) == 0.0
    unknown, state = tensions.step(prepared, state, zero, zero, inf, [0.1, 0.1])
    assert np.isposinf(unknown.high[~np.isnan(unknown.high)]).all()
    known, state = tensions.step(prepared, state, zero + 3.0, zero + 3.0, zero + 3.0, [0.1, 0.1])
    assert np.isfinite(known.torque_high).all()
    assert np.nanmax(known.high) < 3.0 * np.exp(1.2 * 0.2 * 1.5)


def test_the_state_handed_in_is_not_changed_and_wrong_shapes_are_refused():
    prepared = prepare(passing_routing())
    state = tensions.build_initial_state(prepared, 5.0, [0.0, 0.0])
    T = np.full(4, 9.0)
    first, _ = tensions.step(prepared, state, T, T, T, [0.3, 0.2])
    again, _ = tensions.step(prepared, state, T, T, T, [0.3, 0.2])
    np.testing.assert_array_equal(first.tension, again.tension)
    for arguments in ((T[:3], T, T, [0.0, 0.0]), (T, T, T, [0.0]), (T, T, T, [0.0, np.nan])):
        with pytest.raises((RoutingError, ValueError)):
            tensions.step(prepared, state, *arguments)


@pytest.mark.parametrize(
    ("sheaths", "words"),
    [
        ([Sheath.uniform(1.0, 1.0, 9000.0)], "there are 4"),
        ([Sheath.uniform(1.0, 1.0, 9000.0, drag=1.0)] * 4, "drag"),
    ],
)
def test_sheaths_that_do_not_fit_are_refused(sheaths, words):
    with pytest.raises(RoutingError, match=words):
        prepare(passing_routing(), sheaths)


def test_a_sheath_in_front_divides_the_tension_as_its_law_does():
    sheath = Sheath((Section(0.3), Section(0.5, 0.1), Section(0.3, 0.4)), 0.1, 9000.0)
    routing = passing_routing(friction=0.0)
    T = np.concatenate([np.linspace(5.0, 20.0, 60), np.linspace(20.0, 4.0, 60)])
    found = run(routing, np.tile(T[:, None], 4), np.zeros((120, 2)), sheaths=[sheath] * 4)
    tables = build_tables(sheath)
    profile = build_pretensioned_profile(tables, study.PRETENSION)
    expected = []
    for value in T:
        push_proximal(tables, profile, value)
        expected.append(read_profile(tables, profile)[1])
    np.testing.assert_allclose(found[0][:, 0, 0], expected, rtol=1e-7)

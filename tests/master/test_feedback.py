import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.structs import to_struct, view_struct
from master import feedback
from master.feedback import FeedbackConfig
from teleop.coupling import Bilateral, to_bilateral_settings
from teleop.coupling.force_attenuation import ConfidenceConfig, attenuate_force
from teleop.messages.messages import MAX_JOINTS, SlaveState, pad_values
from tests.master.records import eight, message_record

FORCES = st.floats(-100.0, 100.0)
BAD = st.sampled_from([math.nan, math.inf, -math.inf])
CONFIDENCE = to_struct(ConfidenceConfig())
BILATERAL = view_struct(to_bilateral_settings(Bilateral()))


def slave_state(*force, width=0.0, margin=0.0, joints=None, status=0):
    return SlaveState(
        status=(status, *(0,) * (MAX_JOINTS - 1)),
        joints=len(force) if joints is None else joints,
        force=pad_values(force, MAX_JOINTS),
        force_low=pad_values([f - width for f in force], MAX_JOINTS),
        force_high=pad_values([f + width for f in force], MAX_JOINTS),
        force_margin=pad_values([margin for _ in force], MAX_JOINTS),
    )


def tip_forces(state, axes):
    out = eight(*(9.0,) * MAX_JOINTS)
    record = message_record(SlaveState() if state is None else state)
    feedback.compute_tip_forces(BILATERAL, record, state is not None, axes, out)
    assert (out[axes:] == 9.0).all()
    return tuple(out[:axes])


@given(st.floats(0.01, 10.0), FORCES)
def test_the_hand_is_pushed_against_what_resists_pulling(scale, force):
    assert feedback.reflect_force(scale, force) * force <= 0.0
    assert abs(feedback.reflect_force(scale, force)) == pytest.approx(scale * abs(force))


@given(BAD)
def test_a_force_that_is_no_number_is_not_turned_into_one(bad):
    (felt,) = tip_forces(slave_state(bad), 1)
    assert not math.isfinite(felt)
    for link in (feedback.reflect_force(0.2, felt), feedback.clamp(1.0, felt)):
        assert not math.isfinite(link)
    assert not math.isfinite(feedback.limit_slew(10.0, 0.0, felt, 1e-3))


@given(FORCES, st.floats(0.0, 200.0), st.floats(0.0, 50.0))
def test_a_force_is_felt_as_far_as_its_interval_and_its_margin_allow(force, width, margin):
    (felt,) = tip_forces(slave_state(force, width=width, margin=margin), 1)
    assert felt == attenuate_force(CONFIDENCE, force, force - width, force + width, margin)


@pytest.mark.parametrize("force", [5.0, math.nan])
def test_a_joint_whose_sample_was_refused_is_not_felt_and_the_others_are(force):
    for other_flags in (0, 0b1111):
        state = slave_state(force, 5.0, status=feedback.INVALID | other_flags)
        assert tip_forces(state, 2) == (0.0, 5.0)
    merely_doubtful = slave_state(5.0, 5.0, status=0b1111)
    assert tip_forces(merely_doubtful, 2) == (5.0, 5.0)


def test_axes_without_a_joint_feel_nothing_and_neither_does_anyone_before_the_first_state():
    state = slave_state(5.0, 5.0, 5.0, joints=1)
    assert tip_forces(state, 3) == (5.0, 0.0, 0.0)
    assert tip_forces(None, 3) == (0.0, 0.0, 0.0)


def test_a_message_that_tells_of_more_joints_than_there_are_is_no_harm():
    state = slave_state(*(5.0,) * MAX_JOINTS, joints=2**32 - 1)
    assert tip_forces(state, MAX_JOINTS) == (5.0,) * MAX_JOINTS


@given(FORCES, FORCES, st.floats(0.0, 0.1))
def test_a_force_grows_slowly_and_falls_at_once(last, force, dt):
    after = feedback.limit_slew(100.0, last, force, dt)
    assert abs(after) <= abs(force)
    assert after * force >= 0.0
    same_side = abs(last) if last * force > 0.0 else 0.0
    assert abs(after) <= same_side + 100.0 * min(dt, 0.005) + 1e-12
    assert feedback.limit_slew(100.0, last, 0.0, dt) == 0.0


@given(FORCES)
def test_rendering_saturates_where_the_slave_is_told_that_it_does(force):
    config = FeedbackConfig(scale=0.2, limit=2.5)
    rendered = feedback.clamp(config.limit, feedback.reflect_force(config.scale, force))
    most = feedback.compute_saturation(to_struct(config))
    assert rendered == pytest.approx(-config.scale * min(max(force, -most), most))
    assert feedback.compute_saturation(to_struct(FeedbackConfig(scale=0.0))) == 0.0

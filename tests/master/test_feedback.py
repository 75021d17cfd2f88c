import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master import feedback
from master.feedback import FeedbackConfig
from teleop.messages import MAX_JOINTS, SlaveState, padded

FORCES = st.floats(-100.0, 100.0)
BAD = st.sampled_from([math.nan, math.inf, -math.inf])


def slave_state(*force, width=0.0, joints=None, status=0):
    return SlaveState(
        status=(status, *(0,) * (MAX_JOINTS - 1)),
        joints=len(force) if joints is None else joints,
        force=padded(force, MAX_JOINTS),
        force_low=padded([f - width for f in force], MAX_JOINTS),
        force_high=padded([f + width for f in force], MAX_JOINTS),
    )


@given(st.lists(FORCES, min_size=1, max_size=8))
def test_the_hand_is_pushed_against_what_resists_pulling(forces):
    config = FeedbackConfig(scale=0.1, limit=2.0)
    wanted = feedback.step(config, slave_state(*forces), len(forces))
    for tip, hand in zip(forces, wanted, strict=True):
        assert hand * tip <= 0.0
        assert abs(hand) == pytest.approx(min(0.1 * abs(tip), 2.0))


@given(BAD, st.sampled_from(["estimate", "certified"]))
def test_a_force_that_is_no_number_is_not_turned_into_one(bad, source):
    state = slave_state(bad)
    (wanted,) = feedback.step(FeedbackConfig(source=source), state, 1)
    assert not math.isfinite(wanted)


@given(FORCES, FORCES, FORCES)
def test_no_force_beyond_the_certified_interval_is_felt(force, one, other):
    low, high = min(one, other), max(one, other)
    felt = feedback.bounded(force, low, high)
    assert low <= felt <= high
    assert felt == force or not low <= force <= high
    ends = {"force_low": padded((low,), MAX_JOINTS), "force_high": padded((high,), MAX_JOINTS)}
    state = SlaveState(joints=1, force=padded((force,), MAX_JOINTS), **ends)
    (wanted,) = feedback.step(FeedbackConfig(scale=0.1, limit=100.0), state, 1)
    assert wanted == pytest.approx(-0.1 * felt)


@pytest.mark.parametrize("source", ["estimate", "certified"])
@pytest.mark.parametrize("force", [5.0, math.nan])
def test_a_joint_whose_sample_was_refused_is_not_felt_and_the_others_are(source, force):
    config = FeedbackConfig(scale=0.1, source=source)
    for other_flags in (0, 0b1111):
        state = slave_state(force, 5.0, status=feedback.INVALID | other_flags)
        assert feedback.step(config, state, 2) == (0.0, -0.5)
    merely_doubtful = slave_state(5.0, 5.0, status=0b1111)
    assert feedback.step(config, merely_doubtful, 2) == (-0.5, -0.5)


@given(FORCES, st.floats(0.0, 100.0))
def test_the_certified_force_is_in_the_interval_and_nothing_there_is_smaller(middle, width):
    low, high = middle - width, middle + width
    certain = feedback.certified(low, high)
    assert low <= certain <= high
    assert abs(certain) == min(abs(low), abs(high)) or (certain == 0.0 and low <= 0.0 <= high)


@pytest.mark.parametrize("ends", [(1.0, -1.0), (math.nan, 1.0), (1.0, math.nan), (-1.0, math.nan)])
def test_an_interval_that_is_none_certifies_nothing(ends):
    assert math.isnan(feedback.certified(*ends))
    assert math.isnan(feedback.bounded(0.0, *ends))


def test_uncertainty_softens_the_certified_force_only():
    state = slave_state(10.0, width=4.0)
    assert feedback.step(FeedbackConfig(scale=0.1), state, 1) == pytest.approx((-1.0,))
    certain = FeedbackConfig(scale=0.1, source="certified")
    assert feedback.step(certain, state, 1) == pytest.approx((-0.6,))


def test_axes_without_a_joint_feel_nothing():
    state = slave_state(5.0, 5.0, 5.0, joints=1)
    assert feedback.step(FeedbackConfig(scale=0.1), state, 3) == (-0.5, 0.0, 0.0)


@pytest.mark.parametrize(
    "wrong", [{"scale": -0.1}, {"scale": math.nan}, {"limit": 0.0}, {"limit": math.inf}]
)
def test_bad_values_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        FeedbackConfig(**wrong)

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master import operator
from master.device import HandState
from master.operator import Memory, OperatorConfig
from teleop.messages import MAX_JOINTS, SlaveState, padded

CONFIG = OperatorConfig(position_scale=0.25)
METRES = st.floats(-0.5, 0.5)


def hand(*position, velocity=0.0):
    return HandState(position, (velocity,) * len(position), engage=True)


def slave_at(*position, sender=7):
    return SlaveState(sender=sender, joints=2, position=padded(position, MAX_JOINTS))


@given(METRES, METRES, METRES)
def test_engaging_moves_nothing_whatever_the_hand_did_before(before, at_engage, tip):
    state = slave_at(tip, 0.1)
    command, memory = operator.step(CONFIG, Memory(), hand(before), state, engaged=False)
    assert command.position == state.position
    command, _ = operator.step(CONFIG, memory, hand(at_engage), state, engaged=True)
    assert command.position == pytest.approx(state.position)


@given(st.lists(st.tuples(METRES, st.booleans()), min_size=1, max_size=30))
def test_only_motion_while_engaged_counts(script):
    state = slave_at(0.0)
    memory, travelled, last, was_engaged = Memory(), 0.0, 0.0, False
    for position, engaged in script:
        command, memory = operator.step(CONFIG, memory, hand(position), state, engaged)
        if engaged and was_engaged:
            travelled += position - last
        last, was_engaged = position, engaged
        assert command.position[0] == pytest.approx(0.25 * travelled, abs=1e-12)
        assert command.position[1:] == state.position[1:]


def test_velocity_is_that_of_the_position_and_zero_when_apart():
    _, memory = operator.step(CONFIG, Memory(), hand(0.0), slave_at(0.0), engaged=True)
    first, memory = operator.step(CONFIG, memory, hand(0.010, velocity=2.0), None, engaged=True)
    second, memory = operator.step(CONFIG, memory, hand(0.012, velocity=2.0), None, engaged=True)
    slope = (second.position[0] - first.position[0]) / 0.001
    assert second.velocity[0] == pytest.approx(slope)
    apart, _ = operator.step(CONFIG, memory, hand(0.014, velocity=2.0), None, engaged=False)
    assert not any(apart.velocity)


def test_another_slave_starts_where_it_is_and_not_where_the_last_one_was():
    _, memory = operator.step(CONFIG, Memory(), hand(0.0), slave_at(0.0), engaged=True)
    moved, memory = operator.step(CONFIG, memory, hand(0.2), slave_at(0.0), engaged=True)
    assert moved.position[0] == pytest.approx(0.05)
    restarted = slave_at(0.001, sender=8)
    command, _ = operator.step(CONFIG, memory, hand(0.2), restarted, engaged=True)
    assert command.position[0] == pytest.approx(0.001)


def test_where_the_slave_cannot_tell_its_travel_it_counts_from_zero():
    command, _ = operator.step(CONFIG, Memory(), hand(0.2), slave_at(math.nan, 0.1), engaged=True)
    assert command.position[:2] == pytest.approx((0.0, 0.1))


@pytest.mark.parametrize("scale", [0.0, -1.0, 11.0, math.nan])
def test_scales_that_reverse_freeze_or_explode_are_refused(scale):
    with pytest.raises(ValueError, match="position_scale"):
        OperatorConfig(position_scale=scale)

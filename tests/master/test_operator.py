import math
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.structs import view_struct
from master import operator
from master.device import HandState
from master.operator import OperatorConfig, OperatorMemory, build_operator_settings
from teleop.messages.messages import MAX_JOINTS, SlaveState, pad_values
from teleop.session.state_machine import Reason
from tests.master.records import eight, hand_record, message_record

CONFIG = OperatorConfig(position_scale=0.25)
METRES = st.floats(-0.5, 0.5)


def hand(*position, velocity=0.0):
    return HandState(position, (velocity,) * len(position), engage=True)


def slave_at(*position, sender=7):
    return SlaveState(sender=sender, joints=2, position=pad_values(position, MAX_JOINTS))


class TipCommand(NamedTuple):
    position: tuple[float, ...]
    velocity: tuple[float, ...]


def told(state):
    return message_record(SlaveState() if state is None else state), state is not None


def step(config, memory, the_hand, state, engaged):
    """The operator's step with a memory that it does not change, but returns anew."""
    memory, position, velocity = memory.copy(), eight(), eight()
    operator.step(
        view_struct(build_operator_settings(config)), memory, hand_record(the_hand), *told(state),
        engaged, position, velocity,
    )  # fmt: skip
    return TipCommand(tuple(position), tuple(velocity)), memory


def not_ready_reason(config, memory, the_hand, state):
    before = memory.copy()
    reason = operator.find_not_ready_reason(
        view_struct(build_operator_settings(config)), memory, hand_record(the_hand), *told(state)
    )
    assert memory == before
    return reason


@given(METRES, METRES, METRES)
def test_engaging_moves_nothing_whatever_the_hand_did_before(before, at_engage, tip):
    state = slave_at(tip, 0.1)
    command, memory = step(CONFIG, OperatorMemory.new(), hand(before), state, engaged=False)
    assert command.position == state.position
    command, _ = step(CONFIG, memory, hand(at_engage), state, engaged=True)
    assert command.position == pytest.approx(state.position)


def test_velocity_is_that_of_the_position_and_zero_when_apart():
    _, memory = step(CONFIG, OperatorMemory.new(), hand(0.0), slave_at(0.0), engaged=True)
    first, memory = step(CONFIG, memory, hand(0.010, velocity=2.0), None, engaged=True)
    second, memory = step(CONFIG, memory, hand(0.012, velocity=2.0), None, engaged=True)
    slope = (second.position[0] - first.position[0]) / 0.001
    assert second.velocity[0] == pytest.approx(slope)
    apart, _ = step(CONFIG, memory, hand(0.014, velocity=2.0), None, engaged=False)
    assert not any(apart.velocity)


def test_another_slave_starts_where_it_is_and_not_where_the_last_one_was():
    _, memory = step(CONFIG, OperatorMemory.new(), hand(0.0), slave_at(0.0), engaged=True)
    moved, memory = step(CONFIG, memory, hand(0.2), slave_at(0.0), engaged=True)
    assert moved.position[0] == pytest.approx(0.05)
    restarted = slave_at(0.001, math.nan, sender=8)  # one that cannot tell counts from zero
    command, _ = step(CONFIG, memory, hand(0.2, 0.2), restarted, engaged=True)
    assert command.position[:2] == pytest.approx((0.001, 0.0))


def test_a_hand_that_cannot_be_read_moves_nothing_and_is_coupled_anew():
    _, memory = step(CONFIG, OperatorMemory.new(), hand(0.0), slave_at(0.0), True)
    lost, memory = step(CONFIG, memory, None, slave_at(0.0), True)
    assert not any(lost.velocity)
    back, memory = step(CONFIG, memory, hand(0.3), slave_at(0.0), True)
    assert back.position == lost.position
    assert not_ready_reason(CONFIG, memory, None, slave_at(0.0)) == Reason.NONE


SCALES = st.floats(0.01, 10.0)
LOCKS = st.sampled_from([(), (0,), (1,), (0, 1)])


@given(st.lists(st.tuples(METRES, METRES, SCALES, LOCKS, st.integers(0, 4)), max_size=40))
def test_no_change_of_scale_lock_or_clutch_moves_a_tip_further_than_the_hand_did(script):
    """Whatever changes in a tick, a tip moves by the new scale times what the hand moved in it."""
    state, memory = slave_at(0.01, -0.02), OperatorMemory.new()
    tip, last, was_engaged = state.position, None, False
    for *hands, scale, lock, dice in script:
        config, engaged = OperatorConfig(position_scale=scale, lock=lock), dice > 0
        command, memory = step(config, memory, hand(*hands), state, engaged)
        for k in range(2):
            moves = engaged and was_engaged and k not in lock
            expected = scale * (hands[k] - last[k]) if moves else 0.0
            assert command.position[k] - tip[k] == pytest.approx(expected, abs=1e-12)
            if k in lock or not engaged:
                assert command.position[k] == tip[k]
                assert command.velocity[k] == 0.0
        tip, last, was_engaged = command.position, hands, engaged


@given(st.lists(METRES, min_size=1, max_size=30), st.floats(-0.3, 0.0), st.floats(0.01, 0.3))
def test_the_tip_stays_within_what_the_workspace_of_the_hand_can_reach(way, low, high):
    config = OperatorConfig(position_scale=0.25, workspace=((low, high),))
    memory, state = OperatorMemory.new(), slave_at(0.0)
    for position in way:
        command, memory = step(config, memory, hand(position, velocity=1.0), state, True)
        start = min(max(way[0], low), high)
        inside = min(max(position, low), high)
        assert command.position[0] == pytest.approx(0.25 * (inside - start), abs=1e-12)
        assert (command.velocity[0] == 0.0) == (not low <= position <= high)


def test_aligned_engagement_waits_for_the_hand_to_be_where_the_tip_is():
    config = OperatorConfig(position_scale=0.25, align=0.002)
    state = slave_at(0.0)
    assert (
        not_ready_reason(config, OperatorMemory.new(), hand(0.3), state) == Reason.NONE
    )  # the first time
    _, memory = step(config, OperatorMemory.new(), hand(0.1), state, True)
    _, memory = step(config, memory, hand(0.14), state, True)
    there = slave_at(0.010)
    _, memory = step(config, memory, hand(0.14), there, False)
    assert not_ready_reason(config, memory, hand(0.14), there) == Reason.NONE
    assert not_ready_reason(config, memory, hand(0.14), slave_at(0.007)) == Reason.ALIGN_FIRST
    assert not_ready_reason(config, memory, hand(0.129), slave_at(0.007)) == Reason.NONE
    assert not_ready_reason(config, memory, hand(0.2), there) == Reason.ALIGN_FIRST
    anywhere = OperatorConfig(position_scale=0.25)
    assert not_ready_reason(anywhere, memory, hand(0.2), there) == Reason.NONE
    locked = OperatorConfig(position_scale=0.25, align=0.002, lock=(0,))
    assert not_ready_reason(locked, memory, hand(0.2), there) == Reason.NONE
    finer = OperatorConfig(position_scale=0.1, align=0.002)  # changed while apart: nothing moved
    assert not_ready_reason(finer, memory, hand(0.14), there) == Reason.NONE
    assert not_ready_reason(finer, memory, hand(0.165), there) == Reason.ALIGN_FIRST
    assert not_ready_reason(config, memory, hand(0.2), slave_at(0.0, sender=8)) == Reason.NONE
    command, _ = step(config, memory, hand(0.129), slave_at(0.007), True)
    assert command.position[0] == pytest.approx(0.007)  # from where the slave is, not was asked to

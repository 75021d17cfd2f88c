"""The slave's port: the same force as the master works out, and where the tips are sent."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.structs import to_struct, view_struct
from master import feedback
from slave import loop
from slave.control import JointEstimate
from teleop import coupling
from teleop.coupling import Bilateral, PassivityConfig, Side
from teleop.messages.messages import MAX_JOINTS, SlaveState, pad_values
from teleop.messages.packet import Packet

FORCES = st.floats(-60.0, 60.0)
NUMBERS = view_struct(coupling.to_bilateral_settings(Bilateral()))


def estimates(*rows):
    """Return estimates with these forces, ends of their intervals and status bits."""
    records = JointEstimate.array(len(rows))
    for k, (force, low, high, status) in enumerate(rows):
        estimate = view_struct(records, k)
        estimate.position, estimate.status = 0.0, status
        estimate.force, estimate.low, estimate.high = force, low, high
    return records


def slave_forces(most, *rows, reduction=0.0):
    forces = np.full(MAX_JOINTS, 7.0)
    loop.compute_rendered_forces(NUMBERS, estimates(*rows), len(rows), most, forces, reduction)
    assert (forces[len(rows) :] == 7.0).all()
    return forces[: len(rows)].tolist()


@given(
    FORCES,
    st.floats(0.0, 80.0),
    st.floats(0.0, 80.0),
    st.sampled_from([0, INVALID_INPUT, 3]),
    st.floats(0.0, 5.0),
    st.sampled_from([0.0, 0.3, 1.0, math.nan, -1.0, 2.0]),
)
def test_both_sides_know_the_same_port_force(force, below, above, status, scale, reduction):
    low, high = force - below, force + above
    config = to_struct(feedback.FeedbackConfig(scale=scale))
    most = feedback.compute_saturation(config)
    (at_slave,) = slave_forces(most, (force, low, high, status), reduction=reduction)
    share = 1.0 - reduction if 0.0 <= reduction <= 1.0 else 0.0  # of anything else, no force
    assert abs(at_slave) <= share * abs(force)
    state = SlaveState(
        joints=1,
        force=pad_values((force,), MAX_JOINTS),
        force_low=pad_values((low,), MAX_JOINTS),
        force_high=pad_values((high,), MAX_JOINTS),
        status=(status, *(0,) * (MAX_JOINTS - 1)),
        force_reduction=reduction,
    )
    at_master = np.zeros(MAX_JOINTS)
    packet = Packet(SlaveState)
    packet.fill(state)
    feedback.compute_tip_forces(NUMBERS, packet.record, True, 1, at_master)
    rendered = feedback.clamp(config.limit, feedback.reflect_force(scale, at_master[0]))
    assert rendered == pytest.approx(-scale * at_slave, abs=1e-9)


@given(
    st.lists(st.tuples(FORCES, st.floats(0.0, 80.0), st.floats(0.0, 80.0)), min_size=4, max_size=4),
    st.sampled_from([0, INVALID_INPUT]),
)
def test_the_forces_of_an_arm_keep_their_direction_and_other_joints_stand_alone(rows, status):
    """Joints 1 and 2 are an arm's: together they are rendered as much as each would be alone."""
    bilateral = view_struct(coupling.to_bilateral_settings(Bilateral(arms=((1, 2),))))
    rows = [(force, force - below, force + above, 0) for force, below, above in rows]
    rows[2] = (*rows[2][:3], status)
    forces = np.zeros(MAX_JOINTS)
    loop.compute_rendered_forces(bilateral, estimates(*rows), 4, 1e3, forces, 0.0)
    alone = slave_forces(1e3, *rows)
    assert forces[[0, 3]].tolist() == [alone[0], alone[3]]
    force = np.array(rows)[1:3, 0]
    size = float(np.hypot(*force))
    assert forces[1] * force[1] == pytest.approx(forces[2] * force[0], abs=1e-9 * (1.0 + size**2))
    if status or size == 0.0:
        assert not forces[1:3].any()
        return
    assert np.hypot(*forces[1:3]) == pytest.approx(np.hypot(*alone[1:3]), abs=1e-9)


anything = st.floats(allow_nan=True, allow_infinity=True)


@given(anything, st.lists(st.tuples(anything, FORCES, FORCES, st.integers(0, 31)), max_size=8))
def test_whatever_comes_in_no_more_is_rendered_than_the_most_and_each_joint_by_itself(most, rows):
    forces = slave_forces(most, *rows)
    assert all(abs(force) <= (most if most > 0.0 else 0.0) for force in forces)
    assert forces == [force for row in rows for force in slave_forces(most, row)]


def test_what_the_hand_never_paid_for_is_not_spent_on_a_wall():
    coupling_config = PassivityConfig()
    settings = view_struct(coupling.to_bilateral_settings(Bilateral(coupling=coupling_config)))
    side, asked, speed = Side.new(), np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    force, told = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    for tick in range(200):
        coupling.receive_totals(side, np.uint64(7), told, told)
        force[:1] = slave_forces(50.0, (10.0, 10.0, 10.0, 0))
        asked[0], speed[0] = 1e-4 * tick, 0.1
        coupling.compute_tip_motion(settings, side, asked, speed, force, 1, True, 1e-3)
        place = asked[0]
    assert 10.0 * place <= coupling_config.reserve + 1e-12
    assert place > 0.0
    assert side.ports[0].credit >= 0.0

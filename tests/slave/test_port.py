"""The slave's port: the same force as the master works out, and where the tips are sent."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator import online
from master import feedback
from slave import port
from slave.control import JointEstimate
from teleop.confidence import ConfidenceConfig
from teleop.coupling import Bilateral, PassivityConfig, Side
from teleop.messages import MAX_JOINTS, Command, SlaveState, padded

FORCES = st.floats(-60.0, 60.0)
RULE = ConfidenceConfig()
INVALID = int(online.Status.INVALID_INPUT)


@given(
    FORCES,
    st.floats(0.0, 80.0),
    st.floats(0.0, 80.0),
    st.sampled_from([0, INVALID, 3]),
    st.floats(0.0, 5.0),
)
def test_both_sides_know_the_same_port_force(force, below, above, status, scale):
    low, high = force - below, force + above
    config = feedback.FeedbackConfig(scale=scale)
    most = feedback.saturation(config)
    (at_slave,) = port.felt(RULE, [JointEstimate(0.0, force, low, high, status)], most)
    state = SlaveState(
        joints=1,
        force=padded((force,), MAX_JOINTS),
        force_low=padded((low,), MAX_JOINTS),
        force_high=padded((high,), MAX_JOINTS),
        status=(status, *(0,) * (MAX_JOINTS - 1)),
    )
    (at_master,) = feedback.felt(RULE, state, 1)
    rendered = feedback.clamp(config.limit, feedback.reflect(scale, at_master))
    assert rendered == pytest.approx(-scale * at_slave, abs=1e-9)


def test_what_the_hand_never_paid_for_is_not_spent_on_a_wall():
    bilateral = Bilateral(coupling=PassivityConfig())
    wall = [JointEstimate(0.0, 10.0, 10.0, 10.0, 0)]
    command = Command(sender=7, force_max=50.0)
    side, place = Side(), 0.0
    for tick in range(200):
        asked = (1e-4 * tick,)
        (place,), _, side = port.step(
            bilateral, side, command, asked, (0.1,), wall, coupled=True, dt=1e-3
        )
    assert 10.0 * place <= bilateral.coupling.reserve + 1e-12
    assert place > 0.0
    assert side.ports[0].credit >= 0.0


def test_without_a_command_nothing_is_coupled():
    where, speed, side = port.step(Bilateral(), Side(), None, (), (), [], coupled=False, dt=1e-3)
    assert (where, speed, side) == ((), (), Side())

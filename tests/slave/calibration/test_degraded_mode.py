"""Degraded mode: when it begins and ends, and what its limits are."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.structs import to_struct, view_struct
from slave.calibration import degraded_mode, monitor
from slave.calibration.degraded_mode import RAMP_S, Degradation
from slave.calibration.monitor import Advice, MonitorConfig, TendonMonitor
from slave.control.joint_estimate import JointEstimate
from slave.rig_layout import EstimatedTendon, build_rig_layout

CONFIG = to_struct(MonitorConfig(on_demand="degrade"))
LAYOUT = view_struct(build_rig_layout([(0, 1)]))


class Mode:
    """The mode of a pair whose tendon a had transitions with these errors of T_out."""

    def __init__(self):
        self.state = view_struct(Degradation.array())
        self.monitors = TendonMonitor.array(2)
        self.decided = [False, False]

    def see(self, *errors):
        a = view_struct(self.monitors)
        a.count = len(errors)
        a.errors[: len(errors)] = errors
        a.uncertainties[: len(errors)] = 0.01
        a.force_error = monitor.compute_force_error(a)
        advice = monitor.compute_advice(CONFIG, self.monitors, 2)
        degraded_mode.update_degradation(
            CONFIG, self.state, self.monitors, advice, np.array(self.decided)
        )
        return advice, bool(self.state.active)

    def wait(self, seconds):
        for _ in range(round(seconds * 1000)):
            degraded_mode.advance_ramp(self.state, 1e-3)
        return self.state.ramp


def test_only_transitions_that_agree_on_no_error_end_it():
    mode = Mode()
    assert mode.see(0.1, 0.1, 0.1) == (Advice.ADVISED, False)
    assert mode.see(0.3, 0.3, 0.3) == (Advice.DEMANDED, True)
    assert mode.see(0.3, 0.3, 0.3, 0.1, 0.1)[1]
    assert mode.see(0.3, 0.01, -0.25, 0.0, 0.2) == (Advice.NONE, True)  # they contradict each other
    assert mode.see(0.0, 0.0) == (Advice.NONE, True)  # too few
    assert mode.see(0.1, 0.1, 0.1, 0.1, 0.1) == (Advice.ADVISED, True)
    assert mode.see(0.3, 0.3, 0.01, 0.0, 0.02) == (Advice.NONE, False)
    assert mode.see(-0.3, -0.3, -0.3) == (Advice.DEMANDED, True)


def test_an_adaptation_that_has_found_k_ends_it():
    mode = Mode()
    assert mode.see(0.3, 0.3, 0.3) == (Advice.DEMANDED, True)
    mode.decided = [False, True]  # of the other tendon
    assert mode.see(0.3, 0.3, 0.3)[1]
    mode.decided = [True, True]
    assert not mode.see(0.3, 0.3, 0.3)[1]


def test_the_limits_come_and_go_without_a_step_and_keep_the_largest_error_until_then():
    mode = Mode()
    assert degraded_mode.compute_speed_max(CONFIG, mode.state) == math.inf
    mode.see(0.3, 0.3, 0.3)
    assert mode.wait(0.5 * RAMP_S) == pytest.approx(0.5)
    assert degraded_mode.compute_force_reduction(CONFIG, mode.state) == pytest.approx(0.25)
    assert degraded_mode.compute_speed_max(CONFIG, mode.state) == pytest.approx(0.01)
    assert mode.wait(RAMP_S) == 1.0
    assert degraded_mode.compute_force_reduction(CONFIG, mode.state) == 0.5
    assert degraded_mode.compute_speed_max(CONFIG, mode.state) == 0.005
    mode.see(0.0, 0.0, 0.0)
    assert 0.0 < mode.wait(0.5 * RAMP_S) < 1.0
    assert mode.state.ratio[0] == pytest.approx(1.3)
    assert mode.wait(RAMP_S) == 0.0
    assert (mode.state.ratio[:] == 1.0).all()


@given(
    st.tuples(st.floats(0.1, 20.0), st.floats(0.1, 20.0)),
    st.tuples(st.floats(-0.5, 1.5), st.floats(-0.5, 1.5)),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
def test_the_widened_interval_holds_the_force_as_wrong_as_was_found(estimated, errors, shares):
    """Of each tendon T_out is anywhere between its estimate over and times 1 + error."""
    mode, tendons = view_struct(Degradation.array()), EstimatedTendon.array(2)
    mode.ramp, true = 1.0, np.zeros(2)
    for i in range(2):
        ratio = max(1.0 + errors[i], 1.0 / (1.0 + errors[i]))
        mode.ratio[i], true[i] = ratio, estimated[i] * ratio ** shares[i]
        tendons["estimate"]["low"][i] = tendons["estimate"]["high"][i] = estimated[i]
    joints = JointEstimate.array()
    joints["low"] = joints["high"] = estimated[0] - estimated[1]
    degraded_mode.widen_intervals(LAYOUT, mode, tendons, joints)
    assert joints["low"][0] <= true[0] - true[1] + 1e-9
    assert joints["high"][0] >= true[0] - true[1] - 1e-9


def test_an_infinite_interval_is_of_the_joints_that_the_tendon_moves():
    layout = view_struct(build_rig_layout(((0,), (1,))))
    mode, tendons = view_struct(Degradation.array()), EstimatedTendon.array(2)
    mode.ramp, mode.ratio[0] = 1.0, 1.3
    tendons["estimate"]["high"] = np.inf, 1.0
    joints = JointEstimate.array(2)
    joints["low"] = joints["high"] = 1.0
    degraded_mode.widen_intervals(layout, mode, tendons, joints)
    assert joints["high"].tolist() == [np.inf, 1.0]
    assert joints["low"].tolist() == [-np.inf, 1.0]

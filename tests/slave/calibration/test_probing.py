"""Probing: no tip notices, and anything that changes ends a probe at once."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from estimator.law.sheath import Section, Sheath
from estimator.online.online import TendonModel
from estimator.structs import to_struct, view_struct
from slave.calibration import probing
from slave.calibration.monitor import MonitorConfig, TendonMonitor
from slave.calibration.probing import K_RATIO_MIN, Probe, ProbingConfig
from slave.rig_layout import EstimatedTendon, build_rig_layout
from studies.probing import draw_joint, run_rest
from teleop.messages.messages import MAX_JOINTS
from teleop.session.state_machine import Session, State, may_probe

DT, K, PAUSE = 1e-3, 1.0, 0.05
SETTINGS = ProbingConfig(enabled=True, pause=PAUSE)
CONFIG = to_struct(SETTINGS)
MODEL = TendonModel(Sheath.uniform(K, 1.5, 9000.0))
LAYOUT = view_struct(build_rig_layout([(0, 1)]))
REST = np.zeros(MAX_JOINTS)


class Rest:
    """A pair at rest: tension follows the motors by a stiffness, the tip a play of ln T_in."""

    def __init__(self, stiffness=20e3, K_true=K_RATIO_MIN * K):
        records = probing.build_probe_constants([MODEL, MODEL], SETTINGS)
        self.constants, self.probe = records, view_struct(Probe.array())
        self.tendons = EstimatedTendon.array(2)
        self.tendons["valid"] = True
        self.tension, self.motor = np.array([0.3, 0.3]), np.zeros(2)
        self.stiffness, self.K = stiffness, K_true
        self.tip = math.log(0.3)  # ln T_out of tendon a

    def tick(self, requested=REST, allowed=True):
        """Return whether the motors were moved or held."""
        self.tendons["corrected_tension"] = self.tension
        self.tendons["corrected_displacement"] = self.motor
        self.tendons["estimate"]["elongation"] = self.tension / self.stiffness
        target, state = self.motor.copy(), (self.probe, self.tendons)
        probing.track_pulls(self.constants, LAYOUT, *state, DT)
        used = probing.step(
            CONFIG, self.constants, LAYOUT, *state, requested, self.motor, allowed, DT, target
        )
        self.set_tension(self.tension + self.stiffness * (target - self.motor))
        self.motor = target
        return used

    def set_tension(self, tension):
        """Let the tensions go there, as the hand or the environment makes them."""
        self.tension = np.maximum(tension, 1e-3)
        u = math.log(self.tension[0])
        self.tip = min(max(self.tip, u - self.K), u + self.K)

    def pull(self, *tensions):
        for tension in tensions:
            for T in np.linspace(self.tension[0], tension, 60):
                self.set_tension(np.array([T, 0.3]))
                self.tick(REST + T)

    def until(self, done, seconds=5.0):
        for _ in range(round(seconds / DT)):
            self.tick()
            if done():
                return True
        return False


@settings(max_examples=15, deadline=None)
@example([6.0], 3e4)
@example([1.25], 9e4)  # falls far within the lag of the averaged tension
@given(st.lists(st.floats(0.2, 12.0), min_size=1, max_size=5), st.floats(5e3, 1e5))
def test_the_tip_rests_whatever_was_pulled_before_with_the_least_friction(tensions, stiffness):
    rest = Rest(stiffness)
    rest.pull(*tensions)
    tips = [rest.tip]
    finished = rest.until(lambda: tips.append(rest.tip) or rest.probe.finished >= 0, 2.0)
    np.testing.assert_allclose(tips, tips[0], atol=1e-9)
    assert finished or tensions != [6.0]


def pulled():
    rest = Rest()
    rest.pull(6.0)
    assert rest.until(lambda: rest.motor[0] < -2e-5)
    return rest


def test_a_loaded_tendon_is_probed_again_and_again_and_the_slack_one_is_not():
    rest, results = pulled(), []
    for _ in range(3):
        assert rest.until(lambda: rest.probe.finished >= 0)
        results.append(probing.compute_share(rest.probe))
        assert rest.probe.finished == 0
        monitors = TendonMonitor.array(2)
        probing.transfer_probe_result(
            to_struct(MonitorConfig()), rest.constants, rest.probe, monitors
        )
        assert monitors["count"].tolist() == [1, 0]
    assert results == pytest.approx([1.0] * 3, abs=0.02)
    assert rest.motor[1] == 0.0


@pytest.mark.parametrize("change", ["hand", "force", "session", "sample"])
def test_what_changes_ends_a_probe_in_the_same_tick(change):
    rest = pulled()
    requested = REST + (1e-4 if change == "hand" else 0.0)
    if change == "force":
        rest.set_tension(rest.tension + np.array([0.0, 0.5]))
        assert any(not rest.tick() for _ in range(10))  # the tension is averaged over as much
    else:
        rest.tendons["valid"][1] = change != "sample"
        assert not rest.tick(requested, change != "session")
    assert rest.probe.tendon == -1
    rest.tendons["valid"] = True
    motor = rest.motor.copy()
    for _ in range(round(0.9 * PAUSE / DT)):
        assert not rest.tick(requested)
    np.testing.assert_array_equal(rest.motor, motor)


def test_a_tendon_without_friction_or_with_all_bends_at_the_tip_is_not_probed():
    far = Sheath((Section(1.3, math.inf), Section(0.2, 0.03)), 0.15, 9000.0)
    models = [TendonModel(sheath) for sheath in (Sheath.uniform(0.0, 1.5, 9000.0), far)]
    assert probing.build_probe_constants(models, SETTINGS)["depth"].tolist() == [0.0, 0.0]
    off = probing.build_probe_constants([MODEL], ProbingConfig())
    assert off["depth"].tolist() == [0.0]


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.6])
def test_friction_follows_from_the_share_of_travel_and_lies_in_its_interval(factor):
    constants = view_struct(probing.build_probe_constants([MODEL], SETTINGS))
    low, high = probing.estimate_friction(constants, 1.0 / factor)[1:]
    assert probing.estimate_friction(constants, 1.0 / factor)[0] == pytest.approx(
        factor * K, rel=5e-3
    )
    assert low < factor * K < high


def test_on_a_rig_a_few_seconds_of_rest_show_friction_and_the_tip_does_not_move():
    drawn = draw_joint(np.random.default_rng(7), 2)
    found = run_rest(drawn, seconds=4.0)
    assert len(found.K) >= 3
    assert abs(drawn.K_model / drawn.K - 1.0) > 0.1
    np.testing.assert_allclose(found.K, drawn.K, rtol=0.05)
    assert set(found.state) == {State.ENGAGED}
    assert set(found.probed) == {0, 1}
    assert np.ptp(found.tip[np.flatnonzero(found.probed)[0] :]) < 10e-6


def test_only_a_session_that_is_engaged_or_clutched_lets_motors_probe():
    session = view_struct(Session.array())
    for state in State:
        session.state = state
        assert may_probe(session) is (state in (State.ENGAGED, State.CLUTCHED))

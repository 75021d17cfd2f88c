"""The monitor, fed by the estimators of a simulated joint in use."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator.law.sheath import Sheath
from estimator.law.transmission import Phase
from estimator.online import online
from estimator.structs import to_struct, view_struct
from slave.calibration import monitor
from slave.calibration.monitor import Advice, MonitorConfig, TendonMonitor
from slave.config import SlaveConfig, load_tendon_configs
from slave.rig_layout import EstimatedTendon, build_rig_layout
from slave.rigs.simulated import SimulatedRig
from slave.sheath_section import SectionConfig
from slave.simulation.environment import LoadMotorConfig, TissueConfig
from tests.slave.calibration.calibration_bench import TIGHT_FIRST, effect, joint, rig_config

SETTINGS = MonitorConfig()
CONFIG = to_struct(SETTINGS)
RATE = 500.0  # [Hz]
TISSUE = TissueConfig(position=0.002, stiffness=20_000.0)
KEEP, GAIN = 0.3, 0.004  # [N] in the tendon that is drawn out, [m/s/N] by which it is kept
REACH, REST = 0.008, 0.1  # [m], [s] of a hand that presses and lets go


def hand(time_s, fastest=0.032):
    """Return the speed [m/s] of a joint that goes to and fro, smoothly, and rests at both ends."""
    leg = 2.0 * REACH / fastest
    place = time_s % (2.0 * (leg + REST))
    way = 1.0 if place < leg + REST else -1.0
    share = min((place % (leg + REST)) / leg, 1.0)
    return way * fastest * math.sin(math.pi * share) ** 2


def slow_hand(time_s):
    return hand(time_s, 0.016)


class Use:
    """A joint in use: what the monitor says at each moment."""

    def __init__(self, config, seconds, accepted=None, move=hand):
        models = load_tendon_configs(SlaveConfig(rig=accepted or config, calibration="as-built"), 2)
        self.models = [model.build_model() for model in models]
        prepared = [online.prepare(model) for model in self.models]
        constants = monitor.build_monitor_constants(self.models)
        states = [online.build_initial_state(p) for p in prepared]
        monitors = TendonMonitor.array(2)
        self.monitors = [view_struct(monitors, i) for i in range(2)]
        self.time, self.advice, self.errors = [], [], []
        rig, motor, dt = SimulatedRig(config), np.zeros(2), 1.0 / RATE
        for k in range(round(seconds * RATE)):
            for sample in rig.read(k * dt):
                T, q = sample.proximal_tension, sample.proximal_displacement
                estimates = [None, None]
                for i in range(2):
                    estimates[i], states[i] = online.step(prepared[i], states[i], T[i], q[i], dt)
                for i in range(2):
                    against = estimates[1 - i].distal_tension
                    monitor.step(
                        CONFIG, constants[i], monitors[i], estimates[i], T[i], q[i], against, dt
                    )
            self.time.append(k * dt)
            self.advice.append(monitor.compute_advice(CONFIG, monitors, 2))
            self.errors.append(monitors["force_error"].copy())
            speed = move(k * dt)
            for i, pulled in enumerate((speed > 0.0, speed < 0.0)):
                tension = sample.proximal_tension[i]
                kept = max(GAIN * (KEEP - tension), -0.005) - abs(speed)
                motor[i] += (abs(speed) if pulled else kept if speed else 0.0) * dt
            rig.write(motor)
        self.errors = np.array(self.errors)

    def first(self, advice):
        return next(t for t, said in zip(self.time, self.advice, strict=True) if said >= advice)


def test_a_sheath_that_keeps_its_shape_is_never_doubted():
    use = Use(rig_config(joint(1.0, environment=TISSUE)), 15.0)
    assert set(use.advice) == {Advice.NONE}
    assert max(one.count for one in use.monitors) == SETTINGS.transitions


@pytest.mark.parametrize(
    ("K", "change"), [(0.8, 0.25), pytest.param(1.2, -0.25, marks=pytest.mark.slow)]
)
def test_a_change_of_shape_is_found_within_4_s_of_use(K, change):
    start = 8.4
    step = effect("friction_step", change=change, start=start, tendon="a")
    use = Use(rig_config(joint(K, environment=TISSUE), effects=(step,)), start + 6.0)
    assert start < use.first(Advice.DEMANDED) < start + 4.0
    assert use.errors[-1, 0] == pytest.approx(math.expm1(K * change), abs=0.04)
    assert abs(use.errors[-1, 1]) < SETTINGS.advise


@pytest.mark.slow
def test_on_an_uneven_sheath_a_change_is_found_too_unless_all_bends_are_at_the_tip():
    start = 8.0
    step = effect("friction_step", change=0.25, start=start, tendon="a")
    uneven = joint(1.0, sections=TIGHT_FIRST, environment=TISSUE, nodes=200)
    use = Use(rig_config(uneven, effects=(step,)), start + 10.0, move=slow_hand)
    assert set(use.advice[: round(start * RATE)]) == {Advice.NONE}
    assert use.advice[-1] >= Advice.ADVISED
    assert 0.0 < use.errors[-1, 0] < math.expm1(0.25) + 0.03
    at_tip = joint(1.0, sections=(SectionConfig(1.3), SectionConfig(0.2, 0.05)))
    model = load_tendon_configs(SlaveConfig(rig=rig_config(at_tip), calibration="as-built"), 2)[
        0
    ].build_model()
    assert monitor.build_monitor_constants([model])[0]["blind"]
    straight = replace(model, sheath=Sheath.uniform(0.0, 1.5, 9000.0))
    assert monitor.build_monitor_constants([straight])[0]["blind"]


def test_a_tip_that_is_moved_by_its_environment_is_no_change_of_shape():
    breath = ((0.0, 0.0), (1.1, 2.0), (2.9, -2.0), (4.3, 0.0))
    pushed = LoadMotorConfig(profile=breath, repeat=True)
    use = Use(rig_config(joint(1.0, environment=pushed)), 15.0)
    assert set(use.advice) == {Advice.NONE}


def known(*errors, doubt=0.01):
    """Return the monitor of a tendon after transitions with these errors."""
    after = TendonMonitor.new(count=len(errors))
    after.errors[: len(errors)], after.uncertainties[: len(errors)] = errors, doubt
    return after


def test_transitions_that_contradict_each_other_say_nothing():
    assert monitor.compute_force_error(known(0.3, 0.9, 0.35, 0.88, -0.3)) == 0.0
    assert monitor.compute_force_error(known(0.0, 0.01, 0.28, 0.29, 0.27)) == 0.27


def test_an_error_within_its_doubt_says_nothing():
    assert monitor.compute_force_error(known(0.12, 0.11, 0.13, doubt=0.07)) == 0.0
    assert monitor.compute_force_error(known(-0.12, -0.11, -0.13, doubt=0.05)) == -0.12


def test_what_the_estimator_does_not_trust_does_not_count():
    model = online.TendonModel(Sheath.uniform(1.0, 1.5, 9000.0))
    prepared = online.prepare(model)
    estimate, _ = online.step(prepared, online.build_initial_state(prepared), 5.0, 0.0, 0.0)
    assert estimate.status & online.Status.UNINITIALISED
    tendon = known(0.1)
    tendon.pulled, tendon.reached, tendon.transition.points = True, 4.0, 3
    constants = monitor.build_monitor_constants([model])[0]
    monitor.step(CONFIG, constants, tendon, estimate, 5.0, 0.0, 0.0, 0.001)
    assert tendon.tobytes() == known(0.1).tobytes()


def test_a_rig_is_watched_tendon_by_tendon_against_the_other_of_its_joint():
    """`step_rig` is `step` of each, by the corrected readings."""
    rng, joints = np.random.default_rng(4), ((2, 0), (1,))
    model = online.TendonModel(Sheath.uniform(1.0, 1.5, 9000.0))
    constants, layout = (
        monitor.build_monitor_constants([model] * 3),
        view_struct(build_rig_layout(joints)),
    )
    alone, together = TendonMonitor.array(3), TendonMonitor.array(3)
    others = {0: 2, 2: 0}
    for k in range(400):
        tendons = EstimatedTendon.array(16)
        down = k % 100 - 50
        for i in range(3):
            tendon = view_struct(tendons, i)
            tendon.corrected_tension = 9.0 if down >= 0 else 60.0 + down
            tendon.corrected_displacement = -4e-6 * down * (1.0 + 0.1 * i)
            estimate = tendon.estimate
            estimate.distal_tension = 2.0 + rng.uniform(-0.01, 0.04)
            estimate.elongation = -4e-6 * down
            estimate.phase = int(Phase.PULL_TO_RELEASE if down >= 0 else Phase.PULL)
            estimate.front = 0.005 * down if down >= 0 else 1.5
        for i in range(3):
            tendon = view_struct(tendons, i)
            against = (
                view_struct(tendons, others[i]).estimate.distal_tension if i in others else 0.0
            )
            force, travel = tendon.corrected_tension, tendon.corrected_displacement
            monitor.step(
                CONFIG, constants[i], alone[i], tendon.estimate, force, travel, against, 0.001
            )
        said = monitor.step_rig(CONFIG, layout, constants, together, tendons, 0.001)
        assert said == monitor.compute_advice(CONFIG, alone, 3)
        assert together.tobytes() == alone.tobytes()
    assert alone["count"][1] == 3  # nothing moves against it
    assert alone["count"].sum() > 3

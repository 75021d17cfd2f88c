"""The monitor, fed by the estimators of a simulated joint in use."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator import online
from estimator.sheath import Sheath
from slave.calibration import monitor
from slave.calibration.monitor import Advice, MonitorConfig, Watch
from slave.config import SlaveConfig, tendon_configs
from slave.plant.environment import LoadMotorConfig, TissueConfig
from slave.plant.sheath import SectionConfig
from slave.rigs.simulated import SimulatedRig
from tests.slave.calibration_bench import TIGHT_FIRST, effect, joint, rig_config

CONFIG = MonitorConfig()
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

    def __init__(self, config, seconds, believed=None, move=hand):
        models = tendon_configs(SlaveConfig(rig=believed or config, calibration="as-built"), 2)
        self.models = [model.model() for model in models]
        prepared = [online.prepare(model) for model in self.models]
        watched = [monitor.prepare(model) for model in self.models]
        states = [online.initial(p) for p in prepared]
        self.watches = [Watch(), Watch()]
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
                    self.watches[i] = monitor.step(
                        CONFIG, watched[i], self.watches[i], estimates[i], T[i], q[i], against, dt
                    )
            self.time.append(k * dt)
            self.advice.append(monitor.advice(CONFIG, self.watches))
            self.errors.append([monitor.force_error(watch) for watch in self.watches])
            speed = move(k * dt)
            for i, pulled in enumerate((speed > 0.0, speed < 0.0)):
                tension = sample.proximal_tension[i]
                kept = max(GAIN * (KEEP - tension), -0.005) - abs(speed)
                motor[i] += (abs(speed) if pulled else kept if speed else 0.0) * dt
            rig.write(motor)
        self.errors = np.array(self.errors)

    def first(self, advice):
        return next(t for t, said in zip(self.time, self.advice, strict=True) if said >= advice)


@pytest.mark.parametrize("K", [0.6, 1.0, 1.5])
def test_a_sheath_that_keeps_its_shape_is_never_doubted(K):
    use = Use(rig_config(joint(K, environment=TISSUE)), 30.0)
    assert set(use.advice) == {Advice.NONE}
    assert max(len(watch.errors) for watch in use.watches) == CONFIG.transitions


@pytest.mark.parametrize("change", [0.25, -0.25])
@pytest.mark.parametrize("K", [0.8, 1.2])
def test_a_change_of_shape_is_found_within_4_s_of_use(K, change):
    start = 8.4
    step = effect("friction_step", change=change, start=start, tendon="a")
    use = Use(rig_config(joint(K, environment=TISSUE), effects=(step,)), start + 6.0)
    assert start < use.first(Advice.DEMANDED) < start + 4.0
    assert use.errors[-1, 0] == pytest.approx(math.expm1(K * change), abs=0.04)
    assert abs(use.errors[-1, 1]) < CONFIG.advise


def test_on_an_uneven_sheath_a_change_is_found_too_unless_all_bends_are_at_the_tip():
    start = 8.0
    step = effect("friction_step", change=0.25, start=start, tendon="a")
    uneven = joint(1.0, sections=TIGHT_FIRST, environment=TISSUE, nodes=200)
    use = Use(rig_config(uneven, effects=(step,)), start + 10.0, move=slow_hand)
    assert set(use.advice[: round(start * RATE)]) == {Advice.NONE}
    assert use.advice[-1] >= Advice.ADVISED
    assert 0.0 < use.errors[-1, 0] < math.expm1(0.25) + 0.03
    at_tip = joint(1.0, sections=(SectionConfig(1.3), SectionConfig(0.2, 0.05)))
    model = tendon_configs(SlaveConfig(rig=rig_config(at_tip), calibration="as-built"), 2)[
        0
    ].model()
    assert monitor.prepare(model).blind
    straight = replace(model, sheath=Sheath.uniform(0.0, 1.5, 9000.0))
    assert monitor.prepare(straight).blind


def test_a_smaller_change_is_advised_of_but_not_demanded():
    believed = rig_config(joint(1.0, environment=TISSUE))
    use = Use(rig_config(joint(1.1, environment=TISSUE)), 12.0, believed)
    assert use.advice[-1] is Advice.ADVISED


@pytest.mark.parametrize("swing", [0.8, 2.0])
def test_a_tip_that_is_moved_by_its_environment_is_no_change_of_shape(swing):
    breath = ((0.0, 0.0), (1.1, swing), (2.9, -swing), (4.3, 0.0))
    pushed = LoadMotorConfig(profile=breath, repeat=True)
    use = Use(rig_config(joint(1.0, environment=pushed)), 30.0)
    assert set(use.advice) == {Advice.NONE}


def watch(*errors, doubt=0.01):
    return Watch(errors=errors, doubts=(doubt,) * len(errors))


def test_nothing_is_said_before_three_transitions():
    assert monitor.force_error(watch(0.5, 0.5)) == 0.0
    assert monitor.force_error(watch(0.5, 0.5, 0.5)) == 0.5
    assert monitor.force_error(watch(0.5, 0.0, 0.0, 0.01)) < 0.01


def test_transitions_that_contradict_each_other_say_nothing():
    assert monitor.force_error(watch(0.3, 0.9, 0.35, 0.88, -0.3)) == 0.0
    assert monitor.force_error(watch(0.0, 0.01, 0.28, 0.29, 0.27)) == 0.27


def test_an_error_within_its_doubt_says_nothing():
    assert monitor.force_error(watch(0.12, 0.11, 0.13, doubt=0.07)) == 0.0
    assert monitor.force_error(watch(-0.12, -0.11, -0.13, doubt=0.05)) == -0.12


def test_what_the_estimator_does_not_trust_does_not_count():
    model = online.TendonModel(Sheath.uniform(1.0, 1.5, 9000.0))
    prepared = online.prepare(model)
    estimate, _ = online.step(prepared, online.initial(prepared), 5.0, 0.0, 0.0)
    assert estimate.status & online.Status.UNINITIALISED
    known = watch(0.1)
    before = known._replace(pulled=True)
    after = monitor.step(CONFIG, monitor.prepare(model), before, estimate, 5.0, 0.0, 0.0, 0.001)
    assert after == known


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"advise": 0.0}, "advise"),
        ({"advise": 0.2}, "advise"),
        ({"demand": 11.0}, "advise"),
        ({"transitions": 2}, "transitions"),
    ],
)
def test_thresholds_that_mean_nothing_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        MonitorConfig(**wrong)

"""The hand and the rig of the bench, against mechanics."""

import math

import numpy as np
import pytest

from studies.transparency.hand import DT, Arm, Device, Encoder, GuidedHand, HandModel, reach
from studies.transparency.rig import TENDON, Rig, free, tissue, wall


def test_an_arm_swings_as_a_mass_on_a_spring_and_damper_does():
    model, device = HandModel(0.2, 300.0, 2.0), Device(mass=0.1, damping=1.0)
    arm = Arm(lambda _t: 0.0, model, device)
    for _ in range(200):
        arm.advance(1.5)
    m, k, b = 0.3, 300.0, 3.0
    decay, t = b / (2 * m), 200 * DT
    w = math.sqrt(k / m - decay**2)
    swing = math.exp(-decay * t) * (math.cos(w * t) + decay / w * math.sin(w * t))
    assert arm.position == pytest.approx(1.5 / k * (1.0 - swing), rel=1e-9)


def test_an_arm_goes_where_it_wants_to_be():
    arm = Arm(reach(0.01, 0.1, 0.3))
    for _ in range(3000):
        arm.advance(0.0)
    assert arm.position == pytest.approx(0.01, rel=1e-6)


def test_a_guided_hand_is_moved_by_nothing():
    hand = GuidedHand(lambda t: math.sin(3.0 * t))
    for _ in range(500):
        hand.advance(100.0)
    assert hand.position == pytest.approx(math.sin(1.5))
    assert hand.velocity == pytest.approx(3.0 * math.cos(1.5), rel=1e-6)


def test_an_encoder_tells_steps_and_a_filtered_velocity():
    encoder = Encoder(Device(resolution=1e-4, smoothing=0.01))
    told = [encoder.read(0.02 * k * DT, math.nan) for k in range(1000)]
    position = np.array([x for x, _ in told])
    assert np.unique(np.round(np.diff(position) / 1e-4, 9)).tolist() == [0.0, 1.0]
    assert np.mean([v for _, v in told[500:]]) == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize("meets", [free, wall(1e4), wall(100.0), tissue()])
def test_at_the_tip_tension_and_load_are_in_balance(meets):
    rig = Rig(meets, noise=0.0)
    rig.wanted = (0.004,)
    for k in range(300):
        rig.advance(0.5 * math.sin(0.1 * k))
        (sample,) = rig.read()
        tension = sample.proximal_tension[0]
        assert tension == pytest.approx(rig.load(), abs=1e-6)
        assert rig.tip == pytest.approx(sample.proximal_displacement[0] - tension / TENDON)
    assert sample.proximal_displacement[0] == pytest.approx(0.004)


def test_a_damped_tip_pays_for_its_speed():
    rig = Rig(free, spring=0.0, damping=20.0, noise=0.0)
    rig.wanted = (0.1,)
    before = 0.0
    for _ in range(50):
        before = rig.tip
        rig.advance()
    assert rig.load() == pytest.approx(1.0 + 20.0 * (rig.tip - before) / DT, rel=1e-6)

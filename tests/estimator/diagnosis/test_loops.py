"""Transmissions besides a tendon whose motor travel is known: loops, torque and angle.

Data of loops are made by masses, springs and bristles in time
(`studies.hidden_effects.loop`), which share nothing with the estimator.
"""

import numpy as np
import pytest

import estimator as est
from estimator.diagnosis.api import diagnose
from estimator.diagnosis.dataset import BaseLaw
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import RecordError
from estimator.measured_data import Samples
from estimator.units import ROTARY
from studies import hidden_effects
from studies.hidden_effects.loop import Loop, draw_motion, run

ANGLE_NOISE = 5e-5  # [rad]
TORQUE_NOISE = 0.002  # of the range


def recorded(loop, seed=1, duration=24.0, rate=60.0):
    """Return a noisy record of a loop."""
    time, angle = draw_motion(seed, duration, rate)
    torque, at_tip, turned = run(loop, time, angle)
    rng = np.random.default_rng(seed)

    def noisy(signal, sigma):
        return signal + sigma * rng.standard_normal(len(time))

    return Samples(
        time,
        noisy(torque, TORQUE_NOISE * np.ptp(torque)),
        noisy(angle, ANGLE_NOISE),
        noisy(at_tip, TORQUE_NOISE * np.ptp(at_tip)),
        noisy(turned, ANGLE_NOISE),
        ROTARY,
    )


def expected(loop):
    """Return what a diagnosis must find of a loop, in its units."""
    r = loop.radius
    found = {"L/EA": 1.0 / loop.stiffness / r**2}
    if loop.spring:
        found["tip compliance"] = 1.0 / loop.spring / r**2
    if loop.K:
        found |= {"K": loop.K, "pretension": loop.pretension * r}
    if loop.friction:
        found["friction"] = loop.friction * r
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loop", "law"),
    [
        (Loop(K=0.5, spring=0.0), BaseLaw.CAPSTAN),
        (Loop(K=0.0, friction=2.0, give=2e-5, pretension=4.0), BaseLaw.INDEPENDENT),
    ],
    ids=["capstan", "load-independent"],
)
def test_law_stiffness_and_friction_are_found(loop, law):
    found = diagnose(recorded(loop), effects=[])
    assert found.dataset.base.law is law
    wrong = BaseLaw.INDEPENDENT if law is BaseLaw.CAPSTAN else BaseLaw.CAPSTAN
    assert wrong not in found.laws.equivalents  # both together have either within
    assert found.verdict is Verdict.CLEAN
    for name, true in expected(loop).items():
        number = found.parameters[name]
        assert number.low < true < number.high, name
        assert number.high - number.low < 0.5 * true, name
    assert f"| {law}" in est.summarise_result(found)
    assert "rad/(N m)" in est.summarise_result(found)


def test_a_loop_needs_the_angle_that_drives_it():
    time = np.arange(400) / 50.0
    torque = 0.1 * np.sin(time)
    with pytest.raises(RecordError, match="angle at the housing is needed"):
        diagnose(Samples(time, torque, None, 0.5 * torque, None, ROTARY))


def test_torque_of_one_sign_is_that_of_one_cable():
    time = np.arange(400) / 50.0
    torque = 0.1 * np.sin(time) ** 2
    found = diagnose(Samples(time, torque, None, 0.5 * torque, None, ROTARY), effects=[])
    assert not found.dataset.records[0].loop
    assert found.noise["distal_tension"] < 1e-3


def test_tension_and_the_tips_travel_are_enough():
    channels = ("proximal_tension", "distal_displacement")
    made = hidden_effects.make(3, (), bench="spring", channels=channels, duration=30.0, rate=50.0)
    tension, tip = (made.channels[name] for name in channels)
    found = diagnose(Samples(made.time, tension, None, None, tip), effects=[])
    assert found.verdict is Verdict.CLEAN
    sheath = made.truth["sheath"]
    for name, true in {"K": sheath["K"], "tip compliance": 1.0 / sheath["k"]}.items():
        assert found.parameters[name].low < true < found.parameters[name].high

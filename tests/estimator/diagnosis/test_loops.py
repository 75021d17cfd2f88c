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
from estimator.effects.effect import PROXIMAL_DISPLACEMENT, EffectContext
from estimator.effects.ends import LINK_GRAVITY
from estimator.lumped.loop_model import simulate_loop
from estimator.lumped.lumped_model import Physics
from estimator.lumped.nodes import build_even_weights
from estimator.measured_data import Samples
from estimator.units import ROTARY
from studies import hidden_effects
from studies.hidden_effects.controls import ANGLE, move_motor
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


WEIGHT = 1.5, -0.6  # [N m] sine and cosine


@pytest.mark.parametrize("zero", [0.0, 40.0])
def test_a_weight_adds_its_torque_to_that_of_the_spring(zero):
    time, angle = draw_motion(4, 10.0, 50.0)
    speed, none = np.gradient(angle, time), np.zeros_like(time)
    physics = Physics(np.full(len(time), 1e-4), 1e-4, build_even_weights(), tip_compliance=0.3)
    context = EffectContext(time, PROXIMAL_DISPLACEMENT, angle + zero, speed, {}, {}, none, 1e-4)
    values = LINK_GRAVITY.shift_encoder_zero(WEIGHT, zero)
    loaded = LINK_GRAVITY.physics(physics, values, context)
    torque = simulate_loop(loaded, 5.0, time, angle, speed).distal_tension
    line = 1.0 / 0.3 - np.hypot(*WEIGHT)  # the spring's is that of both where the link hangs
    others = torque - WEIGHT[0] * np.sin(angle) - WEIGHT[1] * np.cos(angle) - line * angle
    assert np.ptp(others) < 2e-3 * np.ptp(torque)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["link_gravity", "cogging_ripple"])
def test_the_weight_of_a_link_and_a_ripple_are_told_apart(cause):
    rng = np.random.default_rng(3)
    motion = move_motor(rng, sine=False)
    angle = ANGLE * motion.travel
    torque = 0.3 * np.tanh(ANGLE * motion.speed / 0.01)
    if cause == "link_gravity":
        torque += WEIGHT[0] * np.sin(angle) + WEIGHT[1] * np.cos(angle)
    else:
        torque += 1.5 * (angle - angle.mean()) + 0.1 * np.sin(9.0 * angle)
    torque += 5e-3 * rng.standard_normal(len(angle))
    read = angle + 1e-4 * rng.standard_normal(len(angle))
    found = diagnose(
        Samples(motion.time, torque, read, None, None, ROTARY), ["link_gravity", "cogging_ripple"]
    )
    assert found.causes == (cause,)
    if cause == "link_gravity":
        numbers = [found.parameters[f"link_gravity.{name}"] for name in ("sine", "cosine")]
        assert all(n.low < true < n.high for n, true in zip(numbers, WEIGHT, strict=True))
    else:
        assert found.verdict is Verdict.NAMED
        assert found.parameters["cogging_ripple.number"].value == pytest.approx(9.0, rel=0.02)

"""Hybrid parameters of a two-port that is known in closed form, and of one that is not linear."""

import numpy as np
import pytest

from master.device import HandState
from studies.transparency import hybrid
from studies.transparency.hand import Device
from studies.transparency.hybrid import Excitation, draw_multisine, response, spectrum
from tests.studies.transparency.two_ports import DelayedSpringDamper

BRIEF = Excitation(
    period=1.0, harmonics=(1, 3, 7, 15, 31, 49), settle=0.5, periods=1, draws=2, speed=0.01
)
PARAMETERS = ("h11", "h12", "h21", "h22")


IDEAL = Device()


def measured(device=IDEAL, build=DelayedSpringDamper):
    return hybrid.measure(build, BRIEF, device, DelayedSpringDamper.a, 0.0)


def test_a_known_two_port_is_found():
    device = Device(mass=0.2, damping=0.7)
    found = measured(device)
    s = 2j * np.pi * found.frequency
    known = DelayedSpringDamper.parameters(found.frequency)
    known["h11"] = known["h11"] + device.mass * s + device.damping
    for name in PARAMETERS:
        answer = getattr(found, name)
        error = np.abs(answer.value - known[name]) / np.abs(known[name])
        assert error.max() < 0.01, name
        assert answer.coherence.min() > 0.999, name
        assert answer.distortion < 0.01, name


def test_a_step_of_the_encoder_is_not_in_the_true_motion():
    fine, coarse = (measured(Device(resolution=step)) for step in (0.0, 1e-4))
    assert coarse.h21.value[0] == pytest.approx(fine.h21.value[0], rel=0.05)
    assert coarse.h21.distortion > 3.0 * fine.h21.distortion


def test_what_is_not_linear_is_seen():
    class Clipped(DelayedSpringDamper):
        def tick(self, hand, push):
            slow = 0.3e-3 * np.tanh(hand.position[0] / 0.3e-3)
            return super().tick(HandState((slow,), hand.velocity, True), push)

    found = measured(build=Clipped)
    assert found.h21.coherence.min() < 0.95
    assert found.h21.distortion > 0.05
    assert found.h12.coherence.min() > 0.999


def test_amplitude_and_phase_of_a_line_are_those_of_its_time():
    time = np.arange(0.25, 1.25, 1e-3)
    lines = spectrum(3.0 * np.cos(2 * np.pi * 5.0 * (time - 0.02)), time, np.array([4.0, 5.0]))
    assert lines == pytest.approx([0.0, 3.0 * np.exp(-0.2j * np.pi)], abs=1e-9)


def test_coherence_falls_with_noise_as_it_must():
    rng = np.random.default_rng(1)
    given = np.exp(2j * np.pi * rng.random((4000, 1)))
    noise = rng.normal(size=(4000, 2)) @ np.array([1.0, 1j])
    answer = 2.0 * given + noise[:, None]  # powers 4 and 2
    found = response(given, answer, np.zeros((4000, 1), complex))
    assert found.value[0] == pytest.approx(2.0, abs=0.1)
    assert found.coherence[0] == pytest.approx(4.0 / 6.0, abs=0.03)


def test_a_multisine_has_its_lines_and_no_other():
    signal = draw_multisine(2.0, (1, 5), np.array([1.0, 0.5]), seed=3)
    time = np.arange(0.0, 2.0, 1e-3)
    values = np.array([signal.at(t) for t in time])
    size = np.abs(spectrum(values, time, np.arange(1, 8) / 2.0))
    assert size == pytest.approx([1.0, 0, 0, 0, 0.5, 0, 0], abs=1e-9)

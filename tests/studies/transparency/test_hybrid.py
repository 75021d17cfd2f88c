"""Hybrid parameters of a two-port that is known in closed form, and of one that is not linear."""

import numpy as np

from master.device import HandState
from studies.transparency import hybrid
from studies.transparency.hand import Device
from studies.transparency.hybrid import Excitation
from tests.studies.transparency.two_ports import DelayedSpringDamper

BRIEF = Excitation(
    period=1.0, harmonics=(1, 3, 7, 15, 31, 49), settle=0.5, periods=1, draws=2, speed=0.01
)
PARAMETERS = ("h11", "h12", "h21", "h22")


IDEAL = Device()


def measured(device=IDEAL, build=DelayedSpringDamper):
    return hybrid.measure_hybrid(build, BRIEF, device, DelayedSpringDamper.a, 0.0)


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


def test_what_is_not_linear_is_seen():
    class Clipped(DelayedSpringDamper):
        def tick(self, hand, push):
            slow = 0.3e-3 * np.tanh(hand.position[0] / 0.3e-3)
            return super().tick(HandState((slow,), hand.velocity, True), push)

    found = measured(build=Clipped)
    assert found.h21.coherence.min() < 0.95
    assert found.h21.distortion > 0.05
    assert found.h12.coherence.min() > 0.999

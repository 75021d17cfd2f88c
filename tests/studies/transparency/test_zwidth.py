"""The Z-width of a wall that is known, and of the live couplings."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from studies.transparency import zwidth
from studies.transparency.hand import DT, Device, HandModel
from tests.studies.transparency.two_ports import VirtualWall

CONTACT = 0.0015  # [m]


def limit(mass, stiffness, damping):
    """Return up to which stiffness [N/m] a held, sampled spring is stable: by its eigenvalues."""
    flow = np.zeros((3, 3))
    flow[0, 1] = 1.0
    flow[1] = [-stiffness / mass, -damping / mass, 1.0 / mass]
    step = expm(flow * DT)

    def stable(k):
        closed = step[:2, :2] - k * np.outer(step[:2, 2], [1.0, 0.0])
        return np.abs(np.linalg.eigvals(closed)).max() < 1.0

    low, high = 10.0, 1e6
    while high / low > 1.0001:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


@pytest.mark.parametrize("damping", [1.0, 2.0])
def test_a_virtual_wall_is_stable_up_to_where_it_is(damping):
    hand, device = HandModel(0.1, 100.0, 0.0), Device(damping=damping)

    def stable(k):
        return zwidth.has_settled(zwidth.push_wall(VirtualWall(k, CONTACT), hand, device, CONTACT))

    found = zwidth.find_largest_width(stable, 100.0, 1e5, 4.0, 1.02)
    truth = limit(hand.mass, hand.stiffness, damping)
    assert found.stable == pytest.approx(truth, rel=0.04)
    assert truth == pytest.approx(2.0 * damping / DT, rel=0.05)  # Colgate: b > K T / 2


def test_a_gap_is_not_jumped():
    found = zwidth.find_largest_width(lambda k: k < 50.0 or k > 500.0, 10.0, 1000.0, 10.0, 1.1)
    assert found.unstable <= 60.0

"""Stiffness felt: of springs that are known, and through the live loops."""

import pytest

from studies.transparency.hand import Device
from studies.transparency.rig import Rig, wall
from studies.transparency.stiffness import press
from studies.transparency.system import Network, Teleoperator, rig_model, settings
from teleop.coupling import Bilateral, DirectConfig
from tests.studies.transparency.two_ports import VirtualWall


def test_a_known_spring_is_felt_as_it_is():
    found = press(VirtualWall(60.0), 500.0, (0.4, 0.5), 0.0, Device())
    assert found.felt == pytest.approx(60.0)
    assert found.rendered == pytest.approx(60.0 / (0.4 * 0.5 * 500.0))
    assert found.ripple < 1e-9


def test_direct_renders_a_soft_spring_through_both_loops():
    network = Network(0.020)
    system = Teleoperator(
        Bilateral(coupling=DirectConfig()),
        Rig(wall(500.0, 0.0), spring=0.0),
        network,
        settings(0.3, 0.5, network),
        rig_model(1e-3),
    )
    found = press(system, 500.0, (0.3, 0.5), 0.020, Device())
    # 95 % of the tendon's stretch is made up for: 500 N/m are in series with 6000/0.05
    assert found.rendered == pytest.approx(1.0 / (1.0 + 500.0 * 0.05 / 6000.0), rel=0.01)

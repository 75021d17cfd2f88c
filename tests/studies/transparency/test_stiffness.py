"""Stiffness felt: of springs that are known, and through the live loops."""

import pytest

from studies.transparency.hand import Device
from studies.transparency.stiffness import press_spring
from tests.studies.transparency.two_ports import VirtualWall


def test_a_known_spring_is_felt_as_it_is():
    found = press_spring(VirtualWall(60.0), 500.0, (0.4, 0.5), 0.0, Device())
    assert found.felt == pytest.approx(60.0)
    assert found.rendered == pytest.approx(60.0 / (0.4 * 0.5 * 500.0))
    assert found.ripple < 1e-9

"""The force at an arm's tip on planes, estimated from the housings of its tendons."""

import math

import pytest

from studies import arm as study


@pytest.mark.parametrize(
    "normal",
    [study.NORMALS[0], *(pytest.param(n, marks=pytest.mark.slow) for n in study.NORMALS[2::2])],
)
def test_the_force_of_a_plane_is_inside_its_interval_and_most_often_has_its_direction(normal):
    pytest.importorskip("urdf_parser_py")
    found = study.press_plane(normal)
    assert found.force > 1.5  # [N]
    assert found.told == found.inside == 1.0
    assert found.angle[0] < math.radians(5.0)
    assert found.size[0] < 0.15

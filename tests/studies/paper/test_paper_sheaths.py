import math
from itertools import pairwise

import numpy as np
import pytest

from studies.paper.bench import KINDS, random_sheaths
from studies.paper.study import unevenness

COUNT = 80


@pytest.fixture(scope="module")
def sheaths():
    return random_sheaths(COUNT, 3)


def test_every_sheath_is_within_the_ranges_that_are_promised(sheaths):
    for specimen in sheaths:
        assert 1.0 <= specimen.length <= 2.0
        assert 5e3 <= specimen.sheath.axial_stiffness <= 15e3
        assert 0.05 <= specimen.sheath.friction <= 0.3
        assert 0.01 <= specimen.tension_noise <= 0.03
        assert 1 <= len(specimen.sheath.sections) <= 5
        for section in specimen.sheath.sections:
            assert 0.03 <= section.radius <= 1.0 or math.isinf(section.radius)
            assert section.length >= 0.05 * specimen.length * (1 - 1e-9)


def test_friction_is_spread_evenly_over_its_range(sheaths):
    K = np.sort([specimen.K for specimen in sheaths])
    edges = np.linspace(0.4, 1.8, COUNT + 1)
    assert np.all((edges[:-1] <= K) & (edges[1:] >= K))


def test_each_kind_is_a_quarter_and_bent_where_it_says(sheaths):
    kinds = [specimen.kind for specimen in sheaths]
    assert {kind: kinds.count(kind) for kind in KINDS} == dict.fromkeys(KINDS, COUNT // 4)
    for specimen in sheaths:
        radii = [section.radius for section in specimen.sheath.sections]
        if specimen.kind == "uniform":
            assert len(radii) == 1
            assert unevenness(specimen) == pytest.approx(0.0, abs=1e-9)
        if specimen.kind == "bends at the motor":
            assert all(a <= b for a, b in pairwise(radii))
            assert unevenness(specimen) > 0.0
        if specimen.kind == "bends at the tip":
            assert all(a >= b for a, b in pairwise(radii))
            assert unevenness(specimen) < 0.0
    assert any(math.isinf(s.radius) for specimen in sheaths for s in specimen.sheath.sections)


def test_unevenness_is_the_one_of_theory():
    from slave.sheath_section import SectionConfig
    from slave.simulation.tendon import SheathConfig
    from studies.paper.bench import Specimen

    bends = (SectionConfig(0.2, 0.05), SectionConfig(1.3, 0.5))
    for sections, ratio in ((bends, 1.59), (bends[::-1], 0.63)):
        specimen = Specimen(1, "by hand", SheathConfig(sections, friction=0.15), 0.01)
        assert math.exp(unevenness(specimen)) == pytest.approx(ratio, abs=0.01)


def test_a_seed_gives_the_same_sheaths_and_another_others():
    assert random_sheaths(6, 5) == random_sheaths(6, 5)
    assert random_sheaths(6, 5) != random_sheaths(6, 6)


def test_a_sheath_says_how_to_make_it_again(sheaths):
    specimen = next(s for s in sheaths if any(math.isinf(p.radius) for p in s.sheath.sections))
    text = str(specimen)
    assert f"sheath {specimen.number}: K {specimen.K:.2f}" in text
    assert text.count(" mm") == len(specimen.sheath.sections)
    assert "straight" in text

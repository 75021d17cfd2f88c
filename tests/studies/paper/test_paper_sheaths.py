import math

import pytest

from studies.paper.bench import random_sheaths
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


def test_unevenness_is_the_one_of_theory():
    from slave.sheath_section import SectionConfig
    from slave.simulation.tendon import SheathConfig
    from studies.paper.bench import Specimen

    bends = (SectionConfig(0.2, 0.05), SectionConfig(1.3, 0.5))
    for sections, ratio in ((bends, 1.59), (bends[::-1], 0.63)):
        specimen = Specimen(1, "by hand", SheathConfig(sections, friction=0.15), 0.01)
        assert math.exp(unevenness(specimen)) == pytest.approx(ratio, abs=0.01)

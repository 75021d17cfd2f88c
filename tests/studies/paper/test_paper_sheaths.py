import math

import pytest

from studies.paper.study import compute_unevenness


def test_unevenness_is_the_one_of_theory():
    from slave.sheath_section import SectionConfig
    from slave.simulation.tendon import SheathConfig
    from studies.paper.bench import Specimen

    bends = (SectionConfig(0.2, 0.05), SectionConfig(1.3, 0.5))
    for sections, ratio in ((bends, 1.59), (bends[::-1], 0.63)):
        specimen = Specimen(1, "by hand", SheathConfig(sections, friction=0.15), 0.01)
        assert math.exp(compute_unevenness(specimen)) == pytest.approx(ratio, abs=0.01)

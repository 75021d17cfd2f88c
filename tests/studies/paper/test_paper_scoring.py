import math

import numpy as np
import pytest

from slave.sheath_section import SectionConfig
from slave.simulation.tendon import SheathConfig
from studies.paper.bench import Specimen
from studies.paper.study import PHASES, compute_errors, compute_unevenness, label_phases


def test_errors_are_shares_of_the_runs_largest_truth():
    truth = np.array([0.0, 4.0, 2.0, 1.0])
    estimate = np.array([0.4, 3.0, 2.2, 1.0])
    found = compute_errors(estimate, truth)
    assert found.largest == pytest.approx(1.0 / 4.0)
    assert found.average == pytest.approx((0.4 + 1.0 + 0.2 + 0.0) / 4.0 / 4.0)
    late = compute_errors(estimate, truth, np.array([False, False, True, True]))
    assert late.largest == pytest.approx(0.2 / 4.0)
    assert late.average == pytest.approx(0.1 / 4.0)


def test_phases_follow_the_tip():
    # per leg: T_in turns, the tip waits three samples, then follows
    T_in = np.array([0, 5, 10, 20, 15, 10, 6, 4, 2, 6, 10, 14, 18, 20], dtype=float)
    T_out = np.array([0, 2, 4, 8, 8, 8, 8, 7, 4, 4, 4, 4, 7, 8], dtype=float)
    leg = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2])
    names = [PHASES[i] for i in label_phases(leg, T_in, T_out)]
    assert names == (
        ["pull"] * 3
        + ["pull to release"] * 4
        + ["release"]
        + ["release to pull"] * 4
        + ["pull again"] * 2
    )


def test_unevenness_is_the_one_of_theory():
    bends = (SectionConfig(0.2, 0.05), SectionConfig(1.3, 0.5))
    for sections, ratio in ((bends, 1.59), (bends[::-1], 0.63)):
        specimen = Specimen(1, "by hand", SheathConfig(sections, friction=0.15), 0.01)
        assert math.exp(compute_unevenness(specimen)) == pytest.approx(ratio, abs=0.01)

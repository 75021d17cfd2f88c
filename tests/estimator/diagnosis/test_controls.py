"""A record of no sheath is said to show none."""

import numpy as np
import pytest

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record
from estimator.effects import CATALOGUE

TIME = np.arange(1000) * 0.02
EFFECTS = [effect for effect in CATALOGUE if effect.name in ("viscous_friction", "creep")]


def diagnosed(time_limit=60.0, **channels):
    noise = {"tension": 0.02, "displacement": 5e-7}
    rng = np.random.default_rng(7)
    noisy = {
        name: y + noise[name.partition("_")[2]] * rng.standard_normal(len(y))
        for name, y in channels.items()
    }
    return diagnose_records([prepare_record(TIME, noisy)], EFFECTS, time_limit=time_limit)


@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_a_wire_on_a_spring_shows_no_sheath(friction):
    travel = 2e-3 * (1.0 + np.sin(2.0 * np.pi * 0.3 * TIME))
    tension = 3000.0 * travel + 1.0
    sign = np.sign(np.gradient(travel))
    found = diagnosed(
        proximal_tension=tension * np.exp(friction * np.maximum(sign, 0.0))
        if friction
        else tension,
        proximal_displacement=travel,
        distal_tension=tension,
    )
    assert not found.untried
    said = report_text.format_headline(found)
    assert ("no friction" in said) == (friction == 0.0)
    if not friction:
        assert found.verdict is Verdict.CLEAN
        assert "of a plain spring the data would look the same" in report_text.format_verdict(found)


def test_a_damped_spring_shows_no_sheath():
    travel = 5e-3 * (1.0 - np.cos(2.0 * np.pi * 0.4 * TIME))
    tension = 5.0 + 2000.0 * travel + 80.0 * np.gradient(travel, TIME)
    found = diagnosed(proximal_tension=tension, proximal_displacement=travel)
    assert found.causes == ("viscous_friction",)
    assert report_text.format_headline(found).startswith("Nothing of a sheath is seen, no friction")


def test_what_the_time_limit_left_out_is_said():
    travel = 2e-3 * (1.0 + np.sin(2.0 * np.pi * 0.3 * TIME))
    tension = 3000.0 * travel * (1.0 + 0.2 * np.sin(TIME)) + 1.0
    found = diagnosed(
        time_limit=0.0,
        proximal_tension=tension,
        proximal_displacement=travel,
        distal_tension=tension,
    )
    assert "pairs of causes" in found.untried
    assert "time limit: pairs of causes" in report_text.list_next_steps(found)[-1]

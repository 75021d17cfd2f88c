"""A record of no sheath is said to show none."""

import numpy as np
import pytest

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record
from estimator.effects import CATALOGUE
from studies.hidden_effects.controls import CONTROLS, JOINTS, judge

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


@pytest.mark.parametrize("friction", [0.0, 0.3])
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
    assert bool(found.foreign_reason) == (friction == 0.0)
    if not friction:
        assert found.verdict is Verdict.UNEXPLAINED
        said = report_text.format_headline(found)
        assert said.startswith("This is not a tendon-sheath transmission: no friction grows with")


SOME = "damped spring", "hardening spring", "cable with friction of any load", "random walk"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=() if n in SOME else pytest.mark.slow)
        for n in CONTROLS
        if n not in JOINTS
    ],
)
def test_no_cause_is_named_of_a_mechanism_without_a_sheath(name):
    assert judge(name, 7, tip=False).right


@pytest.mark.slow
def test_the_weight_of_a_link_is_among_what_is_named_of_it():
    result = judge("link with gravity and dry friction", 1, tip=False)
    assert result.right
    assert result.named[0] == "link_gravity"


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

"""Shapes of effects that a fit must not end in, and which of equal causes is named."""

import numpy as np
import pytest

from estimator.diagnosis.cause_selection import select_simplest_cause
from estimator.diagnosis.dataset import Model, build_dataset, simulate_dataset
from estimator.diagnosis.record import prepare_record
from estimator.diagnosis.scoring import compute_errors
from estimator.diagnosis.screening import Candidate
from estimator.effects.ends import ANTAGONIST_TENSION, JOINT_FRICTION

PLAIN = Model((0.8, 1.6e-4, 4e-4), ((0.0,),), ())


@pytest.fixture(scope="module")
def bench():
    time = np.arange(1000) * 0.02
    q = 1e-3 * (1.0 - np.cos(time))
    return build_dataset(
        [prepare_record(time, {"proximal_tension": 5e3 * q, "proximal_displacement": q})]
    )


def test_of_causes_that_are_as_good_as_each_other_the_simplest_is_named(bench):
    fit = simulate_dataset(bench, [None], PLAIN)
    base = compute_errors(bench, fit)

    def candidate(effect, values, better):
        held_out = {
            c: one._replace(normalised_squares=one.normalised_squares / better)
            for c, one in base.items()
        }
        model = PLAIN._replace(effects=((effect, values),))
        return Candidate(effect, fit._replace(model=model), held_out, 0.0)

    bent = candidate(ANTAGONIST_TENSION, (4.8, 0.06, 1e6), 100.0)
    plain = candidate(JOINT_FRICTION, (0.3,), 100.0)
    worse = candidate(JOINT_FRICTION, (0.3,), 15.0)  # scores as much, and leaves more
    assert select_simplest_cause(bench, fit, base, [bent, plain]) is plain
    assert select_simplest_cause(bench, fit, base, [bent, worse]) is bent

"""Shapes of effects that a fit must not end in, and which of equal causes is named."""

from dataclasses import replace

import numpy as np
import pytest

from estimator.diagnosis.causes import select_simplest_cause
from estimator.diagnosis.dataset import (
    Model,
    build_dataset,
    build_unsimulated_contexts,
    simulate_dataset,
)
from estimator.diagnosis.fit import ParameterLayout, _run_least_squares
from estimator.diagnosis.measured_data import prepare_record
from estimator.diagnosis.scoring import compute_errors
from estimator.diagnosis.screening import Candidate, _reset_shapes_at_bound
from estimator.effects.ends import ANTAGONIST_TENSION, JOINT_FRICTION
from estimator.effects.friction import STRIBECK_WITH_MEMORY
from estimator.effects.sensors import COGGING_RIPPLE

PLAIN = Model((0.8, 1.6e-4, 4e-4), ((0.0,),), ())


@pytest.fixture(scope="module")
def bench():
    time = np.arange(1000) * 0.02
    q = 1e-3 * (1.0 - np.cos(time))
    return build_dataset(
        [prepare_record(time, {"proximal_tension": 5e3 * q, "proximal_displacement": q})]
    )


def test_a_ripple_turns_through_a_wave_or_it_may_be_a_bias(bench):
    values = (0.1, 0.1, 4000.0)
    layout = ParameterLayout(bench, PLAIN._replace(effects=((COGGING_RIPPLE, values),)))
    low, _ = layout.bounds()
    at = layout.names.index("cogging_ripple.number")
    assert low[at] * layout.step(at) * 2e-3 == pytest.approx(5.0, rel=1e-3)


def test_what_a_bound_has_stopped_begins_in_its_usual_shape_again(bench):
    (scene,) = build_unsimulated_contexts(bench, simulate_dataset(bench, [None], PLAIN))

    def again(values):
        return _reset_shapes_at_bound(
            PLAIN._replace(effects=((STRIBECK_WITH_MEMORY, values),)), scene
        )

    none = replace(STRIBECK_WITH_MEMORY, starts=lambda _: [])
    stopped = PLAIN._replace(effects=((none, (0.17, 1.7e-3, 0.0201)),))
    assert _reset_shapes_at_bound(stopped, scene) is None
    assert again((0.17, 1.7e-3, 0.1)) is None
    ((_, values),) = again((0.17, 1.7e-3, 0.0201)).effects
    assert values == pytest.approx((0.17, 1.7e-3, 0.15))


def test_of_causes_that_are_as_good_as_each_other_the_simplest_is_named(bench):
    fit = simulate_dataset(bench, [None], PLAIN)
    base = compute_errors(bench, fit)

    def candidate(effect, values, better):
        held_out = {c: one._replace(squares=one.squares / better) for c, one in base.items()}
        model = PLAIN._replace(effects=((effect, values),))
        return Candidate(effect, fit._replace(model=model), held_out, 0.0)

    bent = candidate(ANTAGONIST_TENSION, (4.8, 0.06, 1e6), 100.0)
    plain = candidate(JOINT_FRICTION, (0.3,), 100.0)
    worse = candidate(JOINT_FRICTION, (0.3,), 15.0)  # scores as much, and leaves more
    assert select_simplest_cause(bench, fit, base, [bent, plain]) is plain
    assert select_simplest_cause(bench, fit, base, [bent, worse]) is bent


def test_a_fit_of_no_parameter_leaves_the_model_as_it_is(bench):
    layout = ParameterLayout(bench, PLAIN)
    nothing = np.zeros(len(layout.names), bool)
    assert _run_least_squares(bench, [None], layout, PLAIN, 2, nothing).model == PLAIN

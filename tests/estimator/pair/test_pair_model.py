"""The pair of tendons against chains of Coulomb beads, which know no law of it."""

import math

import numpy as np
import pytest

from estimator.pair import pair_study
from estimator.pair.pair_fit import PairError, PairVariant, fit
from estimator.pair.pair_model import PairModel, simulate_by_command, simulate_by_tensions
from estimator.pair.pair_study import (
    compute_offset_share,
)
from tests.estimator.pair import pair_bench as bench

BENDS = tuple(map(math.radians, (0.0, 110.0, 220.0)))
NEUTRALS = (0.02, -0.03, 0.02)
TRUE = PairModel(
    bench.COEFFICIENT * bench.FIXED,
    bench.COEFFICIENT,
    bench.COMPLIANCE,
    0.0,
    bench.STIFFNESS,
    bench.JOINT_FRICTION,
    0.0,
)


@pytest.fixture(scope="module")
def records():
    return [
        bench.record(bend, neutral=neutral, noise=0.02, seed=i)
        for i, (bend, neutral) in enumerate(zip(BENDS, NEUTRALS, strict=True))
    ]


@pytest.fixture(scope="module")
def found(records):
    further = [bench.record(math.radians(300.0))]
    return pair_study.study_pair(records, validate=further)


@pytest.mark.parametrize("bend", BENDS)
@pytest.mark.parametrize("predict", [simulate_by_command, simulate_by_tensions])
def test_the_angle_is_that_of_the_chains(bend, predict):
    record = bench.record(bend, neutral=0.1, samples=240)
    made = predict(TRUE._replace(neutral=0.1), record)
    assert np.abs(made.angle - record.angle).max() < 0.02 * record.span
    for tension, truth in ((made.tension_a, record.tension_a), (made.tension_b, record.tension_b)):
        assert np.abs(tension - truth).max() < 0.02 * truth.max()


def test_friction_of_each_record_and_its_growth_are_found(found):
    for number, bend in zip(found.record_frictions, BENDS, strict=True):
        assert number.low <= TRUE.compute_friction(bend) <= number.high
        assert number.value == pytest.approx(TRUE.compute_friction(bend), rel=0.05)
    assert found.growth.value == pytest.approx(bench.COEFFICIENT, rel=0.05)
    assert found.growth.low <= bench.COEFFICIENT <= found.growth.high
    assert found.fit.model.stiffness == pytest.approx(bench.STIFFNESS, rel=0.05)
    assert found.fit.model.compliance == pytest.approx(bench.COMPLIANCE, rel=0.1)


def test_each_record_has_a_zero_of_its_own(found):
    np.testing.assert_allclose(found.fit.neutrals, NEUTRALS, atol=0.01)


def test_a_bend_that_was_left_out_is_predicted_but_for_its_zero(found):
    assert all(error.zeroed < 0.08 for error in found.left_out[PairVariant.FULL.value])
    ours, one_K = (found.left_out[law.value][2] for law in (PairVariant.FULL, PairVariant.ONE_K))
    assert ours.share < 0.5 * one_K.share
    assert compute_offset_share(found.records, found.predicted) > 0.6


def test_a_further_bend_is_predicted(found):
    (error,) = found.validation
    assert error.model_error.zeroed < 0.06
    assert error.model_error.share < 0.12 < error.baselines[pair_study.SHARE].share


def test_friction_is_not_made_up_where_the_tensions_alone_are_known(records):
    model = fit(records, PairVariant.TENSIONS).model
    assert model.growth == pytest.approx(bench.COEFFICIENT, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:2], "at least 3 bends"),
        (lambda rows: [rows[0]] * 3, "at least 3 bends"),
        (
            lambda rows: [rows[0]._replace(angle=0.0 * rows[0].angle), *rows[1:]],
            "angle: does not change",
        ),
        (
            lambda rows: [bench.PairRecord(0.0, *(c[:9] for c in rows[0][1:])), *rows[1:]],
            "9 samples",
        ),
    ],
)
def test_what_cannot_be_fitted_is_said(records, change, message):
    with pytest.raises(PairError, match=message):
        pair_study.run_study(change(records))

"""The pair of tendons against chains of Coulomb beads, which know no law of it."""

import math

import numpy as np
import pytest

import estimator as est
from estimator.pair import pair_fit, pair_study
from estimator.pair.pair import PairModel, PairRecord, simulate_by_command, simulate_by_tensions
from estimator.pair.pair_fit import PairError, PairVariant, fit
from estimator.pair.pair_study import (
    ONE_PLAY,
    analyse_residuals,
    compute_offset_share,
    fit_simple_predictors,
)
from estimator.signals import apply_play
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


def test_swapped_tendons_bend_the_joint_the_other_way():
    record = bench.record(BENDS[1], samples=60)
    swapped = record._replace(
        command=-record.command, tension_a=record.tension_b, tension_b=record.tension_a
    )
    np.testing.assert_allclose(
        simulate_by_command(TRUE, swapped).angle,
        -simulate_by_command(TRUE, record).angle,
        atol=1e-9,
    )


def test_a_pull_that_friction_keeps_from_the_tip_does_not_bend_the_joint():
    record = bench.record(BENDS[2], samples=60)
    small = record._replace(command=0.02 * record.command)
    assert np.all(simulate_by_command(TRUE, small).angle == 0.0)


def test_friction_of_each_record_and_its_growth_are_found(found):
    for number, bend in zip(found.record_frictions, BENDS, strict=True):
        assert number.low <= TRUE.friction_at(bend) <= number.high
        assert number.value == pytest.approx(TRUE.friction_at(bend), rel=0.05)
    assert found.growth.value == pytest.approx(bench.COEFFICIENT, rel=0.05)
    assert found.growth.low <= bench.COEFFICIENT <= found.growth.high
    assert found.fit.model.stiffness == pytest.approx(bench.STIFFNESS, rel=0.05)
    assert found.fit.model.compliance == pytest.approx(bench.COMPLIANCE, rel=0.1)


def test_each_record_has_a_zero_of_its_own(found):
    np.testing.assert_allclose(found.fit.neutrals, NEUTRALS, atol=0.01)


def test_a_bend_between_others_has_a_zero_between_theirs(found):
    low, middle = found.fit.neutrals[:2]
    between = found.fit.get_model(0.5 * (BENDS[0] + BENDS[1])).neutral
    assert between == pytest.approx(0.5 * (low + middle))
    assert found.fit.get_model(BENDS[-1] + 1.0).neutral == pytest.approx(
        np.mean(found.fit.neutrals)
    )


def test_models_without_tendons_are_beside_it_on_the_same_bends(found):
    plays = next(name for name in found.left_out if name.startswith("one play"))
    assert {"Prandtl-Ishlinskii", "LuGre"} <= {
        name.split(",")[0] for name in found.left_out if "linear in the bend" in name
    }
    assert found.best_simple in found.left_out
    assert pair_study.compute_mean_share(
        found.left_out[found.best_simple]
    ) <= pair_study.compute_mean_share(found.left_out[plays])


def test_one_play_whose_numbers_are_linear_in_the_bend_is_found():
    time = np.linspace(0.0, 12.6, 200)
    command = np.sin(time)

    def made(bend):
        angle = (0.9 - 0.1 * bend) * apply_play(command, 0.1 + 0.1 * bend) + 0.02 * bend
        return PairRecord(bend, time, command, angle, command, command)

    predict = fit_simple_predictors([made(0.0), made(1.0), made(3.0)])[ONE_PLAY]
    left = made(2.0)
    assert np.abs(predict(left) - left.angle).max() < 1e-3


def test_a_bend_that_was_left_out_is_predicted_but_for_its_zero(found):
    assert all(error.zeroed < 0.08 for error in found.left_out[PairVariant.FULL.value])
    ours, one_K = (found.left_out[law.value][2] for law in (PairVariant.FULL, PairVariant.ONE_K))
    assert ours.share < 0.5 * one_K.share
    assert compute_offset_share(found.records, found.predicted) > 0.6


def test_a_further_bend_is_predicted(found):
    (error,) = found.validation
    assert error.model_error.zeroed < 0.06
    assert error.model_error.share < 0.12 < error.baselines[pair_study.SHARE].share


def test_a_notebook_shows_a_study_with_its_figures(found):
    page = est.show_result(found).html
    assert page.count("<svg") == 3
    assert "bend kept apart" in page
    assert "bend kept apart" in est.summarise_result(found)
    assert len(est.plot_result(found).axes) >= len(BENDS)


def test_friction_is_not_made_up_where_the_tensions_alone_are_known(records):
    model = fit(records, PairVariant.TENSIONS).model
    assert model.growth == pytest.approx(bench.COEFFICIENT, rel=0.1)


def test_structure_tells_what_a_residual_goes_along_with(records):
    wrong = []
    for record in records:
        falls = np.gradient(record.command) < 0.0
        wrong.append(record.angle + 0.1 * record.span * falls)
    parts = {part.what: part.mean for part in analyse_residuals(records, wrong)}
    assert parts["command falls"] - parts["command rises"] == pytest.approx(0.1)
    assert abs(parts["stroke is a later one"]) < 0.01
    assert compute_offset_share(records, wrong) == pytest.approx(0.5, abs=0.05)


def test_strokes_end_where_the_command_turns():
    command = np.array([0.0, 0.0, 1.0, 2.0, 1.0, 1.0, 0.0, 1.0])
    assert pair_fit.number_strokes(command).tolist() == [0, 0, 0, 0, 1, 1, 1, 2]


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

"""Psychometric fits: coverage of the interval by simulated observers, and goodness of fit."""

import numpy as np
import pytest
from scipy import stats

from teleop.errors import UsageError
from teleop.experiment.design import BayesianAdaptive, ConstantStimuli, Staircase
from teleop.experiment.psychometric import compute_probability, draw_psychometric, fit_psychometric

PROCEDURES = {
    "constant": ConstantStimuli(tuple(np.linspace(10, 90, 8)), 10),
    "staircase": Staircase(80.0, (16, 8, 4), 0.0, 100.0, reversals=12),
    "bayesian 30": BayesianAdaptive(
        np.linspace(0, 100, 41), np.linspace(5, 95, 46), np.geomspace(3, 60, 12), 30
    ),
    "bayesian 60": BayesianAdaptive(
        np.linspace(0, 100, 41), np.linspace(5, 95, 46), np.geomspace(3, 60, 12), 60
    ),
}


def simulate(procedure, seed, spreads=(8.0, 25.0)):
    """Return true threshold, stimuli and answers of an observer of their own."""
    rng = np.random.default_rng((7, seed))
    procedure = procedure.restart(seed)
    threshold, spread = rng.uniform(25, 65), rng.uniform(*spreads)
    stimuli, answers = [], []
    while not procedure.is_done:
        stimuli.append(procedure.choose_stimulus())
        chance = compute_probability(stimuli[-1], threshold, spread, 0.5, 0.02)
        answers.append(bool(rng.random() < chance))
        procedure.record(answers[-1])
    return threshold, stimuli, answers


@pytest.mark.parametrize(
    ("name", "observers"),
    [("bayesian 30", 8), *(pytest.param(name, 200, marks=pytest.mark.slow) for name in PROCEDURES)],
)
def test_the_interval_holds_the_true_threshold_as_often_as_it_says(name, observers, capsys):
    hits, widths, trials = 0, [], 0
    for seed in range(observers):
        threshold, stimuli, answers = simulate(PROCEDURES[name], seed)
        fit = fit_psychometric(stimuli, answers, guess_rate=0.5)
        hits += fit.low <= threshold <= fit.high
        widths.append(fit.high - fit.low)
        trials += len(stimuli)
    with capsys.disabled():
        if observers > 100:
            print(f"\n{name}: {hits} of {observers} within, {trials / observers:.0f} trials, "
                  f"median width {np.median(widths):.0f}")  # fmt: skip
    assert hits >= stats.binom.ppf(0.001, observers, 0.95)
    assert np.median(widths) < 90.0  # of thresholds within 40, stimuli within 100


def test_many_answers_give_the_true_function():
    rng, x = np.random.default_rng(1), np.repeat(np.linspace(0, 100, 9), 1000)
    correct = rng.random(len(x)) < compute_probability(x, 40.0, 12.0, 0.5, 0.03, "logistic")
    fit = fit_psychometric(x, correct, guess_rate=0.5, shape="logistic")
    assert fit.low < 40.0 < fit.high < fit.low + 6.0
    assert fit.spread == pytest.approx(12.0, rel=0.15)
    assert fit.lapse_rate == pytest.approx(0.03, abs=0.015)
    assert fit.deviance_p > 0.01
    assert fit.compute_probability(fit.find_stimulus(0.8)) == pytest.approx(0.8)
    with pytest.raises(UsageError, match=r"must be above 0\.5"):
        fit.find_stimulus(0.4)


def test_the_unit_of_the_stimulus_does_not_matter():
    _, stimuli, answers = simulate(PROCEDURES["constant"], 3)
    one = fit_psychometric(stimuli, answers, guess_rate=0.5)
    other = fit_psychometric(1e-3 * np.array(stimuli) + 7.0, answers, guess_rate=0.5)
    assert other.threshold == pytest.approx(1e-3 * one.threshold + 7.0, abs=1e-4)
    assert other.high == pytest.approx(1e-3 * one.high + 7.0, abs=1e-6)


def test_answers_that_say_nothing_bound_nothing():
    x = np.tile(np.linspace(0, 100, 5), 20)
    fit = fit_psychometric(x, np.arange(100) % 2, guess_rate=0.5)
    assert fit.high == np.inf


def test_answers_unlike_any_such_function_are_told_by_the_deviance():
    x = np.repeat(np.linspace(0, 100, 5), 40)
    share = np.repeat((0.95, 0.5, 0.95, 0.5, 0.95), 40)
    correct = np.tile(np.arange(40) / 40, 5) < share
    assert fit_psychometric(x, correct, guess_rate=0.5).deviance_p < 0.01


@pytest.mark.slow
def test_the_p_value_of_the_deviance_is_even_for_answers_of_such_a_function():
    x, values = np.repeat(np.linspace(0, 100, 7), 20), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        correct = rng.random(len(x)) < compute_probability(x, 50.0, 15.0, 0.5, 0.02, "normal")
        values.append(fit_psychometric(x, correct, guess_rate=0.5).deviance_p)
    assert 0.38 < np.mean(values) < 0.65  # 0.5 +- 0.05, and what the bound of the lapse rate adds
    assert np.mean(np.array(values) < 0.2) < 0.45


@pytest.mark.parametrize(
    ("stimulus", "correct", "line"),
    [([1.0, 1.0], [1, 0], "two stimuli"), ([1.0, np.nan], [1, 0], "finite"),
     ([1.0, 2.0], [1, 2], "true or false")],
)  # fmt: skip
def test_what_cannot_be_fitted_is_refused(stimulus, correct, line):
    with pytest.raises(UsageError, match=line):
        fit_psychometric(stimulus, correct, guess_rate=0.5)


def test_a_picture_has_a_curve_and_the_answers_of_each_fit(tmp_path):
    fits = [fit_psychometric(*simulate(PROCEDURES["constant"], n)[1:], guess_rate=0.5)
            for n in (1, 2)]  # fmt: skip
    figure = draw_psychometric(fits, ["without delay", "with delay"], "stiffness [N/m]")
    (axes,) = figure.axes
    assert len(axes.collections) == 2
    assert [text.get_text() for text in axes.get_legend().get_texts()][1] == "with delay"
    figure.savefig(tmp_path / "fit.png")

"""Long records are fitted by simulations of few of their samples; what is found stays the same."""

import numpy as np
import pytest

from estimator.diagnosis import causes, dataset, fit, screening
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import (
    build_coarse_steps,
    build_dataset,
    compute_cost,
    compute_residual,
    simulate_dataset,
)
from estimator.diagnosis.fit import build_initial_contexts, fit_model, shift_parameters
from estimator.diagnosis.record import prepare_record
from estimator.diagnosis.scoring import Choice
from estimator.diagnosis.settings import TimeBudget
from estimator.effects import CATALOGUE
from studies import hidden_effects


def effect(name):
    return next(effect for effect in CATALOGUE if effect.name == name)


@pytest.fixture(scope="module")
def bench():
    made = hidden_effects.make(7, ("viscous_friction",), bench="spring", duration=30.0, rate=100.0)
    return build_dataset([prepare_record(made.time, dict(made.channels))])


@pytest.fixture(scope="module")
def law(bench):
    return fit_baseline(bench)


def test_coarse_steps_are_exact_at_their_model_and_near_it(bench, law):
    contexts = build_initial_contexts(bench)
    coarse = build_coarse_steps(bench, contexts, law, 600)
    assert len(coarse[0].rows) < 0.4 * len(bench.records[0].time)
    at_model = simulate_dataset(bench, contexts, law.model, coarse)
    np.testing.assert_allclose(
        compute_residual(bench, at_model), compute_residual(bench, law), atol=1e-9
    )
    shifted = shift_parameters(bench, law.model, np.ones(5))
    exact = compute_residual(bench, simulate_dataset(bench, contexts, shifted))
    near = compute_residual(bench, simulate_dataset(bench, contexts, shifted, coarse))
    change = exact - compute_residual(bench, law)
    assert np.linalg.norm(near - exact) < 0.05 * np.linalg.norm(change)


def test_a_fit_by_coarse_steps_ends_where_one_in_all_samples_does(bench, law, monkeypatch):
    viscous = effect("viscous_friction")
    start = law.model._replace(effects=((viscous, (200.0,)),))
    costs, sizes = [], []
    for size in (600, 10**6):
        monkeypatch.setattr(fit, "COARSE_SIZE", size)
        dataset._simulate_motion.cache_clear()
        result = fit_model(bench, build_initial_contexts(bench), start)
        costs.append(compute_cost(bench, result))
        sizes.append(result.model.effects[0][1][0])
    assert costs[0] == pytest.approx(costs[1], rel=1e-3)
    assert sizes[0] == pytest.approx(sizes[1], rel=0.01)


def test_what_only_a_sensor_makes_of_a_motion_is_not_simulated_again(bench, law):
    contexts = build_initial_contexts(bench)
    gain = effect("distal_tension_gain")
    simulate_dataset(bench, contexts, law.model)
    simulated = dataset._simulate_motion.cache_info().misses
    plain = law.simulated[0].signals["distal_tension"]
    for value in (-0.1, 0.1):
        model = law.model._replace(effects=((gain, (value,)),))
        changed = simulate_dataset(bench, contexts, model).simulated[0].signals["distal_tension"]
        np.testing.assert_allclose(changed, (1.0 + value) * plain)
    assert dataset._simulate_motion.cache_info().misses == simulated
    simulate_dataset(bench, contexts, shift_parameters(bench, law.model, np.ones(5)))
    assert dataset._simulate_motion.cache_info().misses == simulated + 1


def test_the_time_of_a_search_goes_by_samples_whatever_is_remembered(bench, law):
    contexts = build_initial_contexts(bench)
    spans = []
    for _ in range(2):
        begin = dataset.read_work_clock()
        simulate_dataset(bench, contexts, shift_parameters(bench, law.model, 0.5 * np.ones(5)))
        spans.append(dataset.read_work_clock() - begin)
    expected = len(bench.records[0].time) / dataset.SAMPLES_PER_SECOND
    assert spans == pytest.approx([expected, expected])


def test_the_search_ends_early_where_no_quick_fit_makes_a_tendon_of_the_data(monkeypatch):
    made = hidden_effects.make(23, (), duration=12.0, rate=50.0)
    drawn = np.random.default_rng(1).uniform(2.0, 20.0, 40)
    signals = {
        "proximal_displacement": made.channels["proximal_displacement"],
        "proximal_tension": np.interp(made.time, np.linspace(0.0, 12.0, 40), drawn),
    }
    foreign = build_dataset([prepare_record(made.time, signals)])
    rounds = []

    def fit_rounds(data, contexts, start, rounds_max=fit.ROUNDS, **options):
        rounds.append(rounds_max)
        return fit_model(data, contexts, start, rounds_max, **options)

    monkeypatch.setattr(screening, "fit_model", fit_rounds)
    monkeypatch.setattr(screening, "FOREIGN_STARTS", 2)
    monkeypatch.setattr(causes, "fit_functions", pytest.fail)
    result, _ = causes.find_causes(
        [Choice(foreign, fit_baseline(foreign), ())],
        causes.CauseSearch(
            [effect("creep"), effect("viscous_friction")], TimeBudget(60.0, dataset.read_work_clock)
        ),
        fit_all=False,
    )
    assert result.steps == []
    assert set(rounds) == set(screening.ROUNDS)  # none is finished
    assert result.first_candidates

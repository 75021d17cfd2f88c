"""The diagnosis finds what is hidden: data by a chain of beads that shares nothing with it."""

import numpy as np
import pytest

from estimator.diagnosis import measured_data
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import (
    build_contexts,
    build_dataset,
    build_unsimulated_contexts,
    compute_cost,
    rescale_residuals,
    simulate_dataset,
    subsample,
)
from estimator.diagnosis.fit import refit_baseline
from estimator.diagnosis.measured_data import RecordError, prepare_record
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.screening import SUBSAMPLE_SIZE, screen_candidates
from estimator.diagnosis.settings import SETTINGS, ignore_progress
from estimator.effects import CATALOGUE, NAMES
from tests.studies import hidden

NAMES_ASKED_FOR = 35
TWO = ("proximal_tension", "distal_tension")

# seed, what is hidden, where; test_diagnosis_matrix.py has all of them
HIDDEN = [
    (3, "creep", "blocked"),
    (3, "friction_drift", "spring"),  # no linear step leads to it
    (4, "joint_friction", "spring"),
]


def diagnosed(seed, hide, bench, channels=hidden.CHANNELS, among=NAMES, size=1.0):
    print(f"seed {seed}: {hide} on the {bench} bench, {len(channels)} channels")
    made = hidden.make(
        seed, hide, bench=bench, channels=channels, duration=30.0, rate=50.0, size=size
    )
    effects = [effect for effect in CATALOGUE if effect.name in among]
    return made, diagnose_records(
        [prepare_record(made.time, dict(made.channels))], effects, workers=2
    )


@pytest.mark.parametrize(("seed", "effect", "bench"), HIDDEN)
def test_a_hidden_effect_is_named(seed, effect, bench):
    _, found = diagnosed(seed, effect, bench)
    assert effect in {*found.causes, *found.ambiguous_with}
    assert len(found.ambiguous_with) <= 2
    assert found.verdict in {Verdict.NAMED, Verdict.AMBIGUOUS}
    for channel, noise in found.noise.items():
        assert found.after.held_out[channel].rmse < 1.3 * noise


def test_what_is_wrong_in_one_short_stretch_only_is_named():
    _, found = diagnosed(3, "pretension", "blocked", among={"pretension", "creep"}, size=0.5)
    assert found.verdict is Verdict.NAMED
    assert found.causes == ("pretension",)


@pytest.mark.parametrize(
    ("bench", "begin", "channels"),
    [
        ("blocked", 2.66, hidden.CHANNELS),
        ("spring", 18.36, hidden.CHANNELS),
        ("blocked", 2.66, TWO),
    ],
)
def test_a_record_that_begins_in_the_midst_of_motion_says_so(bench, begin, channels):
    made = hidden.make(5, (), bench=bench, duration=40.0, rate=50.0)
    rest = made.time >= begin
    cut = {name: made.channels[name][rest] for name in channels}
    effects = [effect for effect in CATALOGUE if effect.name in {"pretension", "creep", "slack"}]
    found = diagnose_records([prepare_record(made.time[rest], cut)], effects, workers=2)
    assert found.causes == ("pretension",)
    assert found.after.held_out["distal_tension"].rmse < 1.3 * found.noise["distal_tension"]
    K = found.parameters["K"]
    assert K.low < made.truth["sheath"]["K"] < K.high
    assert K.high - K.low < 0.1


def test_two_causes_are_found_of_which_neither_is_worth_it_alone():
    gains = {"proximal_tension_gain", "distal_tension_gain", "creep"}
    hide = ("saturation", "proximal_tension_gain")
    _, found = diagnosed(3000, hide, "spring", among={"saturation", *gains})
    assert found.verdict is Verdict.AMBIGUOUS
    assert found.causes[0] == "saturation"
    assert {*found.causes[1:], *found.ambiguous_with} <= gains


def test_a_second_cause_is_looked_for_by_no_slope_in_the_time_of_a_sudden_one():
    """There is none: it led a linear step astray, and the cause was dropped before its fit."""
    hide = ("friction_step", "constant_drag")
    made = hidden.make(3002, hide, bench="spring", duration=60.0, rate=100.0)
    sudden, drag = (next(e for e in CATALOGUE if e.name == name) for name in hide)
    begun = (sudden, tuple(made.truth["friction_step"].values()))
    bench = build_dataset([prepare_record(made.time, dict(made.channels))])
    plain = fit_baseline(bench)
    fit = refit_baseline(bench, plain._replace(model=plain.model._replace(effects=(begun,))))
    bench = rescale_residuals(bench, fit)
    bench = subsample(bench, SUBSAMPLE_SIZE)
    fit = simulate_dataset(bench, build_unsimulated_contexts(bench, fit), fit.model)
    led = screen_candidates(
        bench, fit, build_contexts(bench, fit), [drag], ignore_progress, 1
    ).linearised_starts[0][0]
    assert led.cost < 0.1 * compute_cost(bench, fit)


@pytest.mark.parametrize("bench", ["blocked", "spring"])
def test_nothing_is_named_where_nothing_is_wrong(bench):
    _, found = diagnosed(7, (), bench)
    assert found.verdict is Verdict.CLEAN
    assert found.causes == ()
    assert 0.0 < found.detection_limits["viscous_friction"].size < 500.0


@pytest.mark.parametrize("bench", ["blocked", pytest.param("spring", marks=pytest.mark.slow)])
def test_friction_that_wanders_is_no_drift_and_no_step(bench):
    in_time = {"friction_step", "friction_drift"}
    _, found = diagnosed(7, "outside:wandering_friction", bench, among=in_time)
    assert found.verdict is Verdict.UNEXPLAINED
    for effect in in_time:
        _, found = diagnosed(7, effect, bench, among=in_time)
        assert found.verdict is Verdict.NAMED
        assert found.causes == (effect,)
        assert not found.has_drifting_friction


def test_what_two_channels_cannot_tell_apart_is_said_to_be_so():
    few = TWO
    asked = {"distal_tension_gain", "proximal_tension_gain", "direction_asymmetry", "creep"}
    _, found = diagnosed(8, "distal_tension_gain", "blocked", few, asked)
    said = {*found.causes, *found.ambiguous_with}
    assert found.verdict is Verdict.AMBIGUOUS
    assert said == {"distal_tension_gain", "proximal_tension_gain", "direction_asymmetry"}
    assert any("weight" in what for what in found.experiments)


@pytest.mark.parametrize("channels", [hidden.CHANNELS, TWO])
def test_another_record_of_the_bench_is_predicted_with_what_was_found(channels):
    first, second = (
        prepare_record(made.time, dict(made.channels))
        for made in (
            hidden.make(8, "distal_tension_gain", channels=channels, duration=d, rate=50.0)
            for d in (30.0, 24.0)
        )
    )
    effects = [effect for effect in CATALOGUE if effect.name == "distal_tension_gain"]
    found = diagnose_records([first], effects, validate=[second])
    before, after = found.before.validation, found.after.validation
    assert after["distal_tension"].rmse < 0.7 * before["distal_tension"].rmse


def test_a_parameter_is_found_and_its_interval_is_no_ornament():
    made, found = diagnosed(9, "viscous_friction", "spring", among={"viscous_friction"})
    true = made.truth["viscous_friction"]["viscosity"]
    number = found.parameters["viscous_friction.viscosity"]
    assert number.value == pytest.approx(true, rel=0.05)
    assert number.low < number.value < number.high
    assert number.high - number.low < 0.5 * true


def test_a_catalogue_without_the_cause_does_not_explain_it():
    _, found = diagnosed(3, "creep", "blocked", among={"saturation", "distal_tension_drift"})
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.residual_dependences


def test_every_effect_has_all_that_a_person_wants_to_know():
    assert len(NAMES) == NAMES_ASKED_FOR
    assert set(NAMES) == {*hidden.EFFECTS, "distributed_play"}  # test_distributed_play hides it
    for effect in CATALOGUE:
        assert effect.cause
        assert effect.equation
        assert effect.source
        assert effect.advice.endswith(".")
        for parameter in effect.parameters:
            assert parameter.low < parameter.high
            assert parameter.step > 0.0


def test_spikes_are_kept_out_and_said_to_be_and_sharp_turns_are_not():
    time = np.arange(2000) * 0.01
    T = 5.0 + 4.0 * np.abs((0.4 * time) % 2.0 - 1.0)  # sharp turns
    T = T + 0.01 * np.random.default_rng(0).standard_normal(len(time))
    signals = {"proximal_tension": T, "distal_tension": 0.5 * T}
    assert not prepare_record(time, signals).issues
    spoiled = T.copy()
    spoiled[[300, 1200]] += (3.0, -2.0)
    ready = prepare_record(time, signals | {"proximal_tension": spoiled})
    (trouble,) = ready.issues
    assert trouble.samples == 2
    assert trouble.first == pytest.approx(3.0)
    assert np.abs(ready.drive - T).max() < 0.2


def test_what_few_samples_have_of_a_fast_motion_is_no_noise_and_its_turns_are_found():
    def swings(t):
        return 1e-3 * (1.0 - np.cos(2.2 * np.pi * t))

    time = np.arange(1000) * 0.02
    rest = (time > 10.0) & (time < 10.0 + 10.0 / 11.0)  # a whole swing left out
    small = 2e-5 * np.sin(np.pi * np.clip((time - 10.2) / 0.4, 0.0, 1.0)) ** 2
    q = np.where(rest, swings(10.0) + small, swings(time))
    q = 1.2e-7 * np.round(q / 1.2e-7)
    ready = prepare_record(time, {"proximal_tension": 1e4 * q, "proximal_displacement": q})
    assert np.abs(np.interp(time, ready.time, ready.drive) - q).max() < 1e-6
    turns = np.arange(1, 43) / 2.2
    turns = turns[(turns < 9.9) | (turns > 11.0)]
    assert np.abs(np.interp(turns, ready.time, ready.drive) - swings(turns)).max() < 1e-6
    added = ~np.isin(ready.time, time)
    assert added.any()
    assert not any((mask & added).any() for mask in ready.valid.values())


def test_a_corner_is_no_turn_between_samples():
    time = np.arange(1000) * 0.02
    q = 1e-3 * np.clip(np.abs((0.4 * time + 0.013) % 2.0 - 1.0), 0.2, 0.8)
    ready = prepare_record(time, {"proximal_tension": 1e4 * q, "proximal_displacement": q})
    assert np.array_equal(ready.time, time)


def test_a_long_record_is_thinned_and_its_turns_stay():
    time = np.arange(50_000) * 0.001
    q = 1e-3 * np.sin(time)
    T = np.clip(8.0 * np.sin(time), 0.0, None)
    ready = prepare_record(time, {"proximal_tension": T, "proximal_displacement": q})
    assert ready.decimation_factor == 3
    assert len(ready.time) <= SETTINGS.samples_max
    few = measured_data.select_record_rows(ready, measured_data.select_subsample(ready, 500))
    assert few.drive.max() == ready.drive.max()
    assert few.drive.min() == ready.drive.min()


@pytest.mark.parametrize(
    ("signals", "what"),
    [
        ({}, "proximal_tension is missing"),
        ({"proximal_tension": np.ones(200)}, "alone"),
        ({"proximal_tension": np.ones(200), "distal_tension": np.ones(200)}, "never changes"),
        ({"proximal_tension": np.ones(200), "distal_tension": np.full(200, np.nan)}, "finite"),
        ({"proximal_tension": np.ones(200), "tip": np.ones(200)}, "no such channel"),
    ],
)
def test_what_cannot_be_diagnosed_is_refused(signals, what):
    with pytest.raises(RecordError, match=what):
        prepare_record(np.arange(200) * 0.01, signals)

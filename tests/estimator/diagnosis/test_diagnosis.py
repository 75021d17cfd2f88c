"""The diagnosis finds what is hidden: data by a chain of beads that shares nothing with it."""

import numpy as np
import pytest

from estimator.diagnosis import record
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.baseline import fit_baseline, select_applicable_effects
from estimator.diagnosis.bench_units import compute_bench_scale, to_bench_units
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import RecordError, prepare_record
from estimator.diagnosis.scoring import compute_errors, is_foreign_data
from estimator.diagnosis.screening import fit_candidates
from estimator.diagnosis.settings import SETTINGS, ignore_progress
from estimator.effects import CATALOGUE, NAMES
from studies import hidden_effects

TWO = ("proximal_tension", "distal_tension")
FEW = {"creep", "joint_friction", "constant_drag", "encoder_scale", "viscous_friction"}


def diagnosed(seed, hide, bench, channels=hidden_effects.CHANNELS, among=NAMES):
    made = hidden_effects.make(seed, hide, bench=bench, channels=channels, duration=30.0, rate=50.0)
    effects = [effect for effect in CATALOGUE if effect.name in among]
    return made, diagnose_records(
        [prepare_record(made.time, dict(made.channels))], effects, workers=2
    )


def test_every_effect_is_hidden_somewhere():
    assert len(NAMES) == 37
    elsewhere = {"distributed_play", "link_gravity"}  # test_distributed_play, test_loops
    assert set(NAMES) == {*hidden_effects.EFFECTS, *elsewhere}


def test_a_hidden_effect_is_named():
    """One of them; test_diagnosis_matrix.py has all."""
    _, found = diagnosed(3, "creep", "blocked", among=FEW)
    assert "creep" in {*found.causes, *found.ambiguous_with}
    assert len(found.ambiguous_with) <= 2
    assert found.verdict in {Verdict.NAMED, Verdict.AMBIGUOUS}
    for channel, noise in found.noise.items():
        assert found.after.held_out[channel].rmse < 1.3 * noise


def test_a_tip_that_meets_a_stop_is_not_taken_for_one_that_was_moved():
    made, found = diagnosed(
        5002, "tip_contact", "spring", among={"tip_contact", "tip_moved", "joint_friction"}
    )
    assert (found.verdict, found.causes) == (Verdict.NAMED, ("tip_contact",))
    true = made.truth["tip_contact"]
    for name in ("travel", "hardness"):
        assert found.parameters[f"tip_contact.{name}"].value == pytest.approx(true[name], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bench", "begin", "channels"),
    [
        ("blocked", 2.66, hidden_effects.CHANNELS),
        pytest.param("spring", 18.36, hidden_effects.CHANNELS, marks=pytest.mark.slow),
        pytest.param("blocked", 2.66, TWO, marks=pytest.mark.slow),
    ],
)
def test_a_record_that_begins_in_the_midst_of_motion_says_so(bench, begin, channels):
    made = hidden_effects.make(5, (), bench=bench, duration=40.0, rate=50.0)
    rest = made.time >= begin
    cut = {name: made.channels[name][rest] for name in channels}
    effects = [effect for effect in CATALOGUE if effect.name in {"pretension", "creep", "slack"}]
    found = diagnose_records([prepare_record(made.time[rest], cut)], effects, workers=2)
    assert found.causes == ("pretension",)
    assert found.after.held_out["distal_tension"].rmse < 1.3 * found.noise["distal_tension"]
    K = found.parameters["K"]
    assert K.low < made.truth["sheath"]["K"] < K.high
    assert K.high - K.low < 0.1


@pytest.mark.slow
def test_two_causes_are_found_of_which_neither_is_worth_it_alone():
    gains = {"proximal_tension_gain", "distal_tension_gain", "creep"}
    hide = ("saturation", "proximal_tension_gain")
    _, found = diagnosed(3000, hide, "spring", among={"saturation", *gains})
    assert found.verdict is Verdict.AMBIGUOUS
    assert found.causes[0] == "saturation"
    assert {*found.causes[1:], *found.ambiguous_with} <= gains


def test_nothing_is_named_where_nothing_is_wrong():
    _, found = diagnosed(7, (), "spring")
    assert found.verdict is Verdict.CLEAN
    assert found.causes == ()
    assert 0.0 < found.detection_limits["viscous_friction"].size < 500.0


IN_TIME = {"friction_step", "friction_drift"}


@pytest.mark.slow
def test_friction_that_wanders_is_no_drift_and_no_step():
    _, found = diagnosed(7, "outside:wandering_friction", "blocked", among=IN_TIME)
    assert found.verdict is Verdict.UNEXPLAINED


@pytest.mark.slow
@pytest.mark.parametrize("effect", sorted(IN_TIME))
def test_friction_that_drifts_or_steps_does_not_wander(effect):
    _, found = diagnosed(7, effect, "blocked", among=IN_TIME)
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


@pytest.mark.slow
def test_another_record_of_the_bench_is_predicted_with_what_was_found():
    first, second = (
        prepare_record(made.time, dict(made.channels))
        for made in (
            hidden_effects.make(8, "distal_tension_gain", duration=d, rate=50.0)
            for d in (30.0, 24.0)
        )
    )
    effects = [effect for effect in CATALOGUE if effect.name == "distal_tension_gain"]
    found = diagnose_records([first], effects, validate=[second])
    before, after = found.before.validation, found.after.validation
    assert after["distal_tension"].rmse < 0.7 * before["distal_tension"].rmse


def test_a_catalogue_without_the_cause_does_not_explain_it():
    _, found = diagnosed(3, "creep", "blocked", among={"saturation", "distal_tension_drift"})
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.residual_dependences


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


def test_a_long_record_is_thinned_and_its_turns_stay():
    time = np.arange(50_000) * 0.001
    q = 1e-3 * np.sin(time)
    T = np.clip(8.0 * np.sin(time), 0.0, None)
    ready = prepare_record(time, {"proximal_tension": T, "proximal_displacement": q})
    assert ready.decimation_factor == 3
    assert len(ready.time) <= SETTINGS.samples_max
    few = record.select_record_rows(ready, record.select_subsample(ready, 500))
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


@pytest.mark.slow
def test_a_slip_while_the_tendon_slides_is_not_taken_for_a_tip_that_moved():
    """With the tip blocked and not measured, both look the same but for the step of the reading."""
    how = {"duration": 40.0, "rate": 50.0, "travel_noise": 5e-7}
    made = hidden_effects.make(
        41, "encoder_slip", bench="blocked", channels=hidden_effects.CHANNELS[:3], **how
    )
    effects = [effect for effect in CATALOGUE if effect.name in {"encoder_slip", "tip_moved"}]
    found = diagnose_records([prepare_record(made.time, dict(made.channels))], effects)
    assert found.causes == ("encoder_slip",)
    truth = made.truth["encoder_slip"]
    assert found.parameters["encoder_slip.slip"].value == pytest.approx(truth["slip"], rel=0.05)
    assert found.parameters["encoder_slip.onset"].value == pytest.approx(truth["time"], abs=0.03)


FAR = {"duration": 30.0, "rate": 50.0, "travel_noise": 5e-7, "bench": "blocked"}


def test_a_tip_that_moved_far_is_a_candidate_where_the_law_misses_most():
    made = hidden_effects.make(960, "tip_moved", **FAR)
    ready = prepare_record(made.time, dict(made.channels))
    dataset = build_dataset([to_bench_units(ready, compute_bench_scale([ready]))])
    law = fit_baseline(dataset)
    assert is_foreign_data(dataset, [compute_errors(dataset, law)])
    effects = select_applicable_effects(CATALOGUE, ready, dataset.base)
    best = fit_candidates(dataset, law, effects, ignore_progress)[0]
    assert best.effect.name == "tip_moved"
    assert not is_foreign_data(dataset, [best.held_out])


@pytest.mark.slow
def test_a_tip_that_moved_far_is_named():
    made = hidden_effects.make(2101, "tip_moved", **FAR)
    found = diagnose_records([prepare_record(made.time, dict(made.channels))])
    assert (found.verdict, found.causes) == (Verdict.NAMED, ("tip_moved",))

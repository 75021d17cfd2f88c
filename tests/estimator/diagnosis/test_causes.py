"""The search for causes where the first look misleads."""

import numpy as np
import pytest

from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import (
    build_dataset,
    build_unsimulated_contexts,
    simulate_dataset,
    subsample,
)
from estimator.diagnosis.measured_data import prepare_record
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.screening import SUBSAMPLE_SIZE, fit_candidates
from estimator.diagnosis.settings import ignore_progress
from estimator.effects import CATALOGUE
from estimator.effects.friction import STRIBECK_WITH_MEMORY
from tests.studies import hidden
from tests.studies.hidden.play_grid import pulled


def diagnosed(seed, hide, bench, among, **how):
    made = hidden.make(seed, hide, bench=bench, **how)
    effects = [effect for effect in CATALOGUE if effect.name in {hide, *among}]
    return made, diagnose_records(
        [prepare_record(made.time, dict(made.channels))], effects, workers=2
    )


def test_a_first_look_leaves_out_no_turn_however_small():
    """One of 2 um takes half a newton away, which friction remembers until it is pulled further."""
    ramp = np.linspace(0.0, 6.0e-3, 2502)
    swing = 6.0e-3 + 1e-6 * np.array([-6.0, -10.0, -6.0, -3.0, -5.0])
    travel = np.concatenate([ramp, swing, np.full(1493, swing[-1]), ramp[::-1]])
    T_in, T_out, tip = pulled(travel, 0.8, 2e-4, 4e-4).T
    channels = {
        "proximal_tension": T_in,
        "proximal_displacement": travel,
        "distal_tension": T_out,
        "distal_displacement": tip,
    }
    dataset = build_dataset([prepare_record(np.arange(len(travel)) * 0.01, channels)])
    fit = fit_baseline(dataset)
    look = subsample(dataset, SUBSAMPLE_SIZE)
    assert len(look.records[0].time) < 0.25 * len(travel)
    there = (
        simulate_dataset(look, build_unsimulated_contexts(look, fit), fit.model)
        .simulated[0]
        .signals
    )
    full = fit.simulated[0].signals["proximal_tension"]
    at = np.searchsorted(dataset.records[0].time, look.records[0].time)
    assert np.abs(there["proximal_tension"] - full[at]).max() < 0.02


@pytest.mark.parametrize(
    ("size", "bench"),
    [
        (1.0, "blocked"),  # which load-independent friction imitates better than the capstan law
        (0.5, "spring"),  # in the middle of a motion, in samples that are held out
    ],
)
def test_a_slip_of_the_encoder_is_named_and_dated(size, bench):
    made, found = diagnosed(
        2, "encoder_slip", bench, {"creep", "thermal_expansion"}, size=size, travel_noise=5e-7
    )
    assert found.verdict is Verdict.NAMED
    assert found.causes == ("encoder_slip",)
    onset = found.parameters["encoder_slip.onset"]
    assert onset.value == pytest.approx(made.truth["encoder_slip"]["time"], abs=0.03)


def test_a_slip_while_the_tendon_slides_is_not_taken_for_a_tip_that_moved():
    """With the tip blocked and not measured, both look the same but for the step of the reading."""
    how = {"duration": 40.0, "rate": 50.0, "travel_noise": 5e-7}
    made = hidden.make(41, "encoder_slip", bench="blocked", channels=hidden.CHANNELS[:3], **how)
    effects = [effect for effect in CATALOGUE if effect.name in {"encoder_slip", "tip_moved"}]
    found = diagnose_records([prepare_record(made.time, dict(made.channels))], effects)
    assert found.causes == ("encoder_slip",)
    truth = made.truth["encoder_slip"]
    assert found.parameters["encoder_slip.slip"].value == pytest.approx(truth["slip"], rel=0.05)
    assert found.parameters["encoder_slip.onset"].value == pytest.approx(truth["time"], abs=0.03)


def test_a_pulley_that_turns_by_a_part_of_a_turn_is_named_although_its_radius_is_not_known():
    _, found = diagnosed(
        11, "pulley_eccentricity", "spring", {"creep", "encoder_scale"}, duration=30.0, rate=50.0
    )
    assert found.verdict in {Verdict.NAMED, Verdict.AMBIGUOUS}
    assert found.causes == ("pulley_eccentricity",)


def test_a_turn_that_a_ripple_hides_is_found_beside_it():
    """It lies within the noise of the travel; what it does to 8 s of rest outweighs the ripple."""
    how = {"duration": 40.0, "travel_noise": 5e-7}
    made, found = diagnosed(63, "cogging_ripple", "spring", (), **how)
    assert found.causes == ("cogging_ripple",)
    assert found.verdict is Verdict.NAMED
    waves = [found.parameters[f"cogging_ripple.{one}"].value for one in ("sine", "cosine")]
    assert np.hypot(*waves) == pytest.approx(made.truth["cogging_ripple"]["amplitude"], rel=0.1)


def test_a_fit_of_friction_that_is_late_is_restarted_on_all_samples():
    """A thin record does not have the memory, and leads to a ratio that is a seventh too large."""
    how = {"bench": "spring", "duration": 40.0, "travel_noise": 5e-7}
    made = hidden.make(1, "stribeck_friction", **how)
    dataset = build_dataset([prepare_record(made.time, dict(made.channels))])
    (best,) = fit_candidates(
        dataset, fit_baseline(dataset), [STRIBECK_WITH_MEMORY], ignore_progress
    )
    ratio, speed, _ = best.fit.model.effects[-1][1]
    assert ratio == pytest.approx(made.truth["stribeck_friction"]["ratio"], rel=0.05)
    assert speed == pytest.approx(made.truth["stribeck_friction"]["speed"], rel=0.05)

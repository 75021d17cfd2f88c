"""The tension tells a motion that the travel's noise hides, and no more than that."""

import numpy as np
import pytest

from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.fit import refit_baseline
from estimator.diagnosis.hidden_motion import propagate_driver_noise, recover_hidden_motion
from estimator.diagnosis.record import prepare_record
from estimator.diagnosis.scoring import compute_errors
from studies import hidden_effects
from studies.hidden_effects.play_grid import make_grid

TENSION, TRAVEL = "proximal_tension", "proximal_displacement"


def before_and_after(time, channels):
    """Return a record as the noise of its travel leaves it, and with its hidden motion."""
    record = prepare_record(time, dict(channels))
    dataset = build_dataset([record])
    plain = fit_baseline(dataset)
    (record,) = propagate_driver_noise([record], dataset, plain)
    dataset = build_dataset([record])
    model = refit_baseline(dataset, plain).model
    return record, recover_hidden_motion(record, dataset.base, model.shared, model.own[0])


def excess(record):
    """Return the mean square of what the plain law leaves of both tensions, in their noise."""
    dataset = build_dataset([record])
    found = compute_errors(dataset, fit_baseline(dataset), held_out=False)
    return [found[channel].mean_square for channel in (TENSION, "distal_tension")]


def test_a_turn_that_smoothing_took_away_is_found_in_a_few_samples():
    """The motor overshoots by 2 um and rests for seconds, a newton below what the travel tells."""
    seed = 63
    made = hidden_effects.make(
        seed, (), bench="spring", duration=40.0, rate=100.0, travel_noise=5e-7
    )
    before, after = before_and_after(made.time, made.channels)
    assert 0 < (before.valid[TENSION] & ~after.valid[TENSION]).sum() < 80
    assert max(excess(after)) < 1.4
    assert np.abs(after.drive - made.channels[TRAVEL]).max() < 6 * before.noise[TRAVEL]


@pytest.mark.slow
def test_a_travel_without_noise_hides_nothing():
    made = make_grid(1, duration=30.0, rate=100.0)
    before, after = before_and_after(made.time, made.channels)
    assert after is before

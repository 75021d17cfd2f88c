"""Benches of any size: forces and travels multiplied, the answer is the same.

Records are those of the hidden benches (studies.hidden_effects), which know nothing of a scale.
"""

import numpy as np
import pytest

from estimator.diagnosis import api
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.record import (
    prepare_record,
)
from estimator.diagnosis.screening import fit_candidates
from estimator.diagnosis.settings import ignore_progress
from estimator.effects import CATALOGUE
from estimator.effects.effect import CHANNELS
from estimator.effects.sensors import PULLEY_ECCENTRICITY
from estimator.measured_data import Samples
from estimator.units import LINEAR, ROTARY
from studies import hidden_effects


def multiplied(made, force, travel, units=LINEAR):
    """Return a record in another size."""
    by = dict.fromkeys(CHANNELS, force) | {c: travel for c in CHANNELS if "displacement" in c}
    signals = {name: by[name] * signal for name, signal in made.channels.items()}
    return Samples(made.time, *(signals[name] for name in CHANNELS), units)


@pytest.mark.parametrize(
    "size",
    [
        (0.01, 100.0, ROTARY),
        *(pytest.param(size, marks=pytest.mark.slow) for size in ((1 / 40, 8.0), (25.0, 1 / 8))),
    ],
)
def test_a_bench_of_another_size_has_its_cause_and_its_numbers(size):
    made = hidden_effects.make(3, ("presliding",), bench="spring", duration=12.0, rate=40.0)
    tried = [one for one in CATALOGUE if one.name == "presliding"]
    data = multiplied(made, *size)
    signals = {name: getattr(data, name) for name in CHANNELS}
    found = api.diagnose_records([prepare_record(data.time, signals, units=data.units)], tried)
    assert found.causes == ("presliding",)
    sheath, (force, travel) = made.truth["sheath"], size[:2]
    assert found.parameters["K"].value == pytest.approx(sheath["K"], rel=2e-3)
    compliance = sheath["L"] / sheath["EA"]
    assert found.parameters["L/EA"].value == pytest.approx(travel / force * compliance, rel=2e-3)
    distance = found.parameters["presliding.distance"]
    bristle = made.truth["presliding"]["bristle"]  # [m] at 10 N
    assert distance.unit in ("m/10 N", "rad/(10 N m)")
    assert distance.value == pytest.approx(travel / force * bristle, rel=0.05)


def test_a_pulley_is_fitted_that_turns_often():
    turns = 8.0
    made = hidden_effects.make(3, (), bench="spring", duration=20.0, rate=40.0)
    travel = made.channels["proximal_displacement"]
    true = np.ptp(travel) / (2.0 * np.pi * turns)
    wave = 0.1 * true * np.sin(travel / true + 0.5)
    dataset = build_dataset(
        [prepare_record(made.time, made.channels | {"proximal_displacement": travel + wave})]
    )
    found, *_ = fit_candidates(
        dataset, fit_baseline(dataset), [PULLEY_ECCENTRICITY], ignore_progress
    )
    ((_, (sine, cosine, radius)),) = found.fit.model.effects
    assert radius == pytest.approx(true, rel=0.01)
    assert np.hypot(sine, cosine) == pytest.approx(0.1 * true, rel=0.05)

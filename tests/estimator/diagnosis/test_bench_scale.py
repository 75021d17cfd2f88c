"""Benches of any size: forces and travels multiplied, the answer is the same.

Records are those of the hidden benches (tests.hidden), which know nothing of a scale.
"""

import numpy as np
import pytest

from estimator.diagnosis.api import diagnose
from estimator.diagnosis.bench_scale import UNSCALED, BenchScale, scale_of
from estimator.effects import CATALOGUE
from estimator.effects.effect import CHANNELS
from estimator.measured_data import Samples
from estimator.units import LINEAR, ROTARY
from tests import hidden

FAR = 50.0  # [m] that the motor's encoder counts from


def multiplied(made, force, travel, units=LINEAR, far=0.0):
    """Return a record in another size, its motor's encoder at another zero."""
    by = dict.fromkeys(CHANNELS, force) | {c: travel for c in CHANNELS if "displacement" in c}
    signals = {name: by[name] * signal for name, signal in made.channels.items()}
    signals["proximal_displacement"] = signals["proximal_displacement"] + far * travel
    return Samples(made.time, *(signals[name] for name in CHANNELS), units)


def answers(name, tried, sizes):
    made = hidden.make(3, (name,), bench="spring", duration=30.0, rate=60.0)
    effects = [one for one in CATALOGUE if one.name in tried]
    return [diagnose(multiplied(made, *size), effects=effects) for size in sizes]


def test_a_bench_of_any_size_has_the_same_cause_and_its_numbers_go_along():
    a, b = 1.0 / 40.0, 1.0 / 30.0
    usual, small, rotary = answers(
        "presliding",
        ("presliding", "constant_drag", "stick_slip"),
        [(1.0, 1.0), (a, b), (25.0, 300.0, ROTARY)],
    )
    for found, sizes in ((small, (a, b)), (rotary, (25.0, 300.0))):
        assert (found.verdict, found.causes) == (usual.verdict, ("presliding",))
        of = {"K": 1.0, "L/EA": sizes[1] / sizes[0], "presliding.distance": sizes[1] / sizes[0]}
        for key, size in of.items():
            assert found.parameters[key].value == pytest.approx(
                size * usual.parameters[key].value, rel=5e-3
            )
        shared = found.extended.model.shared
        assert shared[0] == pytest.approx(found.parameters["K"].value)
        assert shared[1] == pytest.approx(found.parameters["L/EA"].value)
        record = found.dataset.records[0]
        assert np.ptp(record.drive) == pytest.approx(
            sizes[1] * np.ptp(usual.dataset.records[0].drive), rel=1e-3
        )
        assert found.noise["distal_tension"] == pytest.approx(
            sizes[0] * usual.noise["distal_tension"], rel=1e-3
        )
    assert rotary.parameters["presliding.distance"].unit == "rad/(10 N m)"


def test_a_bench_of_usual_size_is_counted_in_newtons_and_metres():
    tension = np.array([0.0, 12.0])
    assert scale_of([tension], [np.array([0.001, 0.009])]) == UNSCALED
    assert scale_of([tension], []) == UNSCALED
    assert scale_of([40.0 * tension], [np.array([0.0, 0.08])]) == BenchScale(10.0, 10.0)


def test_a_far_zero_of_the_encoder_changes_no_eccentricity():
    made = hidden.make(4, ("pulley_eccentricity",), 2.0, bench="spring", duration=40.0, rate=60.0)
    tried = [one for one in CATALOGUE if one.name in ("pulley_eccentricity", "creep")]
    near, far = (
        diagnose(multiplied(made, 1.0, 1.0, far=zero), effects=tried) for zero in (0.0, FAR)
    )
    assert near.causes == far.causes == ("pulley_eccentricity",)
    waves = []
    for found, zero in ((near, 0.0), (far, FAR)):
        sine, cosine, radius = found.extended.model.effects[0][1]
        travel = made.channels["proximal_displacement"]
        phase = (travel + zero) / radius
        wave = sine * np.sin(phase) + cosine * np.cos(phase)
        waves.append(wave - wave[0])
    assert waves[1] == pytest.approx(waves[0], abs=0.05 * np.ptp(waves[0]))

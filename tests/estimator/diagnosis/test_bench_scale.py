"""Benches of any size: forces and travels multiplied, the answer is the same.

Records are those of the hidden benches (tests.studies.hidden), which know nothing of a scale.
"""

import numpy as np
import pytest

from estimator.diagnosis import api
from estimator.diagnosis.api import diagnose
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.bench_units import shift_encoder_zero
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.fit import DIFFERENCE_STEP
from estimator.diagnosis.intervals import ParameterInterval
from estimator.diagnosis.measured_data import (
    UNIT_SCALE,
    BenchScale,
    choose_bench_scale,
    prepare_record,
)
from estimator.diagnosis.outcome import FittedValue
from estimator.diagnosis.screening import fit_candidates
from estimator.diagnosis.settings import ignore_progress
from estimator.effects import CATALOGUE
from estimator.effects.effect import CHANNELS
from estimator.effects.sensors import PULLEY_ECCENTRICITY
from estimator.measured_data import Samples
from estimator.units import LINEAR, ROTARY
from tests.studies import hidden


def multiplied(made, force, travel, units=LINEAR):
    """Return a record in another size."""
    by = dict.fromkeys(CHANNELS, force) | {c: travel for c in CHANNELS if "displacement" in c}
    signals = {name: by[name] * signal for name, signal in made.channels.items()}
    return Samples(made.time, *(signals[name] for name in CHANNELS), units)


def answers(name, tried, sizes):
    made = hidden.make(3, (name,), bench="spring", duration=30.0, rate=60.0)
    effects = [one for one in CATALOGUE if one.name in tried]
    return [diagnose(multiplied(made, *size), effects=effects) for size in sizes]


@pytest.mark.slow
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
    assert choose_bench_scale([tension], [np.array([0.001, 0.009])]) == UNIT_SCALE
    assert choose_bench_scale([tension], []) == UNIT_SCALE
    assert choose_bench_scale([40.0 * tension], [np.array([0.0, 0.08])]) == BenchScale(10.0, 10.0)


@pytest.mark.parametrize(
    "size",
    [
        pytest.param((1.0 / 40.0, 8.0), id="0.5 N, a soft tendon"),
        pytest.param((25.0, 1.0 / 8.0), id="500 N, a stiff tendon"),
        pytest.param((0.01, 100.0, ROTARY), id="0.2 N m and rad"),
    ],
)
def test_a_bench_of_another_size_has_its_cause_and_its_numbers(size):
    made = hidden.make(3, ("presliding",), bench="spring", duration=12.0, rate=40.0)
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


@pytest.mark.parametrize("span", [1.1e-3, 3.5e-3, 11e-3])
def test_a_pulley_may_turn_ten_times_and_is_at_its_bound_no_earlier(span):
    for turns, at_bound in ((0.5, False), (3.0, False), (9.0, False), (10.0, True)):
        value = span / (2.0 * np.pi * turns)
        values = (1e-5, 0.0, value)
        radius = PULLEY_ECCENTRICITY.limit_parameters(PULLEY_ECCENTRICITY.parameters, span, values)[
            2
        ]
        assert ParameterInterval("radius", radius, value, value, value).at_bound == at_bound
        other = value + DIFFERENCE_STEP * radius.step
        assert abs(span / other - span / value) < 0.2  # [rad]: a slope, not a jump


@pytest.mark.parametrize("turns", [2.5, 8.0])
def test_a_pulley_is_fitted_that_turns_often(turns):
    made = hidden.make(3, (), bench="spring", duration=20.0, rate=40.0)
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


def test_intervals_of_a_wave_go_along_with_the_phase_of_a_zero_far_away():
    zero, radius = 0.3, 5e-3
    values = (3e-5, 1e-5, radius)
    names = [f"pulley_eccentricity.{name}" for name in ("sine", "cosine", "radius")]
    half = (1e-7, 4e-6, 1e-5)
    numbers = {
        name: FittedValue(value, value - h, value + h, "m")
        for name, value, h in zip(names, values, half, strict=True)
    }
    moved = numbers | shift_encoder_zero(PULLEY_ECCENTRICITY, values, numbers, zero)
    assert moved[names[2]] == numbers[names[2]]
    rng = np.random.default_rng(0)
    for u, v in rng.uniform(-1.0, 1.0, (50, 2)):
        sine, cosine = values[0] + u * half[0], values[1] + v * half[1]
        angle = zero / radius
        turned = (
            sine * np.cos(angle) + cosine * np.sin(angle),
            cosine * np.cos(angle) - sine * np.sin(angle),
        )
        for name, value in zip(names, turned, strict=False):
            assert moved[name].low <= value <= moved[name].high
    widths = [moved[name].high - moved[name].low for name in names[:2]]
    assert sum(widths) < 2.0 * np.sqrt(2.0) * (half[0] + half[1])


@pytest.mark.slow
def test_an_eccentric_pulley_that_turns_often_is_found_wherever_the_encoder_counts_from():
    made = hidden.make(3, (), bench="spring", duration=30.0, rate=60.0)
    travel, radius, zero = made.channels["proximal_displacement"], 5e-4, 0.3
    turns = np.ptp(travel) / (2.0 * np.pi * radius)
    assert 2.0 < turns < 3.0
    wave = 3e-5 * np.sin(travel / radius + 0.5)
    read = zero + travel + wave
    signals = made.channels | {"proximal_displacement": read}
    data = Samples(made.time, *(signals[name] for name in CHANNELS))
    tried = [one for one in CATALOGUE if one.name in ("pulley_eccentricity", "creep")]
    found = diagnose(data, effects=tried)
    assert found.causes == ("pulley_eccentricity",)
    ((_, (sine, cosine, fitted)),) = found.extended.model.effects
    assert fitted == pytest.approx(radius, rel=0.01)
    of_reading = sine * np.sin(read / fitted) + cosine * np.cos(read / fitted)
    assert of_reading == pytest.approx(wave, abs=3e-6)
    assert found.parameters["pulley_eccentricity.sine"].value == pytest.approx(sine)
    assert found.parameters["pulley_eccentricity.cosine"].value == pytest.approx(cosine)

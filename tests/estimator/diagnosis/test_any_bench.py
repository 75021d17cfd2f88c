"""Records as strangers make them: encoders that count from anywhere, slow sensors, cycles."""

import numpy as np
import pytest

from estimator.diagnosis.api import diagnose
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import build_contexts, build_dataset, build_plain_physics
from estimator.diagnosis.record import RecordError, prepare_record, shorten_blocks
from estimator.diagnosis.validation import transfer_to_validation
from estimator.effects import CATALOGUE
from estimator.effects.effect import CHANNELS
from estimator.measured_data import Samples
from studies import hidden_effects


@pytest.fixture(scope="module")
def clean():
    """A record without effects, of a tip that pulls a spring."""
    return hidden_effects.make(5, (), bench="spring", duration=30.0, rate=50.0)


def samples(record, **off):
    """Return a record with something added to its channels."""
    channels = {name: signal + off.get(name, 0.0) for name, signal in record.channels.items()}
    return Samples(record.time, *(channels.get(name) for name in CHANNELS))


def test_encoders_count_from_anywhere():
    made = hidden_effects.make(6, ("encoder_scale",), bench="spring", duration=20.0, rate=50.0)
    off = {"proximal_displacement": 1.0, "distal_displacement": 2.0}
    tried = [one for one in CATALOGUE if one.name in ("encoder_scale", "creep", "viscous_friction")]
    found = diagnose(samples(made, **off), effects=tried)
    assert [step.effect.name for step in found.steps] == ["encoder_scale"]
    assert found.parameters["K"].value == pytest.approx(made.truth["sheath"]["K"], rel=2e-3)


def test_a_time_that_does_not_rise_is_named(clean):
    time = clean.time.copy()
    time[40] = time[39]
    with pytest.raises(RecordError, match=r"sample 40 at .* does not follow"):
        prepare_record(time, dict(clean.channels))


@pytest.mark.parametrize("channel", ["proximal_displacement", "distal_displacement"])
def test_a_travel_that_counts_the_other_way_is_refused(clean, channel):
    turned = clean.channels | {channel: -clean.channels[channel]}
    with pytest.raises(RecordError, match=f"{channel} falls .* change its sign"):
        prepare_record(clean.time, turned)


def test_samples_held_by_a_slow_sensor_do_not_count(clean):
    slow = clean.channels["distal_tension"][np.arange(len(clean.time)) // 6 * 6]
    record = prepare_record(clean.time, clean.channels | {"distal_tension": slow})
    share = np.mean(record.valid["distal_tension"])
    assert share == pytest.approx(1.0 / 6.0, abs=0.02)
    assert any("held" in one.what for one in record.issues)
    true = clean.channels["distal_tension"]
    at = np.isin(record.time, clean.time[::6])
    assert np.abs(record.signals["distal_tension"][at] - true[::6]).max() < 0.01


@pytest.mark.slow
def test_a_clock_at_the_tip_that_is_early_is_named():
    made = hidden_effects.make(5, (), bench="spring", duration=30.0, rate=100.0)
    early = {
        name: np.interp(made.time + 0.08, made.time, signal) if "distal" in name else signal
        for name, signal in made.channels.items()
    }
    tried = [one for one in CATALOGUE if one.name in ("sensor_lag", "creep", "tip_inertia")]
    found = diagnose(Samples(made.time, *(early.get(name) for name in CHANNELS)), effects=tried)
    assert [step.effect.where for step in found.steps] == ["all sensors at the tip, by their clock"]
    assert found.parameters["sensor_lag.time"].value == pytest.approx(-0.08, abs=0.005)


def test_another_day_has_the_friction_of_the_end_and_no_slip_of_that_day(clean):
    dataset = build_dataset([prepare_record(clean.time, dict(clean.channels))])
    plain = fit_baseline(dataset)
    named = {one.name: one for one in CATALOGUE}
    values = {"friction_step": (0.5, 12.0), "friction_drift": (0.2,), "encoder_slip": (1e-3, 9.0)}
    effects = tuple((named[name], one) for name, one in values.items())
    model = transfer_to_validation(dataset, plain.model._replace(effects=effects))
    assert [effect.name for effect, _ in model.effects] == ["friction_step", "friction_drift"]
    about = build_contexts(dataset, plain)[0]
    physics = build_plain_physics(dataset.records[0], dataset.base, {"K": 1.0})
    for effect, one in model.effects:
        physics = effect.physics(physics, one, about)
    end = 1.5 * (1.0 + 0.2 * dataset.records[0].time[-1] / 60.0)
    assert physics.friction == pytest.approx(np.full(len(dataset.records[0].time), end))


@pytest.mark.parametrize("period", [5.0, 20.0])
def test_both_halves_have_both_directions_of_a_motion_that_repeats_itself(period):
    time = np.arange(0.0, 120.0, 0.02)
    travel = 5e-3 * np.sin(2.0 * np.pi * time / period)
    tension = 10.0 + 2e3 * travel + 0.5 * np.sign(np.gradient(travel))
    record = prepare_record(time, {"proximal_tension": tension, "proximal_displacement": travel})
    for one in (record, shorten_blocks(record)):
        assert 0.4 < np.mean(one.train) < 0.6
        for half in (one.train, ~one.train):
            assert 0.25 < np.mean(one.speed[half] > 0.0) < 0.75


def test_a_tension_that_is_negative_throughout_is_refused(clean):
    turned = clean.channels | {"proximal_tension": -clean.channels["proximal_tension"]}
    with pytest.raises(
        RecordError,
        match=r"tendon pulls; change its sign, --column 'proximal_tension=COLUMN\[-1 N\]'",
    ):
        prepare_record(clean.time, turned)

"""One model gives one error: in a diagnosis, by `teleop estimate`, and played as the rig."""

import json

import numpy as np
import pytest

import estimator as est
from estimator.diagnosis.validation import compute_force_error
from slave import loop, model_files
from slave.config import SlaveConfig
from slave.force_error import Score
from slave.rigs import open_rig
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.samples import estimate, to_sample_rows
from studies import hidden_effects
from teleop.cli import commands
from teleop.data import model_file, read_table, write_table

GAIN, RIVAL = "distal_tension_gain", "proximal_tension_gain"
SPIKE = 4.0  # [N]
SPIKES = {"proximal_tension": (120, 431, 900), "distal_tension": (77, 300, 611, 905)}
START = 100.0  # [s] of the second file


def write(path, data, start, seed):
    """Write both tensions with spikes, and a tip that reads 20 % too much and noise about zero."""
    noise = np.random.default_rng(seed).normal(0.0, 0.01, (2, len(data.time)))
    columns = {"time_s": data.time + start}
    for (channel, rows), unsure in zip(SPIKES.items(), noise, strict=True):
        signal = data.channels[channel] * (1.2 if channel == "distal_tension" else 1.0) + unsure
        signal[list(rows)] += SPIKE * (-1.0) ** np.arange(len(rows))
        columns[f"{channel}_N"] = signal
    write_table(path, columns)
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("numbers")
    data = hidden_effects.make(5, (), bench="spring", duration=24.0, rate=50.0)
    return [
        write(folder / name, data, start, seed)
        for seed, (name, start) in enumerate((("monday.csv", 0.0), ("tuesday.csv", START)))
    ]


@pytest.fixture(scope="module")
def tables(files):
    return [read_table(file, zero_errors=["distal_tension"]) for file in files]


@pytest.fixture(scope="module")
def found(tables):
    """Return a diagnosis of one file, the other kept for validation."""
    return est.diagnose(tables[0], [GAIN, RIVAL], validate=tables[1:])


@pytest.fixture(scope="module")
def chosen(tables):
    """Return a diagnosis of all samples of both files, with the other of two equal causes."""
    both = {"fit_all": True, "leave_one_file_out": True}
    return est.diagnose(tables, [GAIN, RIVAL], cause=RIVAL, **both)


def saved(found, path):
    model = model_file.SavedModel(found.extended.model, found.duration, found.ambiguous_with)
    model_file.save(path, model, "a test")
    return path


def estimated(data, model, folder, *more):
    """Return the error that `teleop estimate` states."""
    words = ["estimate", data, "--model", model, "--json", folder / "estimate.json", *more]
    assert commands.main([*map(str, words)]) == 0
    return json.loads((folder / "estimate.json").read_text())["force_error"]


def played(data, model, *, drop_nonfinite=False):
    """Return the error of a session whose rig plays the data."""
    rig = open_rig(ReplayedRigConfig(file=data, drop_nonfinite=drop_nonfinite))
    (tendon,) = model_files.apply_model_files([None], (), {"": model})
    models = [model_files.set_noise_from_data(tendon, *rig.housing[0]).build_model()]
    slave = loop.init_slave(
        loop.build_rig_model(rig.joints, models),
        SlaveConfig(rig=ReplayedRigConfig(file=data)),
        loop.DIRECT,
        rig.starts_at_zero,
    )
    rows = to_sample_rows(rig.read(1e9))
    estimate(*slave.estimate_arguments, rows, len(rows))
    score = Score(models)
    score.add_rows(slave.layout, rows, len(rows))
    return score.summarise()


@pytest.mark.parametrize("which", [0, 1])
def test_diagnosis_estimate_and_replay_give_one_error(found, files, tmp_path, which):
    model = saved(found, tmp_path / "model.yaml")
    error = found.forces[which].after
    one, other = estimated(files[which], model, tmp_path), played(files[which], model)
    for summary in (one, other):
        assert summary["rmse_N"] == pytest.approx(error.rmse, rel=1e-6)
        assert summary["max_N"] == pytest.approx(error.largest, rel=1e-6)
        assert summary["samples"] == error.samples
    assert error.spikes == len(SPIKES["distal_tension"])


def test_values_that_are_missing_change_nothing_between_them(found, tables, tmp_path):
    lost = tmp_path / "lost.csv"
    columns = {name: column.copy() for name, column in tables[0].columns().items()}
    columns["distal_tension_N"][500:540] = np.nan
    columns["proximal_tension_N"][700:710] = np.nan
    write_table(lost, columns)
    model = saved(found, tmp_path / "model.yaml")
    table = read_table(lost, diagnosed=True, zero_errors=["distal_tension"])
    error = compute_force_error(found.extended.model, found.duration, table)
    one = estimated(lost, model, tmp_path, "--drop-nonfinite")
    other = played(lost, model, drop_nonfinite=True)
    spikes = json.loads((tmp_path / "estimate.json").read_text())["spikes"]["distal_tension"]
    for summary in (one, other):
        assert summary["rmse_N"] == pytest.approx(error.rmse, rel=1e-9)
        assert summary["samples"] == error.samples == len(tables[0].time) - 50 - error.spikes
    assert spikes["count"] == error.spikes == len(SPIKES["distal_tension"])


def test_rivals_have_the_force_that_each_would_give(found):
    assert {*found.causes, *found.ambiguous_with} == {GAIN, RIVAL}
    (rival,) = found.rival_forces
    assert (rival.label, rival.replaces) == (found.ambiguous_with[0], found.causes[0])
    assert 0.1 < rival.largest / rival.full_scale < 0.25  # 20 % on one cell or the other
    assert rival.mean < rival.largest
    assert f"{rival.largest / rival.full_scale:.1%}" in est.summarise_result(found)


def test_the_cause_that_was_asked_for_is_in_the_model(chosen):
    assert chosen.causes == (RIVAL,)
    assert chosen.extended.names == (RIVAL,)
    assert chosen.ambiguous_with == (GAIN,)
    assert chosen.rivals[0].effect.name == GAIN


def test_all_samples_are_fitted_and_said_to_be(chosen):
    assert chosen.fit_all
    assert chosen.after.fit == chosen.after.held_out
    assert "in-sample RMSE" in est.summarise_result(chosen)
    assert "held-out" not in est.summarise_result(chosen)


def test_each_file_is_predicted_by_the_fit_of_the_other(chosen):
    assert [one.record.start for one in chosen.left_out] == [0.0, START]
    for one in chosen.left_out:
        before, after = one.fitness(one.before), one.fitness(one.after)
        assert after["distal_tension"].rmse < 0.2 * before["distal_tension"].rmse


@pytest.mark.slow
def test_a_cause_that_is_not_as_good_is_refused(tables):
    with pytest.raises(est.CauseError, match=r"^creep: (does not explain|no cause)"):
        est.diagnose(tables[0], [GAIN], cause="creep")
    with pytest.raises(est.RecordError, match="at least two"):
        est.diagnose(tables[0], [GAIN], leave_one_file_out=True)


@pytest.mark.slow
@pytest.mark.measured
def test_measured_data_have_one_error(measured_data, tmp_path):
    session = measured_data / "sheath-bench" / "session1.csv"
    found = est.diagnose(read_table(session, zero_errors=["distal_tension"]), [GAIN])
    model = saved(found, tmp_path / "model.yaml")
    error = found.forces[0].after.rmse
    assert error == pytest.approx(found.after.fit["distal_tension"].rmse, rel=0.03)
    assert estimated(session, model, tmp_path)["rmse_N"] == pytest.approx(error, rel=1e-6)
    assert played(session, model)["rmse_N"] == pytest.approx(error, rel=1e-6)

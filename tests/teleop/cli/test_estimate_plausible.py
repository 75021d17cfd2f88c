"""What is no tendon's, has a wrong unit or contradicts its model is named, and never accepted."""

import json

import numpy as np
import pytest

from slave.rigs.replayed_data import ReplayedRig, ReplayedRigConfig
from teleop.cli import commands
from teleop.data.measured_table import read_table, write_table
from tests.teleop.cli.test_estimate import EVEN, SPRING, simulate

T_IN, Q_P, T_OUT, Q_D = (
    "proximal_tension_N", "proximal_displacement_m", "distal_tension_N", "distal_displacement_m",
)  # fmt: skip
KGF = 9.80665
TENDON = "slave.tendons=[{{effective_friction: {}, length: 1.5, axial_stiffness: 9000, tension_noise: 0.01, displacement_noise: 1e-6}}]"  # noqa: E501
MODEL, OTHER = (["--set", TENDON.format(K)] for K in (1.0, 0.2))
FIT = ["--fit", "--length", "1.5"]


@pytest.fixture(scope="module")
def columns(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "bench.csv"
    return dict(read_table(simulate(path, EVEN, SPRING)).columns())


def times(factor):
    return lambda signal: factor * signal


def constant(signal):
    return np.full_like(signal, signal[100])


def spiked(signal):
    return np.where(np.arange(len(signal)) == 1000, 900.0, signal)


def estimate(columns, changes, words, folder, capsys):
    """Return exit code, summary, and what was printed, of data with some columns changed."""
    data, out = folder / "data.csv", folder / "out.json"
    write_table(data, columns | {name: change(columns[name]) for name, change in changes.items()})
    code = commands.main(["estimate", str(data), *words, "--json", str(out)])
    printed = capsys.readouterr()
    return code, json.loads(out.read_text()) if code == 0 else None, printed.out + printed.err


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({Q_P: times(50), Q_D: times(50)}, "mm or cm or inches"),
        ({Q_P: times(1e-3), Q_D: times(1e-3)}, "stiffer than any tendon"),
    ],
)
def test_an_implausible_fit_is_not_accepted(columns, changes, said, tmp_path, capsys):
    saved = tmp_path / "sheath.yaml"
    words = [*FIT, "--save", str(saved)]
    code, summary, _ = estimate(columns, changes, words, tmp_path, capsys)
    assert code == 0
    assert not summary["fit"]["accept"]
    assert said in summary["fit"]["reason"]
    assert "accepted: false" in saved.read_text()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({T_IN: times(1 / KGF)}, "proximal_tension in kgf"),
        ({T_OUT: times(1 / KGF)}, "distal_tension in kgf"),
        ({Q_P: constant}, "proximal_displacement never changes"),
        ({Q_P: times(1000)}, "in metres, not mm"),
    ],
)
def test_what_cannot_be_fitted_is_one_line_with_the_cause(columns, changes, said, tmp_path, capsys):
    code, _, printed = estimate(columns, changes, FIT, tmp_path, capsys)
    assert code == 2
    assert said in printed
    assert len(printed.splitlines()) == 1


@pytest.mark.parametrize(
    ("changes", "words", "said"),
    [
        ({}, OTHER, "data and model contradict: the RMSE is"),
        ({Q_P: times(100), Q_D: times(100)}, MODEL, "perhaps the travel in cm"),
        ({T_IN: times(1 / KGF), T_OUT: times(1 / KGF)}, MODEL, "perhaps the tension in kgf"),
        ({T_OUT: constant}, MODEL, "distal_tension never changes"),
    ],
)
def test_data_that_contradict_the_model_are_said_to(
    columns, changes, words, said, tmp_path, capsys
):
    code, summary, printed = estimate(columns, changes, words, tmp_path, capsys)
    assert code == 0
    assert any(said in doubt for doubt in summary["doubts"])
    assert f"WARNING   {summary['doubts'][0]}" in printed


@pytest.mark.parametrize("words", [FIT, MODEL], ids=["fit", "model"])
def test_good_data_raise_no_doubt(columns, words, tmp_path, capsys):
    _, summary, printed = estimate(columns, {}, words, tmp_path, capsys)
    assert summary["doubts"] == []
    assert "WARNING" not in printed
    assert summary.get("fit", {"accept": True})["accept"]


@pytest.mark.parametrize(
    "change", [lambda T: T + 0.02 * T.max(), lambda T: np.maximum(T - 0.02 * T.max(), 0.0)]
)
def test_a_fit_whose_residual_is_no_noise_is_not_accepted(columns, change, tmp_path, capsys):
    _, summary, printed = estimate(columns, {T_OUT: change}, FIT, tmp_path, capsys)
    K = summary["fit"]["parameters"]["K"]
    assert not K["low"] < 1.0 < K["high"]  # else there is nothing to warn of
    assert not summary["fit"]["accept"]
    assert "NOT accepted: the residual is no noise" in printed
    assert "run teleop diagnose" in printed


@pytest.mark.parametrize("factor", [1 / KGF, 1e3 / KGF], ids=["kgf", "gram-force"])
def test_a_cell_in_another_unit_is_refused_before_a_diagnosis(columns, factor, tmp_path, refused):
    path = tmp_path / "data.csv"
    tensions = {T_IN: 0.2 * columns[T_IN], T_OUT: 0.2 * factor * columns[T_OUT]}
    write_table(path, columns | tensions)  # smaller, so that gram-force are below 1000
    for words in (["diagnose", str(path)], ["estimate", str(path), *FIT]):
        assert f"distal_tension in {'kgf' if factor < 1 else 'gram-force'}" in refused(*words)


def test_a_replay_names_what_an_estimate_does(columns, tmp_path, capsys):
    path = tmp_path / "data.csv"
    write_table(path, columns | {T_OUT: columns[T_OUT] / KGF})
    ReplayedRig(ReplayedRigConfig(file=path)).close()
    assert "distal_tension in kgf" in capsys.readouterr().err


@pytest.mark.parametrize("name", [T_IN, T_OUT])
def test_one_spike_is_named_and_left_out_of_the_fit(columns, name, tmp_path, capsys):
    _, summary, printed = estimate(columns, {name: spiked}, FIT, tmp_path, capsys)
    assert "the largest 900 N at 5 s" in printed
    assert summary["fit"]["accept"]
    assert summary["fit"]["parameters"]["K"]["value"] == pytest.approx(1.0, rel=0.01)


def test_a_long_record_is_fitted_from_some_samples_and_says_so(
    columns, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("estimator.calibration.sheath_fit.SAMPLES_MAX", 1000)
    _, summary, _ = estimate(columns, {}, FIT, tmp_path, capsys)
    assert summary["fit"]["method"].endswith("from one sample in 3")
    assert summary["fit"]["parameters"]["K"]["value"] == pytest.approx(1.0, rel=0.02)

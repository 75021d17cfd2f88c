"""What a learned model finds beside the law: what is missing, and nothing where nothing is."""

import sys
from dataclasses import replace
from importlib.util import find_spec

import pytest

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.learned import CORRECTED, compute_learned_gains, fit_learned_models
from estimator.diagnosis.record import prepare_record
from estimator.diagnosis.scoring import compute_errors, join_errors
from estimator.diagnosis.validation import Fold, fit_folds
from studies import hidden_effects

CHANNELS = ("proximal_tension", "proximal_displacement", "distal_tension")


@pytest.fixture(autouse=True)
def without_learning():
    """Here they are compared with."""


def record_with(effects):
    made = hidden_effects.make(
        21, effects, bench="blocked", channels=CHANNELS, duration=30.0, rate=50.0, travel_noise=5e-7
    )
    return prepare_record(made.time, dict(made.channels))


@pytest.mark.parametrize("effects", [(), ("outside:friction_over_position",)])
def test_what_the_law_lacks_is_learned_on_held_out_halves_and_nothing_else(effects):
    pytest.importorskip("sklearn")
    dataset = build_dataset([record_with(effects)])
    fit = fit_baseline(dataset)
    folds = fit_folds(dataset, fit, fit)
    law = join_errors([compute_errors(fold.dataset, fold.fits[1]) for fold in folds])
    gains = compute_learned_gains(law, fit_learned_models(folds))
    for gain in gains.values():
        assert gain.model == CORRECTED  # in 15 s nobody learns a sheath
        assert gain.low > 0.2 if effects else gain.low < 0.05


def test_held_out_samples_teach_nothing():
    pytest.importorskip("sklearn")
    record = record_with(())
    signals = record.signals | {"distal_tension": record.signals["distal_tension"] + ~record.train}
    dataset = build_dataset([record])
    fit = fit_baseline(dataset)
    dataset = dataset._replace(records=(replace(record, signals=signals),))
    for model in fit_learned_models([Fold(dataset, (fit, fit))]):
        assert model.rmse["distal_tension"] > 0.9  # [N], of the 1 N that only they have


def test_the_report_compares_or_says_what_is_needed(monkeypatch):
    found = diagnose_records([record_with(())], [])
    if find_spec("sklearn"):
        said = report_text.compare_with_learned(found)
        assert len(said) == 2
        assert all(line.endswith("nothing more to find from these inputs.") for line in said)
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    without = found._replace(learned_models=fit_learned_models([]))
    (line,) = report_text.compare_with_learned(without)
    assert "pip install 'tendon-teleop[learned]'" in line

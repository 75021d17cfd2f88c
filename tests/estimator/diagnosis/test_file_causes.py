"""A fault of one of several files is named with that file; the data are those of a bead chain."""

import numpy as np
import pytest

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import prepare_record
from estimator.effects import CATALOGUE
from studies import hidden_effects
from teleop.data import model_file

FAULT, TWO = "distal_tension_gain", ("proximal_tension", "distal_tension")
AMONG = [effect for effect in CATALOGUE if effect.name in {FAULT, "constant_drag"}]


def make_records(faults, seed=8):
    """Records of one bench, the same motion at different speeds, with a fault each or none."""
    made = (
        hidden_effects.make(seed, fault or (), 2.5, "spring", duration=duration, rate=25.0)
        for fault, duration in zip(faults, (12.0, 10.0, 14.0), strict=False)
    )
    return [prepare_record(one.time, {name: one.channels[name] for name in TWO}) for one in made]


@pytest.fixture(scope="module")
def found():
    return diagnose_records(make_records(("", FAULT, "")), AMONG, workers=2)


def test_the_cause_is_named_with_its_file(found):
    assert found.verdict in {Verdict.NAMED, Verdict.AMBIGUOUS}
    (step,) = found.steps
    assert (step.effect.name, step.effect.file) == (FAULT, 2)
    assert f"{FAULT} (in file 2): gain" in report_text.format_verdict(found)
    assert "File 2 is b.csv" in report_text.format_summary(found, ("a.csv", "b.csv", "c.csv"))
    truth = hidden_effects.make(8, FAULT, 2.5, "spring", duration=10.0, rate=25.0).truth
    (name,) = (p.name for p in step.effect.parameters)
    (value,) = truth[FAULT].values()
    number = found.parameters[f"{FAULT}.{name}"]
    assert number.low < value < number.high
    assert found.parameters["K"].low < truth["sheath"]["K"] < found.parameters["K"].high


def test_the_other_files_are_simulated_without_it(found):
    for record, simulated in zip(found.dataset.records, found.extended.simulated, strict=True):
        cell = simulated.signals["distal_tension"]
        acts = not np.allclose(cell, simulated.motion.distal_tension, atol=1e-9)
        assert acts == (record.file == 2)


def test_a_fault_of_one_record_is_no_part_of_the_model_of_the_bench(found):
    assert model_file.from_diagnosis(found).model.effects == ()


@pytest.mark.parametrize(
    "faults",
    [
        (FAULT, FAULT, FAULT),  # of the bench
        (FAULT, ""),  # nothing says which is right
    ],
)
def test_no_file_is_named_where_none_differs_from_two_others(faults):
    found = diagnose_records(make_records(faults), AMONG, workers=2)
    assert {step.effect.file for step in found.steps} <= {0}


def test_a_fault_of_a_file_is_found_beside_a_cause_in_all_of_them():
    shared = "constant_drag"
    records = make_records((shared, (shared, FAULT), shared))
    found = diagnose_records(records, AMONG, workers=2)
    assert {(step.effect.name, step.effect.file) for step in found.steps} == {
        (shared, 0),
        (FAULT, 2),
    }

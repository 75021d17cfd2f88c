"""A diagnosis in words and on the page, for every verdict and every set of channels."""

import json
import math
from dataclasses import replace

import pytest

from estimator.diagnosis import report_tables, report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.outcome import DetectionLimit, FittedValue, Verdict
from estimator.diagnosis.record import prepare_record
from estimator.diagnosis.residual_structure import ResidualDependence
from estimator.signals.sampling import DataIssue
from estimator.units import format_quantity
from studies import hidden_effects
from teleop.cli.diagnose import html_report, json_report
from teleop.cli.diagnose.diagnosis_run import parse_effects

FAULT, RIVAL = "distal_tension_gain", "constant_drag"


def found_in(data, channels=hidden_effects.CHANNELS):
    record = prepare_record(data.time, {name: data.channels[name] for name in channels})
    return diagnose_records([record], parse_effects(FAULT))


@pytest.fixture(scope="module")
def data():
    return hidden_effects.make(5, (FAULT,), bench="spring", duration=16.0, rate=50.0)


@pytest.fixture(scope="module")
def found(data):
    return found_in(data)


@pytest.fixture(scope="module")
def nothing(found):
    """The same with no cause found."""
    return found._replace(steps=(), gain={}, residual_dependences=())


def test_a_named_cause_is_said_with_size_and_gain(found):
    said = report_text.format_verdict(found)
    assert (
        "because the load cell at the tip has a wrong gain (distal_tension_gain: gain 0.04" in said
    )
    assert "%), to " in said
    assert "% below that of the best simple model (" in said
    assert report_text.list_next_steps(found) == [f"{FAULT}: {found.steps[0].effect.advice}"]


def test_the_headline_has_words_and_no_names_of_the_catalogue(found, nothing):
    cause = found.steps[0].effect.cause
    assert report_text.format_headline(found).startswith(f"One thing is wrong: {cause} (4")
    size = found.parameters[f"{FAULT}.gain"]._replace(value=1.25)
    large = found._replace(parameters={f"{FAULT}.gain": size})
    assert "(125 %)" in report_text.format_headline(large)
    twice = found._replace(steps=2 * found.steps, verdict=Verdict.AMBIGUOUS)
    assert report_text.format_headline(twice).startswith("Two things are wrong: ")
    for verdict in (Verdict.CLEAN, Verdict.UNEXPLAINED):
        assert "_" not in report_text.format_headline(nothing._replace(verdict=verdict))
    foreign = found._replace(verdict=Verdict.UNEXPLAINED, foreign_reason="it misses 40%")
    assert report_text.format_headline(foreign).startswith("This is not a tendon-sheath trans")
    assert "misses 40%" in report_text.format_verdict(foreign)


def test_rivals_are_said_with_what_would_tell_them_apart(found):
    step = found.steps[0]._replace(rivals=(RIVAL,))
    unsure = found._replace(verdict=Verdict.AMBIGUOUS, steps=(step,), experiments=("weigh it",))
    assert f"({RIVAL}); these channels cannot tell which; " in report_text.format_verdict(unsure)
    first, *others = report_text.list_next_steps(unsure)
    assert "weigh it" in first
    assert [line.partition(":")[0] for line in others] == [FAULT, RIVAL]


def test_a_clean_bench_is_said_with_what_would_have_been_seen(nothing):
    clean = nothing._replace(
        verdict=Verdict.CLEAN, detection_limits={"slack": DetectionLimit("length", 2e-5, "m")}
    )
    assert report_text.format_verdict(clean).endswith(
        "slack would have been seen from a length of 20 µm on."
    )
    assert report_tables.build_detection_limit_table(clean).rows == (("slack", "length", "20 µm"),)
    assert report_text.list_next_steps(clean) == ["Use the model as it is."]


def test_the_unexplained_is_said_with_what_it_looks_like(nothing, found):
    structure = (ResidualDependence("time", "distal_tension", 0.4),)
    unsure = nothing._replace(verdict=Verdict.UNEXPLAINED, residual_dependences=structure)
    assert unsure.ranking[0].residual_fraction < 0.25
    assert f"{unsure.ranking[0].name} would explain it" in report_text.format_verdict(unsure)
    assert "Record for longer" in report_text.list_next_steps(unsure)[-1]
    strange = unsure._replace(ranking=())
    assert report_text.format_verdict(strange) == (
        "The model is wrong, and nothing in the catalogue explains it: residuals depend on "
        "time (40% of its variance in the tension at the tip)."
    )
    partly = found._replace(
        verdict=Verdict.UNEXPLAINED, residual_dependences=(), residual_fraction=0.5
    )
    assert (
        f"with {FAULT} in the model 50% of what noise does not explain is left"
        in report_text.format_verdict(partly)
    )


def test_samples_that_are_kept_out_are_said_by_file(found):
    (record,) = found.dataset.records
    spikes = DataIssue("single-sample spikes", "distal_tension", 3, 1.25)
    odd = found.dataset._replace(records=(replace(record, issues=(spikes,), decimation_factor=5),))
    first, second = report_text.list_sample_remarks(found._replace(dataset=odd), ["a.csv"])
    assert first == "a.csv: 3 single-sample spikes (tension at the tip), the first at 1.25 s"
    assert "each 5 samples were averaged" in second


def test_json_has_null_for_what_is_not_finite(found):
    endless = {"K": FittedValue(1.0, -math.inf, math.nan, "")}
    tree = json_report.build_report(found._replace(parameters=endless), ["a.csv"], 1.0, {})
    assert json.loads(json.dumps(tree, allow_nan=False)) == tree
    ends = tree["parameters"]["K"]
    assert (ends["value"], ends["low"], ends["high"]) == (1.0, None, None)


def test_without_a_cell_at_the_tip_there_is_a_page_too(data):
    channels = ("proximal_tension", "proximal_displacement")
    found = found_in(data, channels)
    text = html_report.render(found, ["a.csv"], {})
    assert report_text.format_verdict(found).replace("'", "&#x27;") in text
    assert text.count("<img") >= 3  # over time, the loop, structure


@pytest.mark.parametrize(
    ("value", "unit", "said"),
    [
        (1.23456e-4, "m/N", "0.1235 mm/N"),
        (-0.25, "", "-0.25"),
        (60.0, "m/min", "60 m/min"),
        (0.002, "min", "0.002 min"),
    ],
)
def test_quantities_are_said_in_a_fitting_unit(value, unit, said):
    assert format_quantity(value, unit) == said

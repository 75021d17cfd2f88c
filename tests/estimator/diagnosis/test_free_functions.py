"""What no cause explains is characterised: what follows which variable, and by which curve."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimator.diagnosis import function_search, report_text
from estimator.diagnosis.api import diagnose, diagnose_records, prepare_records
from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.causes import CauseSearch, find_causes
from estimator.diagnosis.curve import estimate_curve
from estimator.diagnosis.dataset import (
    build_contexts,
    build_dataset,
    read_work_clock,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import fit_model
from estimator.diagnosis.function_search import fit_functions
from estimator.diagnosis.outcome import LiveError, Verdict
from estimator.diagnosis.record import RecordError, prepare_record
from estimator.diagnosis.scoring import Choice, compute_errors, compute_residual_fraction
from estimator.diagnosis.settings import TimeBudget, ignore_progress
from estimator.diagnosis.validation import compute_force_error
from estimator.effects import CATALOGUE
from estimator.effects.effect import PROXIMAL_DISPLACEMENT, EffectContext
from estimator.effects.functions import (
    compute_basis,
    compute_rest_time,
    evaluate_function,
    find_function,
)
from estimator.measured_data import Samples
from studies import hidden_effects
from teleop.data import model_file

FUNCTIONS = ("friction_by_position", "friction_by_rest_time", "elongation_by_tension")
CAUSES = ("constant_drag", "viscous_friction")


def searched(name, seed, bench, function, travel_noise=0.0):
    """Return what a search finds on the plain law, and what that leaves of the error."""
    made = hidden_effects.make(
        seed, name, bench=bench, duration=30.0, rate=50.0, travel_noise=travel_noise
    )
    dataset = build_dataset([prepare_record(made.time, dict(made.channels))])
    law = Choice(dataset, fit_baseline(dataset), ())
    effects = [effect for effect in CATALOGUE if effect.name in {*CAUSES, name}]
    search = CauseSearch([*effects, find_function(function)], TimeBudget(1e3, read_work_clock))
    found, _ = find_causes([law], search, fit_all=False)
    errors = [compute_errors(found.dataset, fit) for fit in (found.fit, found.base_fit)]
    return made, found, compute_residual_fraction(*errors)


def test_the_variable_and_its_curve_are_found():
    name = "outside:friction_over_position"
    made = hidden_effects.make(21, name, bench="blocked", duration=30.0, rate=50.0)
    record = prepare_record(made.time, dict(made.channels), variables=made.variables)
    effects = [effect for effect in CATALOGUE if effect.name in CAUSES]
    found = diagnose_records([record], [*effects, *map(find_function, FUNCTIONS)])
    assert found.verdict is Verdict.CHARACTERISED
    assert found.causes == ("friction_by_position",)
    assert found.residual_fraction < 0.1
    curve, truth = found.curve, made.truth[name]
    true = hidden_effects.free_curves.evaluate_curve(
        **truth, share=np.linspace(0.0, 1.0, len(curve.x))
    )
    true = (1.0 + true) / (1.0 + np.median(true)) - 1.0
    inner = slice(10, -10)
    assert np.corrcoef(curve.value[inner], true[inner])[0, 1] > 0.95
    assert found.live_error.extended < 0.5 * found.live_error.without
    assert report_text.list_model_warnings(found) == []
    worse = found._replace(live_error=LiveError(*reversed(found.live_error)))
    (warning,) = report_text.list_model_warnings(worse)
    assert warning.endswith("`--model` refuses it.")
    said = report_text.format_verdict(found)
    assert said.startswith("No named cause explains the error; friction depends on motor position")
    assert "% of the error beyond noise" in said
    assert not any(name.startswith("friction_by") for name in found.parameters)
    assert found.ranking[0].name == "friction_by_position"  # of all that were tried
    assert {*CAUSES} <= {candidate.name for candidate in found.ranking}


@pytest.mark.parametrize("extended_error", [0.4, 0.51])
def test_the_loop_has_the_mean_of_a_cycle_or_the_friction_of_the_law(extended_error, tmp_path):
    made = hidden_effects.make(3, (), bench="spring", duration=20.0, rate=50.0)
    clean = diagnose_records([prepare_record(made.time, dict(made.channels))], [])
    cycle = find_function("friction_by_phase"), (4.0, *np.tile([0.3, -0.1], 6).tolist())
    with_mean = clean.baseline.model._replace(
        shared=tuple(1.2 * value for value in clean.baseline.model.shared), effects=(cycle,)
    )
    found = clean._replace(
        extended=clean.extended._replace(model=with_mean),
        live_error=LiveError(0.5, extended_error),
    )
    model_file.save(tmp_path / "model.yaml", model_file.from_diagnosis(found), "")
    model = model_file.load(tmp_path / "model.yaml").model
    is_better = extended_error < 0.5
    expected = with_mean if is_better else clean.baseline.model
    assert [values for _, values in model.effects] == [values for _, values in expected.effects]
    assert model.shared == pytest.approx(expected.shared)
    warnings = [line for line in report_text.list_model_warnings(found) if "plain law" in line]
    assert len(warnings) == (not is_better)


@pytest.mark.slow
@pytest.mark.parametrize("bench", ["blocked", "spring"])
def test_a_cycle_does_not_spoil_the_force_in_the_loop(bench):
    made = hidden_effects.make(
        2301, ("outside:friction_over_cycle",), bench=bench, duration=30.0, rate=50.0,
        travel_noise=5e-7,
    )  # fmt: skip
    data = Samples(made.time, **made.channels)
    found = diagnose(data, [find_function("friction_by_phase")])
    assert found.causes == ("friction_by_phase",)
    saved = model_file.from_diagnosis(found)
    plain, live = (
        compute_force_error(model, saved.duration, data).rmse
        for model in (found.baseline.model, saved.model)
    )
    assert (live < 0.8 * plain) == (bench == "spring")
    assert live <= plain


def test_the_band_holds_the_curve_where_the_spline_cannot_follow_it():
    made, found, _ = searched("outside:rough_spot", 512, "blocked", "friction_by_position", 5e-7)
    full = rescale_residuals(use_all_samples(found.dataset), found.fit)
    contexts = build_contexts(found.dataset, found.base_fit)
    curve = estimate_curve(full, contexts, fit_model(full, contexts, found.fit.model))
    record = found.dataset.records[0]
    value, width = (np.interp(record.drive, curve.x, y) for y in (curve.value, curve.half_width))
    friction = np.interp(record.start + record.time, made.time, made.friction)
    true = friction * np.median((1.0 + value) / friction) - 1.0
    assert np.mean(np.abs(true - value) <= width) > 0.9
    assert np.median(width) < 0.1


@pytest.mark.parametrize(
    ("variable", "seed"),
    [
        ("speed", 826),  # one half of long blocks lacks some speeds
        ("speed", 832),  # a hump of a quarter of the highest speed
        pytest.param("speed", 301, marks=pytest.mark.slow),
        pytest.param("path", 301, marks=pytest.mark.slow),
    ],
)
def test_a_curve_is_as_smooth_as_held_out_samples_favour(variable, seed):
    """A line to few samples at an end of the range, or too stiff a curve, is not significant."""
    name, function = f"outside:friction_over_{variable}", f"friction_by_{variable}"
    _, found, residual_fraction = searched(name, seed, "blocked", function, travel_noise=5e-7)
    assert [step.effect.name for step in found.steps] == [function]
    assert residual_fraction < 0.1


@pytest.mark.parametrize(
    ("seed", "bench"),
    [
        pytest.param(401, "spring", marks=pytest.mark.slow),  # as long as two blocks
        pytest.param(701, "spring", marks=pytest.mark.slow),  # three of it, seen by halves
        (702, "blocked"),  # without it errors last long, and few samples count
    ],
)
def test_a_cycle_is_found(seed, bench):
    name = "outside:friction_over_cycle"
    made, found, residual_fraction = searched(name, seed, bench, "friction_by_phase", 5e-7)
    assert [step.effect.name for step in found.steps] == ["friction_by_phase"]
    assert residual_fraction < 0.1
    ((_, (period, *_)),) = found.steps[-1].fit.model.effects
    assert period == pytest.approx(made.truth[name]["period"], rel=0.01)


@pytest.mark.parametrize(
    ("name", "seed", "function"),
    [
        ("viscous_friction", 22, "friction_by_position"),
        pytest.param(  # it follows what model error is left
            "presliding", 9112, "distal_tension_gain_by_tension", marks=pytest.mark.slow
        ),
    ],
)
def test_a_named_cause_is_preferred_to_a_curve(name, seed, function):
    _, found, _ = searched(name, seed, "blocked", function)
    assert [step.effect.name for step in found.steps] == [name]


def test_a_curve_stays_as_it_is_beyond_its_range_and_closes_over_a_period():
    rng = np.random.default_rng(0)
    for name, shapes in (("friction_by_position", (1e-3, 4e-3)), ("friction_by_phase", (2.5,))):
        effect = find_function(name)
        values = (*shapes, *rng.uniform(-0.3, 0.3, 12).tolist())
        x = np.linspace(shapes[0], 2.0 * shapes[0] if len(shapes) == 1 else shapes[1], 7)
        y = evaluate_function(effect, values, x)
        np.testing.assert_allclose(compute_basis(effect, values, x) @ values[-12:], y, atol=1e-12)
        if len(shapes) == 1:
            last = evaluate_function(effect, values, x[-1:] - 1e-9)
            np.testing.assert_allclose(last, y[:1], atol=1e-6)
        else:
            far = evaluate_function(effect, values, np.array([-1.0, 1.0]))
            np.testing.assert_allclose(far, y[[0, -1]])


@pytest.mark.parametrize("channel", ["proximal_displacement", "proximal_tension"])
def test_a_driving_sensor_is_put_right_as_it_reads(channel):
    effect = find_function(f"{channel}_by_reading")
    signal = np.linspace(0.0, 1.0, 50)
    values = (0.0, 1.0, *(0.03 * np.cos(np.arange(12.0))).tolist())
    driven = diagnosed_context(signal, signal)._replace(driver=channel)
    reading = effect.measure({channel: signal}, values, driven._replace(driver=""))[channel]
    assert np.abs(reading - signal).max() > 0.02
    np.testing.assert_allclose(effect.invert(reading, values, driven), signal, atol=2e-4)


def test_a_curve_over_the_encoder_moves_with_its_zero():
    x, shapes = np.linspace(0.0, 1.0, 20), (0.0, 1.0)
    values = (*shapes, *np.random.default_rng(0).uniform(-0.3, 0.3, 12).tolist())
    for name, zero in (
        ("friction_by_position", 5.0),
        ("proximal_displacement_by_reading", 5.0),
        ("proximal_tension_by_reading", 0.0),
        ("friction_by_time", 0.0),
    ):
        effect = find_function(name)
        shifted = effect.shift_encoder_zero(values, 5.0)
        np.testing.assert_allclose(
            evaluate_function(effect, shifted, x + zero), evaluate_function(effect, values, x)
        )


def test_a_rest_counts_until_the_next_one():
    time = np.arange(800) * 0.01
    speed = np.where((time > 2.0) & (time < 3.0), 0.0, np.where(time < 6.0, 1.0, -1.0))
    context = diagnosed_context(time, speed)
    rest = compute_rest_time(context)
    assert rest[250] == pytest.approx(0.49, abs=0.02)
    assert rest[400] == pytest.approx(1.0, abs=0.02)
    assert rest[650] == 0.0


def diagnosed_context(time, speed):
    zero = np.zeros_like(time)
    travel = np.cumsum(speed) * 0.01
    return EffectContext(time, PROXIMAL_DISPLACEMENT, travel, speed, {}, {}, zero, 1e-4)


def test_no_reading_depends_on_itself_as_measured():
    assert find_function("distal_tension_gain_by_tension") is not None
    assert find_function("proximal_tension_by_tension") is None
    assert find_function("proximal_tension_gain_by_tension") is None


def test_a_further_column_that_is_not_there_is_refused():
    made = hidden_effects.make(22, (), duration=10.0, rate=50.0)
    data = SimpleNamespace(time=made.time, **made.channels, extra={"humidity_percent": made.time})
    with pytest.raises(RecordError, match="temperature: no such further column; there are hum"):
        diagnose(data, variables=["temperature"])
    with pytest.raises(RecordError, match="positon: no such further column; there are hum"):
        diagnose(data, ["friction_by_positon"])
    (record,) = prepare_records([data], variables=["humidity_percent"])
    np.testing.assert_allclose(record.variables["humidity_percent"], record.time)


def test_functions_of_data_of_no_tendon_are_given_up_after_the_first_fits():
    made = hidden_effects.make(23, (), duration=20.0, rate=50.0)
    drawn = np.random.default_rng(1).uniform(2.0, 20.0, 40)
    tension = np.interp(made.time, np.linspace(0.0, 20.0, 40), drawn)
    signals = {"proximal_displacement": made.channels["proximal_displacement"]}
    record = prepare_record(made.time, {**signals, "proximal_tension": tension})
    dataset = build_dataset([record])
    functions = [find_function("friction_by_path")]
    assert fit_functions(dataset, fit_baseline(dataset), functions, ignore_progress) == []


def test_a_function_is_fitted_to_no_more_samples_of_a_long_record(monkeypatch):
    made = hidden_effects.make(21, "outside:friction_over_position", duration=10.0, rate=300.0)
    sizes = []

    def fit(dataset, *others):
        sizes.append(sum(len(record.time) for record in dataset.records))
        return fit_model(dataset, *others)

    monkeypatch.setattr(function_search, "fit_model", fit)
    monkeypatch.setattr(function_search, "FITTED_SIZE", 2000)
    dataset = build_dataset([prepare_record(made.time, dict(made.channels))])
    functions = [find_function("friction_by_position")]
    (found,) = fit_functions(dataset, fit_baseline(dataset), functions, ignore_progress)
    assert len(found.fit.simulated[0].signals["proximal_tension"]) == len(made.time)
    assert 0.5 * function_search.FITTED_SIZE < max(sizes) < function_search.FITTED_SIZE

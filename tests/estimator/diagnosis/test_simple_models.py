"""Models without a sheath: found where they are true, and worse than the law where that is."""

import numpy as np
import pytest

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose_records
from estimator.diagnosis.dataset import build_dataset
from estimator.diagnosis.record import prepare_record
from estimator.diagnosis.simple_models import fit_simple_models
from studies import hidden_effects

NOISE = 0.01  # [N]


def walk(seed, n=1500):
    """Return a tension [N] that turns at random depths."""
    turns = np.random.default_rng(seed).uniform(1.0, 15.0, 24)
    return np.interp(np.arange(n), np.linspace(0, n - 1, 24), turns)


def after_a_play(values, half_width):
    out = [float(values[0])]
    for value in values[1:]:
        if value - half_width > out[-1]:
            out.append(float(value - half_width))
        elif value + half_width < out[-1]:
            out.append(float(value + half_width))
        else:
            out.append(out[-1])
    return np.array(out)


def dahl(values, reach, steps=50):
    """Return Dahl's friction by small steps: dz/dx = (1 - sgn(dx) z) / reach."""
    z, out = 0.0, [0.0]
    for step in np.diff(values):
        for _ in range(steps):
            z += (1.0 - np.sign(step) * z) * step / steps / reach
        out.append(z)
    return np.array(out)


def errors_of(T_out, seed=0):
    rng = np.random.default_rng(seed)
    T_in = walk(1)
    time = np.arange(len(T_in)) * 0.01
    signals = {
        "proximal_tension": T_in + 1e-4 * rng.standard_normal(len(T_in)),
        "distal_tension": T_out(T_in) + NOISE * rng.standard_normal(len(T_in)),
    }
    fits = fit_simple_models(build_dataset([prepare_record(time, signals)]))
    return {one.name.split()[0].rstrip(","): one.rmse["distal_tension"] for one in fits}


def test_one_play_with_a_gain_is_found():
    found = errors_of(lambda T: 0.7 * after_a_play(T, 1.9) + 0.4)
    assert found["play"] < 0.15


def test_lugre_is_found():
    found = errors_of(lambda T: 0.8 * T - 1.2 * dahl(T, 0.8))
    assert found["LuGre"] < 0.1
    assert found["LuGre"] < found["play"]


def test_on_a_clean_bench_the_law_is_better_than_any():
    made = hidden_effects.make(71, (), bench="spring", duration=30.0, rate=40.0)
    found = diagnose_records([prepare_record(made.time, dict(made.channels))], ())
    assert report_text.list_model_warnings(found) == []
    for channel in ("proximal_tension", "distal_tension"):
        assert found.simple_gain[channel].low > 0.5
    for one in found.simple_models:
        for channel in ("proximal_tension", "distal_tension"):
            assert one.rmse[channel] > 5.0 * found.before.held_out[channel].rmse


def test_a_model_that_beats_the_law_is_named():
    T_in = walk(2)
    signals = {"proximal_tension": T_in, "distal_tension": 0.7 * after_a_play(T_in, 1.9)}
    found = diagnose_records([prepare_record(np.arange(len(T_in)) * 0.01, signals)], ())
    (said,) = report_text.list_model_warnings(found)
    assert said.startswith("tension at the tip: ")
    assert "--effects distributed_play" in said
    gain = found.simple_gain["distal_tension"]
    assert f"{gain.model} predicts it better than this model" in said
    simple = next(one for one in found.simple_models if one.name == gain.model)
    law = found.after.held_out["distal_tension"]
    assert gain.high < 0.0
    assert gain.value == pytest.approx(1.0 - law.rmse / simple.rmse["distal_tension"], rel=1e-6)
    text = report_text.format_summary(found)
    assert f"WARNING: {said}" in text.splitlines()
    assert "the plain law" in text

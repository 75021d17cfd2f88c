"""The estimator in the loop with effects: data by a chain of beads that shares nothing with it."""

import math
from functools import cache

import numpy as np
import pytest

from estimator.effects import CATALOGUE, NAMES
from estimator.effects.effect import EffectContext
from estimator.law.sheath import Sheath
from estimator.lumped.lumped_model import Physics, simulate_by_tension
from estimator.lumped.nodes import build_even_weights
from estimator.online import online
from estimator.online.extended_model import (
    OMISSION_REASONS,
    EffectUse,
    build_extended_model,
    explain_omission,
)
from estimator.online.force_error import build_reading_table, compute_reading
from estimator.online.online import Status, TendonModel
from estimator.online.reading_correction import (
    MAX_CORRECTIONS,
    build_corrections,
    correct_reading,
)
from studies import hidden_effects

NOISE, STEP = 0.02, 1.2e-7  # [N], [m] of the hidden sensors
SEED, SECONDS = 1, 20.0


def effect(name, where=""):
    return next(one for one in CATALOGUE if one.name == name and where in one.where)


# what is hidden, in the words of the catalogue
TRUE = {
    "viscous_friction": ("", lambda t, _: (t["viscosity"],)),
    "stribeck_friction": ("own", lambda t, _: (t["ratio"], t["speed"], t["memory"])),
    "presliding": ("stiffness", lambda t, _: (t["bristle"],)),
    "tension_dependent_friction": ("power", lambda t, _: (t["exponent"],)),
    "creep": ("", lambda t, _: (t["share"], t["time"])),
    "nonlinear_stiffness": ("", lambda t, sheath: (t["strain"] * sheath["L"], t["tension"])),
    "sheath_compression": ("", lambda t, _: (t["compression"], t["threshold"])),
    "constant_drag": ("", lambda t, _: (t["drag"],)),
    "direction_asymmetry": ("", lambda t, _: (t["ratio"],)),
    "friction_step": ("", lambda t, _: (t["change"], t["time"])),
    "proximal_tension_gain": ("", lambda t, _: (t["gain"],)),
    "proximal_tension_bias": ("", lambda t, _: (t["bias"],)),
    "sheath_rub": ("", lambda t, _: (t["force"], 2.0 * t["give"])),
    "cogging_ripple": ("", lambda t, _: wave(t)),
    "pulley_eccentricity": ("", lambda t, _: (*wave(t)[:2], t["radius"] / t["order"])),
}


def wave(t):
    """Return sine, cosine and wave number [rad/m] of a hidden ripple."""
    sine, cosine = (t["amplitude"] * f(t["phase"]) for f in (np.cos, np.sin))
    return sine, cosine, t["order"] / t["radius"]


def models(truth, name, softness=None):
    """Return the plain and the extended model of a hidden bench; `softness` [m/N] at its tip."""
    sheath = truth["sheath"]
    K, L, EA, k = (sheath[key] for key in ("K", "L", "EA", "k"))
    if softness is None:
        softness = 1.0 / k if k else 0.0
    where, values = TRUE[name]
    effects = [(effect(name, where), values(truth[name], sheath))]
    found = build_extended_model((K, L / EA, softness), effects, SECONDS, L)
    noise = {"tension_noise": NOISE, "displacement_noise": STEP / math.sqrt(12.0)}
    plain = TendonModel(Sheath.uniform(K, L, EA), **noise)
    return plain, TendonModel(found.sheath, extension=found.extension, **noise)


@cache
def bench(name, kind):
    return hidden_effects.make(SEED, name, bench=kind, duration=SECONDS, rate=100.0)


def estimated(model, data):
    tension, travel = (data.channels[f"proximal_{one}"] for one in ("tension", "displacement"))
    return online.run(online.prepare(model), data.time, tension, travel)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def force_error(model, data, part=slice(None)):
    off = estimated(model, data).distal_tension - data.channels["distal_tension"]
    return rms(off[part])


def slow(*cases):
    return [pytest.param(*case, marks=pytest.mark.slow) for case in cases]


@pytest.mark.parametrize(
    ("name", "kind", "most"),
    [
        ("viscous_friction", "spring", 5.0),
        ("presliding", "blocked", 9.0),
        ("sheath_rub", "spring", 3.5),
        *slow(
            ("viscous_friction", "blocked", 3.0),
            ("stribeck_friction", "blocked", 7.0),
            ("stribeck_friction", "spring", 10.0),
            ("tension_dependent_friction", "blocked", 3.5),
            ("constant_drag", "spring", 3.5),
            ("direction_asymmetry", "blocked", 3.5),
            ("proximal_tension_gain", "spring", 3.5),
            ("proximal_tension_bias", "blocked", 3.5),
            ("cogging_ripple", "blocked", 5.0),
        ),
    ],
)
def test_the_force_is_right_where_the_plain_law_is_wrong(name, kind, most):
    data = bench(name, kind)
    plain, more = models(data.truth, name)
    off = force_error(more, data)
    assert off < most * NOISE
    assert off < 0.8 * force_error(plain, data)
    found = estimated(more, data)
    tip = data.channels["distal_tension"]
    assert np.mean((found.low - 4 * NOISE <= tip) & (tip <= found.high + 4 * NOISE)) > 0.98
    assert (found.low <= found.distal_tension).all()
    assert (found.distal_tension <= found.high).all()
    assert (found.low >= 0.0).all()


@pytest.mark.parametrize(
    "name",
    ["creep", *slow(("nonlinear_stiffness",), ("sheath_compression",), ("pulley_eccentricity",))],
)
def test_the_elongation_is_right_where_the_plain_law_is_wrong(name):
    data = bench(name, "spring")
    taut = data.channels["proximal_tension"] > 0.5
    off = [
        np.std(
            (estimated(model, data).distal_displacement - data.channels["distal_displacement"])[
                taut
            ]
        )
        for model in models(data.truth, name)
    ]
    assert off[1] < 1.5e-5
    assert off[1] < 0.6 * off[0]


def test_what_the_tip_pulls_at_is_learnt_where_it_is_not_what_the_bench_had():
    data = bench("viscous_friction", "spring")
    plain, more = models(data.truth, "viscous_friction", 0.0)
    settled = data.time > 6.0
    assert force_error(more, data, settled) < 0.7 * force_error(plain, data, settled)


@pytest.mark.parametrize(
    ("values", "softness"),
    [((0.4, 0.7), 0.0), *slow(((0.2, 0.1, 0.5, 0.3), 3e-4))],
)
def test_distributed_play_has_in_the_loop_the_numbers_of_the_diagnosis(values, softness):
    """What it adds is that of nodes to 1e-9; the rest is the closed law, which they come near."""
    one = next(
        e for e in CATALOGUE if e.name == "distributed_play" and len(e.parameters) == len(values)
    )
    time = np.arange(1500) * 0.01
    turns = np.random.default_rng(SEED).uniform(0.5, 12.0, 30)
    T = np.minimum(np.interp(time, np.linspace(0.0, 15.0, 30), turns), 24.0 * time)
    found = build_extended_model((0.7, 1e-4, softness), [(one, values)], 15.0, 1.5)
    prepared = online.prepare(TendonModel(found.sheath, extension=found.extension))
    plain = Physics(np.full(len(time), 0.7), 1e-4, build_even_weights(), softness)
    nodes = [
        simulate_by_tension(physics, time, T, np.abs(np.diff(T, prepend=0.0)) / 0.01)
        for physics in (plain, one.physics(plain, values, None))
    ]
    q = nodes[1].proximal_displacement
    state = online.build_initial_state(prepared)
    for i in range(len(time)):
        dt = 0.01 if i else 0.0
        row, state = online.step(prepared, state, T[i], q[i], dt)
        adds = nodes[1].distal_tension[i] - nodes[0].distal_tension[i]
        assert state.dynamics.tension == pytest.approx(adds, abs=1e-9)
        assert row.distal_tension == pytest.approx(nodes[1].distal_tension[i], abs=2e-3)
        assert row.low <= row.distal_tension <= row.high
    assert np.abs(nodes[1].distal_tension - nodes[0].distal_tension).max() > 0.5


def test_run_gives_the_numbers_of_step_bit_for_bit():
    name = "viscous_friction"
    data = bench(name, "spring")
    prepared = online.prepare(models(data.truth, name)[1])
    T, q = (data.channels[f"proximal_{one}"][:700].copy() for one in ("tension", "displacement"))
    T[[50, 51, 300]], q[400:450] = (math.nan, math.inf, -5.0), math.nan
    time = data.time[:700]
    rows, state = [], online.build_initial_state(prepared)
    for i in range(len(time)):
        before = state.tobytes()
        dt = time[i] - time[i - 1] if i else 0.0
        row, after = online.step(prepared, state, T[i], q[i], dt)
        assert state.tobytes() == before
        rows.append(row)
        state = after
    for name, every in online.run(prepared, time, T, q)._asdict().items():
        assert np.array_equal([getattr(row, name) for row in rows], every, equal_nan=True)


@pytest.mark.parametrize("name", ["viscous_friction", "cogging_ripple"])
def test_a_refused_sample_leaves_no_trace_and_the_force_is_always_finite(name):
    data = bench(name, "blocked")
    prepared = online.prepare(models(data.truth, name)[1])
    T, q = (data.channels[f"proximal_{one}"] for one in ("tension", "displacement"))
    state = online.build_initial_state(prepared)
    for i in range(600):
        last, state = online.step(prepared, state, T[i], q[i], 0.01)
    for wrong in ((math.nan, q[600]), (math.inf, q[600]), (-9.0, q[600]), (T[600], math.inf)):
        refused, after = online.step(prepared, state, *wrong, 0.0)
        assert refused.status & Status.INVALID_INPUT
        assert refused.distal_tension == last.distal_tension
        again, _ = online.step(prepared, after, T[600], math.nan, 0.01)
        never, _ = online.step(prepared, state, T[600], math.nan, 0.01)
        assert again.distal_tension == never.distal_tension
    rng = np.random.default_rng(SEED)
    for T_in in (1e300, 0.0, 1e12, *rng.uniform(0.0, 50.0, 200)):
        odd, state = online.step(
            prepared, state, T_in, rng.normal(0.0, 1e-2), 10.0 ** rng.uniform(-6, 3)
        )
        assert math.isfinite(odd.distal_tension)
        assert math.isfinite(odd.elongation)
        assert odd.low <= odd.distal_tension <= odd.high


def test_each_effect_has_a_use_or_a_reason():
    middling = [
        (one, tuple(10.0 if p.jumps else (2.0 * p.low + p.high) / 3.0 for p in one.parameters))
        for one in CATALOGUE
    ]
    uses = {}
    for one, values in middling:
        ((_, _, use),) = build_extended_model((0.4, 1e-4, 1e-4), [(one, values)], 60.0, 1.5).uses
        uses.setdefault(one.name, set()).add(use)
        assert explain_omission(one)
    left_out = {name for name, found in uses.items() if found == {EffectUse.OMITTED}}
    assert left_out == set(OMISSION_REASONS)
    assert uses["constant_drag"] == uses["nonuniform_curvature"] == {EffectUse.LAW}
    assert uses["distal_tension_gain"] == {EffectUse.TIP_SENSOR}
    assert uses["proximal_tension_gain"] == uses["sheath_rub"] == {EffectUse.READING_CORRECTION}
    assert set(uses) == set(NAMES)


def test_what_a_cell_at_the_tip_reads_does_not_touch_the_force():
    gain = effect("distal_tension_gain")
    found = build_extended_model((0.9, 1e-4, 0.0), [(gain, (0.05,))], 60.0, 1.0)
    assert found.extension is None
    table = build_reading_table([(gain, (0.05,))])
    for tension in (0.0, 0.3, 9.0, 2000.0):
        assert compute_reading(table, tension) == pytest.approx(1.05 * tension)


def test_several_effects_of_readings_are_undone_in_the_opposite_order():
    gain, bias = effect("proximal_tension_gain"), effect("proximal_tension_bias")
    found = build_extended_model((0.5, 1e-4, 0.0), [(gain, (0.5,)), (bias, (2.0,))], 60.0, 1.0)
    prepared = online.prepare(TendonModel(found.sheath, extension=found.extension))
    row, _ = online.step(
        prepared, online.build_initial_state(prepared), 1.5 * 8.0 + 2.0, math.nan, 0.0
    )
    assert row.distal_tension == pytest.approx(8.0 * math.exp(-0.5))


def running(*effects):
    """Return a model and its first state, with effects at their values."""
    found = build_extended_model((0.8, 1e-4, 5e-4), list(effects), 60.0, 1.0)
    prepared = online.prepare(TendonModel(found.sheath, extension=found.extension))
    return prepared, online.build_initial_state(prepared)


@pytest.mark.parametrize("rise", [-0.03, -0.01, 0.2])
def test_a_fit_carried_far_beyond_its_tensions_makes_no_force_of_nothing(rise):
    prepared, state = running((effect("tension_dependent_friction", "linear"), (rise,)))
    for T in (*np.linspace(0.0, 130.0, 300), *np.linspace(130.0, 5.0, 300)):
        row, state = online.step(prepared, state, float(T), math.nan, 0.01)
        assert 0.0 <= row.low <= row.distal_tension <= row.high
        assert row.distal_tension <= 130.0


def test_a_bias_that_is_gone_does_not_make_a_slack_tendon_a_broken_cell():
    prepared, state = running((effect("proximal_tension_bias"), (0.4,)))
    for reading in np.random.default_rng(SEED).normal(0.0, 0.01, 50):
        row, state = online.step(prepared, state, float(reading), 0.0, 0.001)
        assert not row.status & Status.INVALID_INPUT
        assert row.distal_tension == pytest.approx(0.0, abs=0.05)


READINGS = {
    "proximal_tension_gain": (0.1,),
    "proximal_tension_bias": (0.7,),
    "encoder_scale": (0.05,),
    "pulley_eccentricity": (2e-5, -1e-5, 0.01),
    "cogging_ripple": (0.2, 0.1, 5000.0),
    "sheath_rub": (0.3, 1e-4),
}


def reading(name):
    return next(e for e in CATALOGUE if e.name == name and e.correction is not None)


@pytest.mark.parametrize("name", [name for name in READINGS if name != "pulley_eccentricity"])
def test_a_correction_takes_away_what_its_effect_makes_of_a_record(name):
    """The eccentric pulley's effect has an inverse only, which the next test compares with."""
    one, values = reading(name), READINGS[name]
    time = np.arange(2000) * 1e-3
    q = 2e-3 * np.sin(3.0 * time) + 3e-4 * np.sin(40.0 * time)
    true = {"proximal_tension": 6.0 + 2.0 * np.sin(5.0 * time), "proximal_displacement": q}
    drives = "distal_tension" if name == "encoder_scale" else "proximal_displacement"
    none = np.zeros_like(time)
    read = one.measure(true, values, EffectContext(time, drives, q, none, {}, {}, none, 0.0))
    corrections = build_corrections([(one.correction, values)])
    remembered = np.full(MAX_CORRECTIONS, math.nan)
    for k in range(len(time)):
        T, travel = (read[f"proximal_{what}"][k] for what in ("tension", "displacement"))
        corrected = correct_reading(corrections, remembered, T, travel)
        assert corrected == pytest.approx([row[k] for row in true.values()], abs=1e-12)


def test_the_travel_of_an_eccentric_pulley_is_corrected_as_the_diagnosis_does():
    one, values = reading("pulley_eccentricity"), READINGS["pulley_eccentricity"]
    q = np.linspace(0.0, 0.05, 300)
    none = np.zeros_like(q)
    true = one.invert(q, values, EffectContext(q, "", q, none, {}, {}, none, 0.0))
    corrections = build_corrections([(one.correction, values)])
    remembered = np.full(MAX_CORRECTIONS, math.nan)
    found = np.array([correct_reading(corrections, remembered, 1.0, x)[1] for x in q])
    assert found - found[0] == pytest.approx(true - true[0], abs=1e-15)


def test_friction_is_that_of_the_record_s_end():
    data = bench("friction_step", "blocked")
    change, onset = data.truth["friction_step"]["change"], data.truth["friction_step"]["time"]
    plain, more = models(data.truth, "friction_step")
    ratio = more.sheath.K / plain.sheath.K
    assert ratio == pytest.approx(1.0 + change)
    after = data.time > onset + 4.0
    assert force_error(more, data, after) < 0.7 * force_error(plain, data, after)
    assert more.extension is None

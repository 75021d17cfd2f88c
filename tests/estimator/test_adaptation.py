"""Adaptation to a sheath that moves, on a quasi-static chain that knows nothing of it."""

import dataclasses

import numpy as np
import pytest

from estimator.adaptation import FACTOR_MAX, FACTOR_MIN, GROWTH, run_adapting
from estimator.compiled import jit_compile
from estimator.law import play_profile
from estimator.law.sheath import Sheath
from estimator.law.tables import build_tables
from estimator.law.transmission import build_slack_profile, evaluate_tension, push_proximal
from estimator.online import online
from estimator.online.tendon_model import TendonModel
from studies.adaptation import CHANGE_S as USE_CHANGE_S
from studies.adaptation import EARLY_S, UNCHANGED, render, simulate_use

RATE, CHANGE_S, DURATION_S = 200.0, 15.0, 50.0
LENGTH, EA, NODES, SPRING = 1.5, 9000.0, 45, 1500.0
MODEL = TendonModel(Sheath.uniform(1.0, LENGTH, EA), 0.02, 1e-6)


@jit_compile
def sweep(T_in, ratios):
    """Return T_out and the stretch of a chain whose nodes' friction changes from row to row."""
    nodes, T_out, e = np.zeros(NODES + 1), np.zeros(len(T_in)), np.zeros(len(T_in))
    for k in range(len(T_in)):
        nodes[0] = T_in[k]
        for i in range(NODES):
            ratio = ratios[k, i]
            nodes[i + 1] = min(max(nodes[i + 1], nodes[i] / ratio), nodes[i] * ratio)
        T_out[k] = nodes[-1]
        e[k] = (nodes[:-1] + nodes[1:]).sum() * 0.5 * LENGTH / NODES / EA
    return T_out, e


def simulate(K_after, third=None, drift=0.0, creep=0.0, moving_tip=0.0, seed=1, rest=DURATION_S):
    """Return time, T_in, q_p as measured, T_out of a tendon against a spring; at rest from `rest`.

    Coulomb friction at `NODES` nodes, swept from the housing; K = 1 before the change.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(DURATION_S * RATE)) / RATE
    goals, T_in = rng.uniform(1.0, 14.0, 200), []
    goals[::2] = rng.uniform(0.5, 4.0, 100)
    for low, high in zip([0.0, *goals], goals, strict=False):
        n = round(rng.uniform(0.4, 1.0) * RATE)
        T_in += [*(low + (high - low) * (1 - np.cos(np.linspace(0, np.pi, n))) / 2)]
        T_in += [high] * round(rng.uniform(0.0, 0.3) * RATE)
    T_in = np.array(T_in[: len(time)])
    T_in[time > rest] = T_in[time <= rest][-1]
    scale = np.ones(NODES)
    part = slice(None) if third is None else slice(third * NODES // 3, (third + 1) * NODES // 3)
    scale[part] += (K_after - 1.0) * (1.0 if third is None else 3.0)
    T_out, e = sweep(T_in, np.exp(np.where(time[:, None] > CHANGE_S, scale, 1.0) / NODES))
    lag = np.zeros(len(time))
    for k in range(1, len(time)):
        lag[k] = lag[k - 1] + (creep * e[k] - lag[k - 1]) / (8.0 * RATE)
    pushed = moving_tip * np.cumsum(rng.normal(0.0, 1.0, len(time))) / np.sqrt(RATE)
    q = e + lag + T_out / SPRING + pushed
    noise = rng.normal(0.0, 1.0, (2, len(time)))
    return time, T_in + 0.02 * noise[0] + drift * time, q + 1e-6 * noise[1], T_out


@pytest.fixture(scope="module")
def changed():
    return simulate(1.4)


@pytest.mark.parametrize(("K", "third"), [(1.4, None), (0.65, None), (1.2, 0)])
def test_a_change_of_all_friction_or_of_a_bend_is_found_within_30_s(K, third):
    time, T, q, T_out = simulate(K, third)
    run, late = run_adapting(MODEL, time, T, q), time > CHANGE_S + 30.0
    fixed = online.run(online.prepare(MODEL), time, T, q)
    assert CHANGE_S < time[run.adapted_from] < CHANGE_S + 30.0
    assert run.K[-1] == pytest.approx(K, rel=0.06)
    error, error_fixed = (
        np.percentile(abs(r.distal_tension - T_out)[late], 90) for r in (run.estimates, fixed)
    )
    assert error < 0.05 * T_out.max()
    assert error < 0.5 * error_fixed
    inside = (run.estimates.low <= T_out + 1e-6) & (T_out <= run.estimates.high)
    assert inside.mean() > 0.99


@pytest.mark.parametrize("disturbance", [{}, {"drift": 0.004}, {"creep": 0.05}])
def test_an_unchanged_sheath_keeps_its_estimates(disturbance):
    time, T, q, _ = simulate(1.0, **disturbance, seed=2)
    run = run_adapting(MODEL, time, T, q)
    fixed = online.run(online.prepare(MODEL), time, T, q)
    assert run.adapted_from == -1
    np.testing.assert_array_equal(run.estimates.distal_tension, fixed.distal_tension)
    assert (run.estimates.low <= fixed.low + 1e-9).all()


def test_minutes_of_use_with_tremor_are_no_change_of_shape():
    """Where the motor turns, the tip has just followed it."""
    use = simulate_use(3, pair=False, given=UNCHANGED._replace(after=300.0))
    T, q = use.tension[:, 0].copy(), use.travel[:, 0].copy()
    run = run_adapting(use.models[0], use.time, T, q)
    assert run.pieces > 1000
    assert run.adapted_from == -1


def test_a_tip_that_follows_far_does_not_open_the_interval():
    use = simulate_use(36, pair=False)
    run = run_adapting(use.models[0], use.time, use.tension[:, 0].copy(), use.travel[:, 0].copy())
    early = (use.time > EARLY_S) & (use.time < USE_CHANGE_S)
    assert run.contradictions < 0.2 * run.pieces  # of 379, it follows far in 246
    assert ((run.K_high - run.K_low) / run.K)[early].mean() < 0.4


def test_a_tip_that_stops_as_friction_jumps_gives_the_hand_hardly_too_much():
    use = simulate_use(108, pair=False)  # K grows by 23 % in 0.2 s while the tip follows
    run = run_adapting(use.models[0], use.time, use.tension[:, 0].copy(), use.travel[:, 0].copy())
    excess = (render(run.estimates) - use.tip[:, 0])[use.time > EARLY_S]
    assert excess.max() < 0.1 * use.tip.max()


def test_a_tip_that_moves_by_itself_is_no_change_of_shape():
    time, T, q, _ = simulate(1.0, moving_tip=1e-3)
    run = run_adapting(MODEL, time, T, q)
    assert run.adapted_from == -1
    assert run.contradictions > 0.2 * run.pieces


def test_the_interval_grows_with_rest_and_holds_a_change_meanwhile():
    time, T, q, T_out = simulate(0.85, rest=5.0)
    run = run_adapting(MODEL, time, T, q)
    width = np.interp([8.0, 14.0, 20.0, 49.0], time, run.K_high - run.K)
    assert (np.diff(width)[:2] >= 0.99 * GROWTH * 6.0).all()
    assert run.K_low[-1] == pytest.approx(FACTOR_MIN)
    assert run.K_high[-1] == pytest.approx(FACTOR_MAX)
    inside = (run.estimates.low <= T_out + 1e-6) & (T_out <= run.estimates.high)
    assert inside.all()


def test_k_stays_within_its_bounds():
    time, T, q, _ = simulate(2.6)
    run = run_adapting(MODEL, time, T, q)
    assert 1.5 < run.K[-1] <= FACTOR_MAX + 1e-9


def test_without_friction_or_travel_nothing_is_adapted(changed):
    time, T, q, _ = changed
    straight = dataclasses.replace(MODEL, sheath=Sheath.uniform(0.0, LENGTH, EA))
    assert run_adapting(straight, time, T, q).pieces == 0
    assert run_adapting(MODEL, time, T, np.full_like(q, np.nan)).pieces == 0


@pytest.mark.parametrize("K", [0.6, 1.0, 1.5])
def test_a_resized_profile_keeps_the_tension_at_each_depth(K):
    before, after = (build_tables(Sheath.uniform(k, LENGTH, EA)) for k in (1.0, K))
    profile = build_slack_profile(before)
    for T in (12.0, 4.0, 6.0, 5.0):
        push_proximal(before, profile, T)
    depth = np.linspace(0.0, min(K, 1.0), 50)
    expected = evaluate_tension(before, profile, depth * LENGTH)
    play_profile.resize_profile(after, profile, np.log(3.5))
    np.testing.assert_allclose(
        evaluate_tension(after, profile, depth * LENGTH / K), expected, rtol=1e-9
    )
    x = np.linspace(0.0, LENGTH, 20001)
    area = np.trapezoid(evaluate_tension(after, profile, x), x)
    assert play_profile.integrate_tension(after, profile) == pytest.approx(area, rel=1e-5)

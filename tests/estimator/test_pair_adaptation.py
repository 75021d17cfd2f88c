"""Adaptation of the tendons of a pair, on the plant of the study, which knows nothing of it."""

import numpy as np
import pytest

from estimator.adaptation import FACTOR_MAX, FACTOR_MIN, TAUT_TENSION, build_adaptation
from estimator.law.sheath import Sheath
from estimator.online import online
from estimator.online.online import TendonModel
from estimator.pair_adaptation import (
    CELLS,
    FRICTIONS,
    TEMPER,
    PairAdaptation,
    _compare_passes,
    _initialise,
    _sweep_tip,
    run_adapting_pair,
)
from estimator.structs import view_struct
from slave.simulation.environment import TissueConfig
from studies.adaptation import CHANGE_S, SETTLE_S, UNCHANGED, simulate_use


@pytest.fixture(scope="module")
def changed():
    """Return a pair of which all friction changes by -20 %; and its estimates."""
    use = simulate_use(22, pair=True)
    return use, run_adapting_pair(use.models, use.time, use.tension, use.travel)


def estimate_unadapted(use, k):
    T, q = (np.ascontiguousarray(rows[:, k]) for rows in (use.tension, use.travel))
    return online.run(online.prepare(use.models[k]), use.time, T, q)


def compute_error(estimates, use, k):
    late = use.time > use.change_end + SETTLE_S
    return np.percentile(abs(estimates.distal_tension - use.tip[:, k])[late], 90)


def test_a_change_is_found(changed):
    use, runs = changed
    assert use.time[runs[0].adapted_from] > CHANGE_S
    assert runs[0].K[-1] == pytest.approx(use.K_after[0], rel=0.03)
    fixed = compute_error(estimate_unadapted(use, 0), use, 0)
    assert compute_error(runs[0].estimates, use, 0) < 0.3 * fixed


def test_until_then_the_tips_motion_is_known_and_k_kept(changed):
    use, runs = changed
    before = (use.time > 5.0) & (use.time < CHANGE_S)
    for k, run in enumerate(runs):
        assert np.ptp(run.K[before]) == 0.0
        # the estimator of one tendon does not know that the other one drags it out
        single = estimate_unadapted(use, k)
        error, error_single = (
            np.mean(abs(r.distal_tension - use.tip[:, k])[before]) for r in (run.estimates, single)
        )
        assert error < 0.6 * error_single


def test_intervals_hold_the_truth(changed):
    use, runs = changed
    for k, run in enumerate(runs):
        low, high, tip = run.estimates.low, run.estimates.high, use.tip[:, k]
        assert np.mean((low <= tip + 1e-6) & (tip <= high)) > 0.99
        K = use.models[k].sheath.K
        assert K * FACTOR_MIN - 1e-9 <= run.K_low.min() <= run.K_high.max() <= K * FACTOR_MAX + 1e-9


@pytest.mark.parametrize(
    ("seed", "disturbance"),
    [
        (1, {"spring": 300.0}),
        (6, {"tissue": TissueConfig(position=0.001, stiffness=900.0, dissipation=20.0)}),
        (12, {"expansion": 1e-4}),
    ],
)
def test_what_loads_the_joint_or_stretches_a_tendon_is_no_change_of_shape(seed, disturbance):
    use = simulate_use(seed, pair=True, given=UNCHANGED._replace(after=40.0, **disturbance))
    for run in run_adapting_pair(use.models, use.time, use.tension, use.travel):
        assert run.pieces > 500
        assert run.adapted_from == -1


def test_a_wrong_k_is_doubted_before_it_is_known():
    use = simulate_use(4, pair=True, given=UNCHANGED._replace(model_error=-0.3))
    for k, run in enumerate(run_adapting_pair(use.models, use.time, use.tension, use.travel)):
        low, high, tip = run.estimates.low, run.estimates.high, use.tip[:, k]
        is_inside = (low <= tip + 1e-6) & (tip <= high)
        assert np.mean(is_inside[use.time > 8.0]) > 0.99  # before, little contradicts it


def test_the_tip_is_known_to_five_percent_where_k_is():
    use = simulate_use(9, pair=True, given=UNCHANGED)
    for k, run in enumerate(run_adapting_pair(use.models, use.time, use.tension, use.travel)):
        error = abs(run.estimates.distal_tension - use.tip[:, k])[use.time > 5.0]
        assert np.mean(error < 0.05 * use.tip[:, k].max()) > 0.93


def test_a_motor_that_takes_up_slack_moves_no_joint():
    """Its travel, taken for the joint's, would pull the other tip by up to T_in e^K."""
    use = simulate_use(109, pair=True)
    run, _ = run_adapting_pair(use.models, use.time, use.tension, use.travel)
    tip, before = use.tip[:, 0], use.time < 12.0
    is_slack = before & (use.tension[:, 1] < TAUT_TENSION)
    assert is_slack.sum() > 500
    assert (run.estimates.distal_tension - tip)[is_slack].max() < 0.3 * tip.max()


def test_friction_that_jumps_by_half_is_found_in_both_tendons_within_seconds():
    use = simulate_use(12, pair=True)
    runs = run_adapting_pair(use.models, use.time, use.tension, use.travel)
    for run, model, K in zip(runs, use.models, use.K_after, strict=True):
        assert pytest.approx(1.55 * model.sheath.K, rel=0.01) == K
        assert CHANGE_S < use.time[run.adapted_from] < CHANGE_S + 10.0
        assert run.K[-1] == pytest.approx(K, rel=0.06)


def simulate_strokes(K, compliance, rate, strokes):
    """Return T_in and q_p of tendons that drag a joint to and fro, by nodes of equal friction.

    The joint, of friction 0.15 N, rests while the tensions change, so that both slide afterwards.
    """
    rng, depth = np.random.default_rng(1), np.linspace(0.0, 1.0, 50)[:, None] * K
    y, before, rows = np.zeros_like(depth), np.ones(2), []
    for stroke in range(strokes):
        pulled, T = stroke % 2, np.empty(2)
        T[1 - pulled] = rng.uniform(0.6, 0.65)
        T[pulled] = np.exp(K[pulled]) * (T[1 - pulled] * np.exp(K[1 - pulled]) + 0.15)
        for share in np.arange(rate) / rate:
            u = np.log(before + min(share / 0.3, 1.0) * (T - before))
            place = (1 - 2 * pulled) * (-5e-3 + 1e-2 * max(share - 0.3, 0.0) / 0.7)
            y = np.minimum(np.maximum(y, u - depth), u + depth)
            rows.append([*np.exp(u), *(np.exp(y).mean(0) * compliance + [place, -place])])
        before = T
    return np.array(rows)


def test_noise_does_not_draw_k_where_little_tells_it():
    """K of one against that of the other: a noisy T_in is in the residual and in its slope."""
    K, EA, rate, noise = np.array([0.5, 1.0]), 9e3, 250, 0.05
    rows = simulate_strokes(K, 1.0 / EA, rate, strokes=220)
    rows += np.random.default_rng(2).normal(0.0, 1.0, rows.shape) * [noise, noise, 1e-6, 1e-6]
    a, b = (TendonModel(Sheath.uniform(k, 1.0, EA), noise, 1e-6, initial=1.0) for k in K)
    time = np.arange(len(rows)) / rate
    for run in run_adapting_pair((a, b), time, rows[:, :2], rows[:, 2:]):
        assert run.pieces > 5_000
        assert run.adapted_from == -1


def test_samples_that_are_missing_are_skipped(changed):
    use, runs = changed
    tension = use.tension.copy()
    tension[5000:5010, 0] = np.nan
    some = slice(0, 10000)
    gap = run_adapting_pair(use.models, use.time[some], tension[some], use.travel[some])
    np.testing.assert_array_equal(
        gap[1].estimates.distal_tension[:5000], runs[1].estimates.distal_tension[:5000]
    )
    later = slice(7000, 10000)
    difference = gap[1].estimates.distal_tension[later] - runs[1].estimates.distal_tension[later]
    assert np.median(abs(difference)) < 0.02 * use.tip[:, 1].max()


@pytest.mark.parametrize("change", [1e-6, 2e-5, -1e-6, -2e-5])
def test_a_tip_that_moves_changes_the_elongation_by_as_much(change):
    weight, ds = np.full(CELLS + 1, 5e-6), 1.0 / CELLS
    tension = 5.0 * np.exp(-0.5 * np.abs(np.arange(CELLS + 1) - 10) * ds)
    before, ratio = tension.copy(), np.full(3, np.exp(ds if change > 0.0 else -ds))
    _sweep_tip(tension, ratio, weight, change)
    assert weight @ (tension - before) == pytest.approx(change, rel=1e-9)
    assert tension[0] == before[0]
    assert np.abs(np.diff(np.log(tension))).max() <= ds * (1.0 + 1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_tip_that_moves_far_drags_all_of_the_tendon_along(sign):
    tension, ds = np.full(CELLS + 1, 3.0), 1.0 / CELLS
    _sweep_tip(tension, np.full(3, np.exp(sign * ds)), np.full(CELLS + 1, 5e-6), sign)
    np.testing.assert_allclose(tension, 3.0 * np.exp(sign * ds * np.arange(CELLS + 1)), rtol=1e-9)


def list_passes(file):
    """Return tensions [N] of both tendons as the joint passes places one way, and back."""
    _, command, angle, *tensions = np.genfromtxt(file, skip_header=1, delimiter=",").T
    T, speed = np.stack(tensions, 1), np.gradient(command)
    for place in np.linspace(*np.percentile(angle, [35, 65]), 12):
        crossed = np.flatnonzero(np.diff(np.sign(angle - place)))
        there, back = (T[crossed[speed[crossed] * sign > 0.0]] for sign in (1.0, -1.0))
        if there[:, 0].mean() < back[:, 0].mean():
            there, back = back, there
        yield from zip(there, back, strict=False)


def test_passes_of_a_measured_pair_tell_how_far_its_sheath_is_bent(measured_data):
    """Two tendons of an endoscope, unknown otherwise: capstan friction grows with the bend."""
    bends, K, found = (0, 60, 120, 180, 240), 0.5, []
    for bend in bends:
        constants = build_adaptation(TendonModel(Sheath.uniform(K, 1.0, 9000.0)))[0]
        states = PairAdaptation.array()
        state = view_struct(states)
        _initialise(state)
        passes = list(list_passes(measured_data / "endoscope-pair" / f"bend{bend:03d}.csv"))
        for to_a, to_b in passes * 8:
            _compare_passes(constants, constants, state, to_a, to_b, 1.0, 1.0, TEMPER, 0.0)
        K *= np.exp(states["mean"][0, :FRICTIONS]).mean()  # of each, from one bend to the next
        found.append(2.0 * K)
    angle = np.radians(bends)
    line = np.polyval(np.polyfit(angle, found, 1), angle)
    assert (np.diff(found) > 0.0).all()
    assert abs(found - line).max() < 0.15 * np.ptp(found)

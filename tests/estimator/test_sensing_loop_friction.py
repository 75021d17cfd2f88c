"""A sensing loop on a quasi-static chain: what it measures, and what adaptation makes of it."""

import numpy as np
import pytest

from estimator.adaptation import run_adapting
from estimator.pair_adaptation import run_adapting_pair
from estimator.sensing_loop_friction import SensingLoopState, measure_loop_friction
from estimator.structs import view_struct
from studies.adaptation import Conditions, score_use, simulate_use

RATE, CHANGE_S, END_S, NODES = 250.0, 6.0, 12.0, 60
GAIN = 1.1  # of the cell at the moved end


def simulate_loop(friction, after):
    """Return the measured tensions at both ends [N], shape (n, 2).

    Friction at `NODES` nodes there and back, swept from the moved end; from `CHANGE_S` on that at
    the tip, in the middle of the loop, is other, so that it is `after` in all.
    """
    rng = np.random.default_rng(1)
    time = np.arange(round(END_S * RATE)) / RATE
    nodes, rows = np.full(NODES + 1, 5.0), []
    shares = np.full(NODES, friction / NODES)
    changed = shares.copy()
    changed[NODES // 2 - 6 : NODES // 2 + 6] += (after - friction) / 12
    for t in time:
        nodes[0] = 6.0 - 3.5 * np.cos(2.0 * np.pi * t)
        for i, ratio in enumerate(np.exp(changed if t > CHANGE_S else shares).tolist()):
            nodes[i + 1] = min(max(nodes[i + 1], nodes[i] / ratio), nodes[i] * ratio)
        rows.append((nodes[0], nodes[-1]))
    return time, np.array(rows) * [GAIN, 1.0] + rng.normal(0.0, 0.02, (len(time), 2))


def test_friction_at_the_tip_is_measured_within_a_second_whatever_the_gains():
    time, tensions = simulate_loop(0.5, 0.6)
    state, readings = view_struct(SensingLoopState.array()), []
    for t, (moved, held) in zip(time, tensions, strict=True):
        phi = measure_loop_friction(state, moved, held, 1.0 / RATE)
        if not np.isnan(phi):
            readings.append((t, phi))
    at, phi = np.array(readings).T
    assert phi[(at > 2.0) & (at < CHANGE_S)] == pytest.approx(0.5, rel=0.02)
    assert phi[at > CHANGE_S + 1.0] == pytest.approx(0.6, rel=0.03)
    assert phi[at > CHANGE_S + 4.0] == pytest.approx(0.6, rel=0.015)


@pytest.fixture(scope="module")
def tip():
    """A change of the bend at the tip, which the housing hardly shows, with and without a loop."""
    return simulate_use(2, pair=False, given=Conditions(at_tip=True, has_loops=True, settle=3.0))


def test_a_change_near_the_tip_is_followed_within_three_seconds(tip):
    (scores,) = score_use(tip, 3.0)
    assert abs(scores.K_error).max() < 0.03
    assert scores.within[1] > 0.95 > scores.within[0]
    assert scores.inside[1] > 0.99
    (without,) = score_use(tip._replace(loop=None), 3.0)
    assert abs(without.K_error).max() > 0.05


@pytest.mark.parametrize("fault", ["moved end stuck", "held end stuck", "silent", "broken"])
def test_a_faulty_loop_changes_nothing(tip, fault):
    loop = tip.loop[:, 0].copy()
    half = len(loop) // 2
    if fault == "broken":
        loop[:half] = 0.0
    elif fault == "silent":
        loop[:half] = np.nan
    else:
        loop[:half, ("moved", "held").index(fault.split()[0])] = 4.0
    T, q = tip.tension[:, 0].copy(), tip.travel[:, 0].copy()
    run = run_adapting(tip.models[0], tip.time, T, q, loop)
    assert np.ptp(run.K[:half]) == 0.0
    assert np.isfinite(run.K_high - run.K_low).all()


@pytest.mark.parametrize("bad", [(np.nan, 5.0), (5.0, np.nan), (np.inf, 5.0), (5.0, np.inf)])
def test_a_loop_is_read_on_after_a_bad_sample(bad):
    time, tensions = simulate_loop(0.5, 0.5)
    tensions[len(time) // 2] = bad
    state = view_struct(SensingLoopState.array())
    phi = [measure_loop_friction(state, moved, held, 1.0 / RATE) for moved, held in tensions]
    late = np.array(phi)[len(time) // 2 :]
    assert late[~np.isnan(late)] == pytest.approx(0.5, rel=0.03)
    assert np.isfinite(late).sum() > 20


def test_a_loop_that_misses_a_change_of_the_tendon_leaves_k_in_doubt():
    """As where the tendon's own coating wears: the loop goes on as calibrated."""
    use = simulate_use(2, pair=False, given=Conditions(has_loops=True, settle=3.0))
    unchanged = np.resize(use.loop[:4000, 0], use.loop[:, 0].shape)
    T, q = use.tension[:, 0].copy(), use.travel[:, 0].copy()
    run = run_adapting(use.models[0], use.time, T, q, unchanged)
    late = use.time > use.change_end + 10.0
    assert late.any()
    assert ((run.K_low < use.K_after[0]) & (use.K_after[0] < run.K_high))[late].all()


def test_the_tendons_of_a_pair_take_their_loops_readings():
    use = simulate_use(1, pair=True, given=Conditions(has_loops=True, settle=3.0))
    bare = score_use(use._replace(loop=None), 3.0)
    for scores, without in zip(score_use(use, 3.0), bare, strict=True):
        assert abs(scores.K_error[0]) < 0.01 < abs(without.K_error[0])
        assert abs(scores.K_error[1]) < 0.02
    T, q = use.tension, use.travel
    only_a = use.loop.copy()
    only_a[:, 1] = np.nan
    runs = run_adapting_pair(use.models, use.time, T, q, only_a)
    assert runs[0].K[-1] == pytest.approx(use.K_after[0], rel=0.02)

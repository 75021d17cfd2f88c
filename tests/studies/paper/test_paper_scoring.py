import math

import numpy as np
import pytest

from studies.paper.study import PHASES, WHOLE, Truth, errors, phases, score, spread, taut


def test_errors_are_shares_of_the_runs_largest_truth():
    truth = np.array([0.0, 4.0, 2.0, 1.0])
    estimate = np.array([0.4, 3.0, 2.2, 1.0])
    found = errors(estimate, truth)
    assert found.largest == pytest.approx(1.0 / 4.0)
    assert found.average == pytest.approx((0.4 + 1.0 + 0.2 + 0.0) / 4.0 / 4.0)
    late = errors(estimate, truth, np.array([False, False, True, True]))
    assert late.largest == pytest.approx(0.2 / 4.0)
    assert late.average == pytest.approx(0.1 / 4.0)


def test_a_phase_that_never_came_has_no_error():
    found = errors(np.ones(3), np.ones(3), np.zeros(3, dtype=bool))
    assert math.isnan(found.largest)
    assert math.isnan(found.average)


def test_score_keeps_force_and_elongation_and_phases_apart():
    truth = Truth(
        np.array([10.0, 5.0]),
        np.array([1e-3, 2e-3]),
        {WHOLE: np.array([True, True]), "late": np.array([False, True])},
    )
    found = score(truth, np.array([9.0, 5.0]), np.array([1e-3, 2.1e-3]))
    assert found[WHOLE].force == pytest.approx((0.1, 0.05))
    assert found["late"].force == pytest.approx((0.0, 0.0))
    assert found["late"].elongation == pytest.approx((0.05, 0.05))


def test_phases_follow_the_tip():
    # per leg: T_in turns, the tip waits three samples, then follows
    T_in = np.array([0, 5, 10, 20, 15, 10, 6, 4, 2, 6, 10, 14, 18, 20], dtype=float)
    T_out = np.array([0, 2, 4, 8, 8, 8, 8, 7, 4, 4, 4, 4, 7, 8], dtype=float)
    leg = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2])
    names = [PHASES[i] for i in phases(leg, T_in, T_out)]
    assert names == (
        ["pull"] * 3
        + ["pull to release"] * 4
        + ["release"]
        + ["release to pull"] * 4
        + ["pull again"] * 2
    )


def test_a_turn_seen_late_is_still_where_the_tension_turned():
    T_in = np.array([0.0, 10.0, 20.0, 18.0, 12.0, 5.0, 4.0, 10.0])
    T_out = np.array([0.0, 4.0, 8.0, 8.0, 8.0, 8.0, 6.0, 6.0])
    leg = np.array([0, 0, 0, 0, 1, 1, 1, 2])
    assert phases(leg, T_in, T_out).tolist() == [0, 0, 1, 1, 1, 1, 3, 3]


def test_slack_does_not_count():
    T_in = np.array([0.0, 0.1, -0.05, 0.3, 10.0, 20.0, 0.1])
    assert taut(T_in).tolist() == [False, False, False, True, True, True, True]


def test_spread_names_quantiles_that_sheaths_have_and_counts_refusals_as_failures():
    found = spread(np.array([0.03, 0.01, np.inf, 0.02, 0.05, 0.04, 0.06, 0.07, 0.08, 0.09]), 0.05)
    assert found.median == 0.05
    assert found.ninetieth == 0.09
    assert math.isinf(found.largest)
    assert (found.within, found.sheaths) == (5, 10)

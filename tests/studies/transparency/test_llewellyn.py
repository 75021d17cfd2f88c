"""Llewellyn's criterion against passive ends, tried one by one."""

import numpy as np
import pytest

from studies.transparency.hybrid import Hybrid, Response, compute_margin


def two_port(h11, h12, h21, h22):
    answers = np.broadcast_arrays(*(np.atleast_1d(h) + 0j for h in (h11, h12, h21, h22)))
    return Hybrid(np.ones(1), *(Response(h, np.ones(h.size), 0.0) for h in answers))


def worst_drag(h11, h12, h21, h22):
    """Return the least Re of the impedance at the hand, over all passive things at the tip."""
    admittance = np.concatenate([-np.logspace(-4, 4, 4001)[::-1], [0.0], np.logspace(-4, 4, 4001)])
    lossless = 1j * admittance
    seen = [h11 - h12 * h21 / (h22 + g + lossless) for g in (0.0, 0.01, 1.0, 100.0)]
    return min(z.real.min() for z in seen)


def test_stable_is_what_no_passive_tip_makes_an_active_hand_feel():
    rng = np.random.default_rng(5)
    told, tried = [], []
    for _ in range(300):
        h11, h22 = rng.uniform(0.05, 2.0, 2) + 1j * rng.normal(size=2)
        h12, h21 = rng.normal(size=2) + 1j * rng.normal(size=2)
        told.append(bool(compute_margin(two_port(h11, h12, h21, h22)).stable[0]))
        tried.append(worst_drag(h11, h12, h21, h22) >= 0.0)
    assert 50 < sum(told) < 250
    assert told == tried


def test_two_active_ends_are_not_stable_although_their_product_is_positive():
    found = compute_margin(two_port(-1.0, 0.5, -0.5, -1.0))
    assert found.eta[0] > 1.0
    assert not found.stable[0]


def test_one_active_end_is_not_stable_where_the_margin_does_not_see_it():
    found = compute_margin(two_port(0.0, 0.4, -1.0, -0.1))
    assert found.eta[0] == pytest.approx(1.0)
    assert not found.stable[0]

"""Held-out errors are compared, and those that are tolerated are not."""

import numpy as np
import pytest

from estimator.diagnosis.score import Errors, gain_of, log_likelihood_ratio

BINS, EACH = 20, 50


def off_by(mean):
    """Return errors of a mean square, in noise variances, in each bin."""
    squares = np.full(BINS, mean * EACH)
    return Errors(squares, float(squares.sum()), np.full(BINS, float(EACH)), 1.0)


def test_what_makes_tolerated_errors_smaller_scores_nothing():
    before = {"proximal_tension": off_by(2.0), "distal_tension": off_by(9.0)}
    quieter = before | {"proximal_tension": off_by(1.0)}
    tolerated = {"proximal_tension": 2.5, "distal_tension": 1.5}
    assert log_likelihood_ratio(quieter, before) > 100.0
    assert log_likelihood_ratio(quieter, before, tolerated) == 0.0
    assert gain_of(quieter, before, tolerated) == 0.0
    right = before | {"distal_tension": off_by(1.0)}
    expected = 0.5 * BINS * EACH * np.log(9.0 / 1.5)
    assert log_likelihood_ratio(right, before, tolerated) == pytest.approx(expected)
    assert log_likelihood_ratio(before, right, tolerated) == pytest.approx(-expected)
